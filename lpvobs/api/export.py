"""`export`: the map of a result in a file for calibration tools."""

from dataclasses import dataclass
from pathlib import Path

from lpvobs.api.files import File, as_path, writing
from lpvobs.errors import UsageError
from lpvobs.io.calibration import dcm, surfaces
from lpvobs.io.calibration.files import Change, as_dcm, changes, understood, write_csv, write_dcm, write_netcdf
from lpvobs.io.safety.atomic import file_digest

FORMATS = ("dcm", "csv", "netcdf")
SOURCES = ("map", "extrapolation")
WIDEST = 0.1
"""Of the mean air flow: sensors in service are off by up to ten per cent, and what is less sure than that corrects nothing."""


@dataclass(frozen=True)
class Exported:
    """What was written, and what it changes; `changes` is None without an old file."""

    surface: surfaces.Surface
    changes: list[Change] | None
    widest: float  # [kg/s], nodes with a wider 90 % interval to either side were left out


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
) -> Exported:
    """Write the map for calibration tools: what to subtract from a reading.

    Raises UsageError if the request contradicts itself; DataError if the result or the old file cannot be used, or a DCM would
    have empty nodes.

    Parameters
    ----------
    result : path
    out : path
        The file to write.
    file_format : str
        `dcm`, `csv` or `netcdf`.
    values : str
        `map` or `extrapolation`; by default the latter if there is one.
    only_estimated : bool
        No extrapolated node: the old value there, or nothing.
    old : path, optional
        A DCM with the map as it was: its axes, units and kind stay.
    name : str
        Label of the map.
    kind : str
        `KENNFELD` or `GRUPPENKENNFELD`; by default the old map's, which may be FESTKENNFELD, else the former.
    digits : int
        Significant digits in DCM and CSV.
    widest : float
        Share of the mean air flow of the logs. A node whose 90 % interval is wider to either side is left out: it keeps its
        old value, is empty, or in a DCM without an old map zero, which corrects nothing.
    """
    file_format, kind, before = file_format.lower(), kind.upper(), None if old is None else as_path(old)
    _refuse_contradictions(file_format, values, only_estimated, before, name, kind, digits)
    with writing(out, [result, before]) as target:
        path = as_path(result)
        most = widest * surfaces.mean_flow(path)
        surface = surfaces.read_surface(path, values)
        known = None if before is None else understood(before, dcm.read_dcm_map(before, name), surface)
        if known is not None:
            surface = surfaces.onto(surface, known.x, known.y)
        surface = surfaces.keep_old(surface.without_wide(most), None if known is None else known.values, only_estimated)
        comments = _comments(path, surface, before)
        if left := int((surface.origin == surfaces.LEFT_OUT).sum()):
            comments.append(
                f"{left} nodes without a correction: their 90 % interval exceeds {1e3 * most:.3g} g/s to either side"
            )
        if file_format == "csv":
            write_csv(target, surface, digits)
        elif file_format == "netcdf":
            write_netcdf(target, surface, comments)
        else:
            kind = kind or (known.item.kind if known else "KENNFELD")
            comments.insert(2, f"numbers rounded to {digits} significant digits")
            write_dcm(target, as_dcm(surface, name, kind, known), digits, comments)
    return Exported(surface, None if known is None else changes(surface, known, digits), most)


def _refuse_contradictions(
    file_format: str, values: str, only_estimated: bool, old: Path | None, name: str, kind: str, digits: int
) -> None:
    for option, value, known in (
        ("--format", file_format, FORMATS),
        ("--values", values or "map", SOURCES),
        ("--kind", kind or "KENNFELD", dcm.KINDS),
    ):
        if value not in known:
            raise UsageError(f"{option} {value}: expected {' or '.join(known)}")
    if not dcm.NAME.fullmatch(name):
        raise UsageError(f"--name {name}: expected letters, digits, '_', '.', '[' or ']', a letter or '_' first")
    if not 2 <= digits <= 17:
        raise UsageError(f"--digits {digits}: expected 2 to 17 significant digits")
    if kind and file_format != "dcm":
        raise UsageError(f"--kind {kind}: only a DCM has kinds of maps; leave it out for {file_format}")
    if file_format == "dcm" and only_estimated and old is None:
        raise UsageError("--only-estimated: a DCM has a value everywhere; say with --old OLD.dcm which ones stay")


def _comments(result: Path, surface: surfaces.Surface, old: Path | None) -> list[str]:
    """Return what a file says of its origin; nothing that depends on the day or the machine."""
    lines = [
        f"lpvobs export of /{surface.source} from {result.name}, sha256 {file_digest(result)}",
        "error of the mass air flow sensor, reading minus truth",
    ]
    if old is not None:
        lines.append(f"axes, and values where none is new, from {old.name}, sha256 {file_digest(old)}")
    return lines
