"""`export`: the map of a result in a file for calibration tools."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from lpvobs.api.files import File, as_path, writing
from lpvobs.errors import DataError, UsageError
from lpvobs.io.calibration.dcm import KINDS, NAME, read_dcm_map
from lpvobs.io.calibration.files import Change, OldMap, as_dcm, changes, understood, write_csv, write_dcm, write_netcdf
from lpvobs.io.calibration.surfaces import Surface, keep_old, onto, read_surface
from lpvobs.io.safety.unchanged import file_digest
from lpvobs.kinds import Count

FORMATS = ("dcm", "csv", "netcdf")
SOURCES = ("map", "extrapolation")


@dataclass(frozen=True)
class Request:
    """What to export, and how.

    Attributes
    ----------
    format : str
        `dcm`, `csv` or `netcdf`.
    source : str
        `map` or `extrapolation`; empty: the extrapolation if the result has one.
    only_estimated : bool
        Leave extrapolated nodes out: old values there if `old` is given.
    old : Path or None
        A DCM file with the map as it was; its axes, units and kind are kept.
    name : str
        Label of the map.
    kind : str
        `KENNFELD` or `GRUPPENKENNFELD`; empty: the old map's, else KENNFELD.
    digits : int
        Significant digits of text; netCDF keeps every number as it is.
    """

    format: str
    source: str = ""
    only_estimated: bool = False
    old: Path | None = None
    name: str = "delta_W_c"
    kind: str = ""
    digits: int = 7

    def __post_init__(self) -> None:
        for option, value, known in (
            ("--format", self.format, FORMATS),
            ("--values", self.source or "map", SOURCES),
            ("--kind", self.kind or "KENNFELD", KINDS),
        ):
            if value not in known:
                raise UsageError(f"{option} {value}: expected {' or '.join(known)}")
        if not NAME.fullmatch(self.name):
            raise UsageError(
                f"--name {self.name}: expected letters, digits, '_', '.', '[' or ']', a letter or '_' first"
            )
        if not 2 <= self.digits <= 17:
            raise UsageError(f"--digits {self.digits}: expected 2 to 17 significant digits")
        if self.kind and self.format != "dcm":
            raise UsageError(f"--kind {self.kind}: only a DCM has kinds of maps; leave it out for {self.format}")
        if self.format == "dcm" and self.only_estimated and self.old is None:
            raise UsageError("--only-estimated: a DCM has a value everywhere; say with --old OLD.dcm which ones stay")


@dataclass(frozen=True)
class Exported:
    """What was written, and what it changes; `changes` is None without an old file."""

    surface: Surface
    changes: list[Change] | None


@dataclass(frozen=True, kw_only=True)
class ExportOutput:
    """A map for calibration tools, and what it changes."""

    out: str
    format: Annotated[str, Meta(extra_json_schema={"enum": FORMATS})]
    values: Annotated[str, Meta(extra_json_schema={"enum": SOURCES})]
    digits: Count
    nodes: Annotated[Mapping[str, Count], Meta(description="By origin.")]
    changes: Sequence[Change] | None


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
) -> Exported:
    """Write the map for calibration tools: what to subtract from a reading.

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
        `KENNFELD` or `GRUPPENKENNFELD`; by default the old map's, else the former.
    digits : int
        Significant digits in DCM and CSV.

    Returns
    -------
    Exported
        `surface` with values of shape (p2, p1) in the unit it names, `changes` against the old map.

    Raises
    ------
    UsageError
        If the request contradicts itself.
    DataError
        If the result or the old file cannot be used, or a DCM would have empty nodes.
    """
    before = None if old is None else as_path(old)
    request = Request(file_format, values, only_estimated, before, name, kind.upper(), digits)
    with writing(out, [result, before]) as target:
        return _exported(as_path(result), target, request)


def _exported(result: Path, out: Path, request: Request) -> Exported:
    surface = read_surface(result, request.source)
    old = _old(request, surface)
    if old is not None:
        surface = onto(surface, old.x, old.y)
    surface = keep_old(surface, None if old is None else old.values, request.only_estimated)
    comments = _comments(result, surface, request)
    if request.format == "csv":
        write_csv(out, surface, request.digits)
    elif request.format == "netcdf":
        write_netcdf(out, surface, comments)
    else:
        kind = request.kind or (old.item.kind if old else "KENNFELD")
        write_dcm(out, as_dcm(surface, request.name, kind, old), request.digits, comments)
    return Exported(surface, None if old is None else changes(surface, old, request.digits))


def _old(request: Request, surface: Surface) -> OldMap | None:
    if request.old is None:
        return None
    item = read_dcm_map(request.old, request.name)
    if item.kind not in KINDS and not request.kind:
        raise DataError(
            f"{request.old}: map '{item.name}' is a {item.kind}, expected {' or '.join(KINDS)}; say which: --kind"
        )
    return understood(request.old, item, surface)


def _comments(result: Path, surface: Surface, request: Request) -> list[str]:
    """Return what a file says of its origin; nothing that depends on the day or the machine."""
    lines = [
        f"lpvobs export of /{surface.source} from {result.name}, sha256 {file_digest(result)}",
        "error of the mass air flow sensor, reading minus truth",
    ]
    if request.format == "dcm":
        lines.append(f"numbers rounded to {request.digits} significant digits")
    if request.old is not None:
        lines.append(f"axes, and values where none is new, from {request.old.name}, sha256 {file_digest(request.old)}")
    return lines
