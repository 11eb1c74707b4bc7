"""`export`: the map of a result in a file for calibration tools."""

from dataclasses import dataclass, replace
from pathlib import Path

from lpvobs.api.files import File, as_path, expect_one_of, write_text, writing
from lpvobs.api.known_engine import stored_config
from lpvobs.errors import UsageError
from lpvobs.io.calibration import dcm, files
from lpvobs.io.calibration.a2l import read_a2l_map
from lpvobs.io.calibration.files import Change
from lpvobs.io.logs.units import canonical
from lpvobs.io.results import results, surfaces
from lpvobs.io.safety.atomic import file_digest

FORMATS = ("dcm", "cdfx", "csv", "netcdf", "lab")
SOURCES = ("map", "extrapolation")
WIDEST = 0.1
"""Of the mean air flow: sensors in service are off by up to ten per cent, and what is less sure than that corrects nothing."""
AS_FACTOR = "factor of the mass air flow sensor: truth is reading times factor"


@dataclass(frozen=True)
class Exported:
    """What was written, and what it changes; `changes` is None without an old file."""

    surface: surfaces.Surface
    changes: list[Change] | None
    widest: float  # [kg/s], nodes with a wider 90 % interval to either side were left out
    limited: int = 0  # values that a limit of the control unit has changed


def export(
    result: File,
    out: File,
    file_format: str,
    *,
    values: str = "",
    only_estimated: bool = False,
    old: File | None = None,
    name: str = "delta_W_c",
    kind: str = "",
    digits: int = 7,
    widest: float = WIDEST,
    unit: str = "",
    a2l: File | None = None,
) -> Exported:
    """Write the map for calibration tools: what to subtract from a reading.

    Raises UsageError if the request contradicts itself; DataError if the result or the old file cannot be used, or a DCM would
    have empty nodes.

    Parameters
    ----------
    file_format : str
        `dcm`, `cdfx`, `csv`, `netcdf`; or `lab`, a label list of the map and of the channels that a log needs.
    values : str
        `map` or `extrapolation`; by default the latter if there is one.
    only_estimated : bool
        No extrapolated node: the old value there, or nothing.
    old : path, optional
        A DCM with the map as it was, whose axes, units and kind stay.
    name : str
        Label of the map, in both.
    kind : str
        `KENNFELD` or `GRUPPENKENNFELD`; by default the old map's, which may be FESTKENNFELD, else the former.
    digits : int
        Significant digits in DCM and CSV.
    widest : float
        Share of the mean air flow of the logs. A node whose 90 % interval is wider to either side is left out: it keeps its
        old value, is empty, or in a DCM or CDFX without an old map zero, which corrects nothing.
    unit : str
        Of the values, by default that of the old map or the description, else kg/s: any unit of a flow, `mg/stroke`, `%` of the
        reading, or `factor`: what to multiply the reading with.
    a2l : path, optional
        The control unit's description, whose axes, units, limits and rounding of the map hold. Needs `lpvobs[a2l]`.
    """
    file_format, kind, before = file_format.lower(), kind.upper(), None if old is None else as_path(old)
    described = None if a2l is None else as_path(a2l)
    _refuse_contradictions(file_format, values, only_estimated, before, name, kind, digits)
    with writing(out, [result, before, described]) as target:
        path = as_path(result)
        if file_format == "lab":
            air_path = stored_config(path, results.KIND, results.REMEDY).engine_path()
            write_text(target, files.lab_text([name], [*air_path.channels]), encoding=dcm.ENCODING)
            return Exported(surfaces.read_surface(path, values), None, 0.0)
        most = widest * surfaces.mean_flow(path)
        surface = surfaces.read_surface(path, values)
        its = None if described is None else read_a2l_map(described, name)
        was = None if before is None else dcm.read_dcm_map(before, name)
        if not unit:  # that of the other files, if kg/s cannot be converted to it
            given = its.unit if its is not None else was.unit if was is not None else ""
            unit = given if canonical(given or "kg/s") in (files.PERCENT, files.PER_STROKE) else "kg/s"
        meant = replace(surface, unit={files.FACTOR: "1"}.get(unit, unit))
        known = files.described(described, its, meant) if described and its else None
        known = known if before is None or was is None else files.understood(before, was, meant)
        if known is not None:
            surface = surfaces.onto(surface, known.ours.x, known.ours.y)
        surface = _in_unit(path, surface.without_wide(most), unit)
        kept = None if was is None or known is None else known.ours.values.T
        surface = surfaces.keep_old(surface, kept, only_estimated)
        comments = _comments(path, surface, before)
        if left := int((surface.origin == surfaces.LEFT_OUT).sum()):
            comments.append(
                f"{left} nodes have no correction: their 90 % interval is wider than +-{1e3 * most:.3g} g/s, or no air flow is "
                "known there"
            )
        limited = 0
        if file_format == "csv":
            write_text(target, files.csv_text(surface, digits))
        elif file_format == "netcdf":
            files.write_netcdf(target, surface, comments)
        else:
            kind = kind or (known.item.kind if known else "KENNFELD")
            comments.insert(2, f"numbers rounded to {digits} significant digits")
            item = files.as_dcm(surface, name, kind, known, 1.0 if unit == files.FACTOR else 0.0)
            if unit == files.FACTOR and was is None:
                item = replace(item, long_name=AS_FACTOR)
            if its is not None:
                held, limited = its.fitted(item.values)
                item = replace(item, values=held)
                comments.append(
                    f"{limited} values clipped to the control unit's limits {its.lower:g} to {its.upper:g} {its.unit}"
                )
            if file_format == "dcm":
                write_text(target, dcm.dcm_text(item, digits, comments), encoding=dcm.ENCODING)
            else:
                write_text(target, files.cdfx_text(item, digits, comments))
    changed = None if was is None or known is None else files.changes(surface, known, digits)
    return Exported(surface, changed, most, limited)


