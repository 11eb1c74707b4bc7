"""Tables that an engine is calibrated from: read, converted to SI, refused where a fit to them would be wrong; and written.

They hold stationary bench points, or are those of single components from suppliers and control units.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np

from lpvobs.calibration.bench import DEVIATION, METER, REFERENCE, Rows, Table, bench_table, rows_of
from lpvobs.engines import base, channels
from lpvobs.engines.constants import Within
from lpvobs.engines.unknowns import ComponentMap, unknowns_of
from lpvobs.errors import DataError, UsageError
from lpvobs.io.arrow import pa
from lpvobs.io.calibration.dcm import read_dcm_map
from lpvobs.io.logs.parquet import column_of, expect, metadata_of, refuse_huge, schema_of, tables_of, write_log
from lpvobs.io.safety.atomic import replacing
from lpvobs.records import Array

FUEL, LAMBDA = "W_f", "lambda"
HEAD = re.compile(r"#\s*(\w+)\s*=\s*([-+.\deE]+)\s*(\S*)")
LEAST_POINTS, MOST_POINTS = 20, 1000
"""Fewer points than corrections have axes and nodes to tell apart; more are no bench table but a log."""
LEAST_RANGE = 1.5
"""Largest over smallest value that the points have at least of flow and map axes: below, they are one operating point."""
AGREES = (0.4 / 0.8, 1.3 / 0.8)
"""Of the flow that the configured engine has: volumetric efficiencies are 0.4 to 1.3, and 0.8 is a usual one."""
AIR_FOR_FUEL, LAMBDA_ERROR = 14.57, 0.05
"""Air over diesel at lambda 1, as the simulated engines have it, and how far fuel, lambda and it may be off together: assumed, for
a wide-band probe and the composition of the fuel are each good to some hundredths."""
RICHEST = 9.0  # air over fuel, both in kg/s; an engine that gets less air than this does not burn (lambda 0.6)
TOLERANCE = "tolerance"
LEAST_IN_MAP, MOST_IN_MAP = 4, 2000  # points: fewer say nothing of a shape; more than any control unit has in one table
MOST_FAR = 0.5
"""Share of a map's points that may be far from the configured engine: maps reach to stall and choke, where formulas end."""
MOST_WRONG = 0.1  # share of the points that may be off: a bench has its slips, a wrong unit is everywhere


def read_bench(paths: Sequence[Path], air_path: base.AirPath) -> dict[str, Array]:
    """Return the points of tables, channels and references in SI, (n,) each; DataError if no engine can be calibrated from them."""
    tables = [_read(path, air_path) for path in paths]
    names = dict.fromkeys(name for table in tables for name in table)
    sizes = [table[REFERENCE].size for table in tables]
    columns = {
        name: np.concatenate([table.get(name, np.full(n, np.nan)) for table, n in zip(tables, sizes, strict=True)])
        for name in names
    }
    where, count = ", ".join(map(str, paths)), sum(sizes)
    if not LEAST_POINTS <= count <= MOST_POINTS:
        raise DataError(
            f"{where}: {count} points in all, expected {LEAST_POINTS} to {MOST_POINTS}; "
            f"record stationary points over the whole range of speed and load"
        )
    for name, unit in (*((axis.channel, axis.unit) for axis in air_path.axes), (REFERENCE, "kg/s")):
        low, high = float(columns[name].min()), float(columns[name].max())
        if high < LEAST_RANGE * low:
            raise DataError(
                f"{where}: column {name} covers only {low:g} to {high:g} {unit}, expected a largest value of at least "
                f"{LEAST_RANGE:g} times the smallest value; add points at other speeds and loads"
            )
    return columns


def _read(path: Path, air_path: base.AirPath) -> dict[str, Array]:
    every = air_path.channels
    needed = {name: item.unit for name, item in every.items() if name != air_path.sensor and item.one_of is None}
    needed[REFERENCE] = "kg/s"
    optional = {DEVIATION: "kg/s", FUEL: "kg/s", LAMBDA: "1"}
    optional |= {part.column: "kg/s" for part in air_path.measured_parts}
    optional |= {name: item.unit for name, item in every.items() if item.one_of is not None}
    found = columns_in(path, [*needed, *optional])
    expect(path, found.schema, needed)
    wanted = {name: unit for name, unit in {**needed, **optional}.items() if name in found.column_names}
    table = {name: column_of(path, found, name, unit) for name, unit in wanted.items()}
    for name, values in table.items():
        _refuse_impossible(path, name, values, every.get(name))
    error = table.setdefault(DEVIATION, METER * np.abs(table[REFERENCE]))
    if not (error > 0.0).all():
        raise DataError(
            f"{path}: column {DEVIATION} is {error.min():g} kg/s at a point, expected more than 0 at every point; correct the table"
        )
    _refuse_meter(path, table, air_path)
    return table


