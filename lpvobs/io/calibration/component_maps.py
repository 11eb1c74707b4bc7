"""Tables of single components from suppliers and control units: read, converted to SI, and refused where they cannot be."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lpvobs.calibration.bench import Table, rows_of
from lpvobs.engines import base, constants
from lpvobs.engines.unknowns import ComponentMap, unknowns_of
from lpvobs.errors import DataError, UsageError
from lpvobs.io.calibration.dcm import read_dcm_map
from lpvobs.io.logs.bench import from_csv, from_parquet, refuse_far
from lpvobs.io.logs.parquet import column_of
from lpvobs.records import Array

TOLERANCE = "tolerance"
LEAST_POINTS, MOST_POINTS = 4, 2000  # fewer say nothing of a shape; more than any control unit has in one table
MOST_FAR = 0.5
"""Share of the points that may be far from the configured engine: maps reach to stall and choke, where formulas end."""


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
    columns, tolerance = _from_dcm(path, label, known) if label else _from_table(path, known)
    count = next(iter(columns.values())).size
    if not LEAST_POINTS <= count <= MOST_POINTS:
        raise DataError(
            f"{path}: the table has {count} points, expected {LEAST_POINTS} to {MOST_POINTS} points in a {kind} table"
        )
    points = known.points(air_path.engine, columns)
    table = Table(points, (known.part,), tolerance, known.flow)
    refuse_far(path, known.part.column, rows_of(air_path, unknowns_of({}, air_path.components), [table]), MOST_FAR)
    return table


def _from_table(path: Path, known: ComponentMap) -> tuple[dict[str, Array], float]:
    """Return the columns of the first form of which the file has the first one, and what it says of its tolerance."""
    names = dict.fromkeys([name for form in known.forms for name in form] + [TOLERANCE])
    found = from_parquet(path, list(names)) if path.suffix.lower() == ".parquet" else from_csv(path)
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
    form = {**forms[0], TOLERANCE: constants.Within(1e-4, 0.5, "1", "tolerance of a table")}
    columns = {
        name: column_of(path, found, name, within.unit) for name, within in form.items() if name in found.column_names
    }
    _refuse_impossible(path, columns, form)
    tolerance = columns.pop(TOLERANCE, [known.tolerance])
    return columns, float(tolerance[0])


def _from_dcm(path: Path, label: str, known: ComponentMap) -> tuple[dict[str, Array], float]:
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
    columns = dict(zip(names, (along_x.ravel(), along_y.ravel(), item.values.T.ravel()), strict=True))
    _refuse_impossible(path, columns, known.forms[0])
    return columns, known.tolerance


def _refuse_impossible(path: Path, columns: Mapping[str, Array], forms: Mapping[str, constants.Within]) -> None:
    """Raise for a value that cannot be, with what was probably meant."""
    for name, values in columns.items():
        for number, value in enumerate(values.tolist(), 1):
            complaint = forms[name].complaint(value)
            if complaint:
                raise DataError(f"{path}: column {name}, point {number}: {complaint}")