def _in_unit(path: Path, surface: surfaces.Surface, unit: str) -> surfaces.Surface:
    share, cylinders = unit in (files.FACTOR, files.PERCENT), 0.0
    if canonical(unit) == files.PER_STROKE:
        cylinders = stored_config(path, results.KIND, results.REMEDY).engine_path().cylinders
        if not cylinders:
            raise UsageError(
                f"--unit {unit}: this kind of engine has no number of cylinders; expected a unit of flow, % or factor"
            )
    mean = surfaces.read_readings(path, surface).values if share else None
    return files.in_unit(surface, unit, mean, cylinders)


def _refuse_contradictions(
    file_format: str, values: str, only_estimated: bool, old: Path | None, name: str, kind: str, digits: int
) -> None:
    expect_one_of("--format", file_format, FORMATS)
    expect_one_of("--values", values or "map", SOURCES)
    expect_one_of("--kind", kind or "KENNFELD", dcm.KINDS)
    if not dcm.NAME.fullmatch(name):
        raise UsageError(
            f"--name {name}: expected a label of letters, digits, '_', '.', '[' or ']' that begins with a letter or '_'"
        )
    if not 2 <= digits <= 17:
        raise UsageError(f"--digits {digits}: expected 2 to 17 significant digits")
    if kind and file_format != "dcm":
        raise UsageError(f"--kind {kind}: only the format dcm has kinds of maps; drop --kind for {file_format}")
    if file_format in ("dcm", "cdfx") and only_estimated and old is None:
        raise UsageError(
            f"--only-estimated: a {file_format.upper()} needs a value at every node; give other nodes a value with --old OLD.dcm"
        )


def _comments(result: Path, surface: surfaces.Surface, old: Path | None) -> list[str]:
    """Return what a file says of its origin; nothing that depends on the day or the machine."""
    error = f"error of the mass air flow sensor, reading minus truth, {surface.unit}"
    lines = [f"lpvobs export of /{surface.source} from {result.name}, sha256 {file_digest(result)}"]
    lines.append(AS_FACTOR if surface.unit == "1" else error)
    if old is not None:
        lines.append(f"axes, and values of nodes without a new value, from {old.name}, sha256 {file_digest(old)}")
    return lines