def columns_in(path: Path, names: Sequence[str]) -> "pa.Table":
    """Return those of the named columns that a Parquet file has, or all of any other file, which is a CSV table."""
    if path.suffix.lower() != ".parquet":
        return from_csv(path)
    there, rows = schema_of(path).names, metadata_of(path).num_rows
    refuse_huge(path, rows, len(names))
    (table,) = tables_of(path, [name for name in names if name in there], max(rows, 1))
    return table


def from_csv(path: Path) -> "pa.Table":
    """Return the columns as Parquet would have them, units in metadata; a line `# NAME = VALUE UNIT` is a column of one value."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            lines = [[cell.strip() for cell in line] for line in csv.reader(stream) if any(map(str.strip, line))]
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); name a table of bench points") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: not a readable CSV table ({error}); export it as UTF-8 with commas") from None
    head = [found for line in lines if (found := HEAD.fullmatch(",".join(line)))]
    lines = [line for line in lines if not line[0].startswith("#")]
    names, units = [*lines[:2], [], []][:2]
    columns = [*zip_longest(names, units, *lines[2:], fillvalue="")][: len(names)]
    columns += [(found[1], found[3] or "1", *[found[2]] * len(lines[2:])) for found in head]
    arrays, fields = [], []
    for name, unit, *cells in columns:
        try:
            arrays.append(pa.array([float(cell) if cell else None for cell in cells], pa.float64()))
        except ValueError:
            arrays.append(pa.array(cells))
        fields.append(pa.field(name, arrays[-1].type, metadata={"unit": unit}))
    return pa.table(arrays, schema=pa.schema(fields))


def _refuse_impossible(path: Path, name: str, values: Array, channel: channels.Channel | None) -> None:
    """Raise for values that are not there, or that no sensor reads."""
    lost = np.flatnonzero(~np.isfinite(values))
    if lost.size:
        raise DataError(
            f"{path}: column {name} has no number at point {lost[0] + 1}, expected a number in every row; delete this "
            "row or the column"
        )
    if channel is None or not values.size:
        return
    low, high = channel.typical
    middle = float(np.median(values))
    if not low <= middle <= high or values.min() < channel.low or values.max() > channel.high:
        raise DataError(
            f"{path}: column {name} has values from {values.min():g} to {values.max():g} {channel.unit} with the "
            f"median {middle:g}, "
            f"expected values from {channel.low:g} to {channel.high:g} with a median from {low:g} to {high:g}; check the unit"
        )


def _refuse_meter(path: Path, table: Mapping[str, Array], air_path: base.AirPath) -> None:
    """Raise for a reference that no balance of the engine is near, or with which the fuel cannot burn."""
    rows = rows_of(air_path, unknowns_of({}, air_path.components), [bench_table(air_path, table)])
    refuse_far(path, REFERENCE, rows)
    if FUEL in table and LAMBDA in table:
        burnt = table[LAMBDA] * AIR_FOR_FUEL * table[FUEL]
        off = float(np.median(table[REFERENCE] / burnt)) - 1.0
        if not abs(off) <= LAMBDA_ERROR + 2.0 * float(np.median(table[DEVIATION] / table[REFERENCE])):
            raise DataError(
                f"{path}: {REFERENCE} differs by {100 * off:+.1f} % from the air flow that {FUEL} and {LAMBDA} give "
                f"(stoichiometric ratio {AIR_FOR_FUEL:g}), "
                f"expected at most {100 * LAMBDA_ERROR:g} % plus twice its standard error; check air meter, fuel and lambda probe"
            )
    if FUEL in table:
        burns = table[REFERENCE] >= RICHEST * table[FUEL]
        if np.mean(~burns) > MOST_WRONG:
            worst = float(np.min(table[REFERENCE][~burns] / table[FUEL][~burns]))
            raise DataError(
                f"{path}: {REFERENCE} is only {worst:.3g} times {FUEL} at the richest point, expected at least {RICHEST:g} times, "
                f"because richer mixtures do not burn; check the units of both columns"
            )


def refuse_far(path: Path, name: str, rows: Rows, most: float = MOST_WRONG) -> None:
    """Raise for a flow that the configured engine is far from at more than a share `most` of its points."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = rows.reference / (rows.reference - rows.z)
    own = np.array([kind.column == name for kind in rows.kind])[rows.of]
    near = np.isin(np.unique(rows.point), rows.point[own & (ratio >= AGREES[0]) & (ratio <= AGREES[1])])
    if np.mean(~near) > most:
        raise DataError(
            f"{path}: column {name} is {np.median(ratio[rows.of == 0]):.3g} times the flow of the configured engine (median); "
            f"{np.sum(~near)} of {near.size} points are outside {AGREES[0]:g} to {AGREES[1]:.2g} times; check the column's unit "
            "and the constants in [engine]"
        )


def named_file(text: str, air_path: base.AirPath) -> tuple[str, Path, str]:
    """Return kind, file, and the label behind a DCM file, of `KIND=FILE` or `KIND=FILE.dcm:LABEL`."""
    kind, equals, file = text.partition("=")
    if not equals or kind not in air_path.component_maps:
        known = ", ".join(air_path.component_maps) or "none, because this engine has no corrections"
        raise UsageError(f"--map {text}: expected KIND=FILE; possible values of KIND: {known}")
    name, colon, label = file.rpartition(":")
    return (kind, Path(name), label) if colon and name.lower().endswith(".dcm") else (kind, Path(file), "")


def read_component_map(kind: str, path: Path, label: str, air_path: base.AirPath) -> Table:
    """Return the points of a table; raises DataError for one that lacks a column or cannot be of this engine."""
    known = air_path.component_maps[kind]
    columns, form = _from_dcm(path, label, known) if label else _from_table(path, known)
    for name, values in columns.items():
        for number, value in enumerate(values.tolist(), 1):
            if complaint := form[name].complaint(value):  # with what was probably meant
                raise DataError(f"{path}: column {name}, point {number}: {complaint}")
    tolerance = float(columns.pop(TOLERANCE, [known.tolerance])[0])
    count = next(iter(columns.values())).size
    if not LEAST_IN_MAP <= count <= MOST_IN_MAP:
        raise DataError(
            f"{path}: the table has {count} points, expected {LEAST_IN_MAP} to {MOST_IN_MAP} points in a {kind} table"
        )
    points = known.points(air_path.engine, columns)
    table = Table(points, (known.part,), tolerance, known.flow)
    refuse_far(path, known.part.column, rows_of(air_path, unknowns_of({}, air_path.components), [table]), MOST_FAR)
    return table


def _from_table(path: Path, known: ComponentMap) -> tuple[dict[str, Array], Mapping[str, Within]]:
    """Return the columns of the first form of which the file has the first one, with its tolerance, and what may stand in each."""
    names = dict.fromkeys([name for form in known.forms for name in form] + [TOLERANCE])
    found = columns_in(path, list(names))
    forms = [form for form in known.forms if next(iter(form)) in found.column_names]
    forms.sort(key=lambda form: not set(form) <= set(found.column_names))
    if not forms:
        firsts = " or ".join(next(iter(form)) for form in known.forms)
        raise DataError(
            f"{path}: has no column {firsts}; columns in the file: {', '.join(found.column_names) or 'none'}; rename "
            "the column or name another file"
        )
    for name, within in forms[0].items():
        if name not in found.column_names:
            raise DataError(
                f"{path}: value '{name}' ({within.what}) is missing; give it as a column, "
                f"or as a line '# {name} = VALUE {within.unit}' above the column names"
            )
    form = {**forms[0], TOLERANCE: Within(1e-4, 0.5, "1", "tolerance of a table")}
    there = {name: within.unit for name, within in form.items() if name in found.column_names}
    return {name: column_of(path, found, name, unit) for name, unit in there.items()}, form


def _from_dcm(path: Path, label: str, known: ComponentMap) -> tuple[dict[str, Array], Mapping[str, Within]]:
    """Return the columns of a map whose axes and values have the units of three of the columns, the last of them the values."""
    names, (x, y, values) = list(known.forms[0]), (within.unit for within in known.forms[0].values())
    try:
        item, _ = read_dcm_map(path, label).in_units(x, y, values)
    except ValueError as error:
        wanted = ", ".join(f"{name} [{within.unit}]" for name, within in known.forms[0].items())
        raise DataError(
            f"{path}: map '{label}' has {error}; expected {wanted}; correct the units in the file"
        ) from None
    along_y, along_x = np.meshgrid(item.y, item.x)
    columns = zip(names, (along_x.ravel(), along_y.ravel(), item.values.T.ravel()), strict=True)
    return dict(columns), known.forms[0]


def write_table(path: Path, columns: Mapping[str, Array], units: Mapping[str, str]) -> None:
    """Write columns of equal length, shape (N,), with their units; a name that ends in `.csv` makes a CSV file."""
    if path.suffix.lower() != ".csv":
        write_log(path, columns, units)
        return
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerow(units[name] for name in columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
