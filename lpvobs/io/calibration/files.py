"""The error map in files for calibration tools, in the units of control units; and what it changes against an old DCM.

Formats are DCM, CDFX (ASAM CDF 2.0), CSV, netCDF, and INCA's label lists.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from lpvobs.errors import DataError, UsageError
from lpvobs.io.calibration.a2l import A2lMap
from lpvobs.io.calibration.dcm import DcmMap
from lpvobs.io.logs.units import canonical, convert
from lpvobs.io.results import hdf, mapping
from lpvobs.io.results.surfaces import LEFT_OUT, NONE, ORIGINS, Surface, surface_layout
from lpvobs.io.templates import filled
from lpvobs.observer.estimate import ERROR
from lpvobs.records import Array, Item

FACTOR, PERCENT, PER_STROKE = "factor", "%", "mg/cycle"


@dataclass(frozen=True)
class Change:
    """One node whose number differs from the old file's, both as they stand in the files."""

    x: float  # in the unit of the surface's axis
    y: float  # the same
    old: float  # [unit of the surface]
    new: float  # [unit of the surface]
    origin: str


@dataclass(frozen=True)
class OldMap:
    """A map of a DCM file in our units and directions."""

    item: DcmMap  # as it is in the file
    ours: DcmMap  # X the engine speed, and all in the surface's units
    turned: bool  # engine speed is the file's Y


def understood(path: Path, item: DcmMap, surface: Surface) -> OldMap:
    """Return an old map in the units and directions of the surface; raises DataError if its units are not those of such a map."""
    try:
        return OldMap(item, *item.in_units(surface.x.unit, surface.y.unit, canonical(surface.unit)))
    except ValueError as error:
        raise DataError(
            f"{path}: map '{item.name}' has {error}; expected {surface.x.unit}, {surface.y.unit}, {surface.unit} or units "
            "that convert to these; correct EINHEIT_X, EINHEIT_Y, EINHEIT_W"
        ) from None


def described(path: Path, item: A2lMap, surface: Surface) -> OldMap:
    """Return a map as a control unit's description has it, without values: its axes, where they are fixed, or else our nodes.

    Raises DataError if its units are not those of such a map, or it has fewer points than ours where they are not fixed.
    """
    for axes in ((surface.x, surface.y), (surface.y, surface.x)):
        try:
            x, y = (
                convert(axis.nodes, axis.unit, canonical(its.unit or "1")) if its.points is None else its.points
                for axis, its in zip(axes, item.axes, strict=True)
            )
            unknown, (first, second) = np.full((y.size, x.size), np.nan), item.axes
            found = DcmMap(item.name, "KENNFELD", x, y, unknown, first.unit, second.unit, item.unit or "1")
            old = OldMap(found, *found.in_units(surface.x.unit, surface.y.unit, canonical(surface.unit)))
        except ValueError:
            continue
        for its, own in zip(item.axes, (x, y), strict=True):
            if own.size > its.most:
                raise DataError(
                    f"{path}: the axis of '{item.name}' in {its.unit} has room for {its.most} points, but the axis of our map has "
                    f"{own.size} points; give the control unit's points with --old OLD.dcm"
                )
        return old
    said = ", ".join((*(axis.unit for axis in item.axes), item.unit))
    raise DataError(
        f"{path}: map '{item.name}' has the units {said}; expected {surface.x.unit}, {surface.y.unit}, {surface.unit} or units "
        f"that convert to these; give the unit of the values with --unit"
    )


def as_dcm(surface: Surface, name: str, kind: str, old: OldMap | None, nothing: float = 0.0) -> DcmMap:
    """Return the surface as a map of a DCM file: X the speed and Y the fuel, or as the old file has them, in its units.

    A node that was left out is `nothing`: what corrects nothing. Raises DataError if a node has no value: a DCM cannot say so.
    """
    if empty := int(np.count_nonzero(surface.origin == NONE)):
        raise DataError(
            f"map '{name}': {empty} of {surface.origin.size} nodes have no value, but a DCM needs a value at every node; run "
            f"`lpvobs extrapolate`, or give old values with --old"
        )
    surface = replace(surface, values=np.where(surface.origin == LEFT_OUT, nothing, surface.values))
    group = kind == "GRUPPENKENNFELD"
    if old is None:
        x, y, turned = surface.x, surface.y, False
        x_name, y_name = x.name, y.name
        item = DcmMap(name, kind, x.nodes, y.nodes, surface.values.T, x.unit, y.unit, surface.unit)
    else:
        item, turned, x_name, y_name = old.item, old.turned, "X", "Y"
    return replace(
        item,
        kind=kind,
        values=convert(surface.values if turned else surface.values.T, surface.unit, canonical(item.unit or "1")),
        long_name=item.long_name or ERROR,
        x_name=item.x_name or f"{name}_{x_name}" if group else "",
        y_name=item.y_name or f"{name}_{y_name}" if group else "",
    )


def in_unit(surface: Surface, unit: str, reading: Array | None, cylinders: float) -> Surface:
    """Return a map [kg/s] in another unit; nodes where that cannot be said are left out.

    `%` is a share of the mean reading around the node, shape (p2, p1) [kg/s], and `factor` what to multiply a reading with:
    1 - error / reading. `mg/stroke` is air per cylinder and cycle at the speed of the node, of an engine with so many cylinders.
    """
    share = np.full(surface.values.shape, np.nan) if reading is None else np.where(reading > 0.0, reading, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        if unit in (FACTOR, PERCENT):
            by, name = (-1.0 / share, "1") if unit == FACTOR else (100.0 / share, "%")
        elif canonical(unit) == PER_STROKE:
            by, name = np.broadcast_to(1.2e8 / (cylinders * surface.x.nodes[:, None]), surface.values.shape), unit
        else:
            try:
                by, name = np.full(surface.values.shape, float(convert(np.ones(1), surface.unit, unit)[0])), unit
            except ValueError:
                raise UsageError(
                    f"--unit {unit}: is not a unit of flow; expected for example kg/h, g/s, mg/stroke or %"
                ) from None
        values = by * surface.values + (1.0 if unit == FACTOR else 0.0)
    known = np.isfinite(by) | (surface.origin == NONE)
    scale = np.where(np.isfinite(by), by, 0.0).ravel()
    converted = replace(
        surface,
        values=values,
        standard_error=np.abs(by) * surface.standard_error,
        covariance=surface.covariance * np.outer(scale, scale),
        unit=name,
    )
    return converted.without(~known, LEFT_OUT)


def csv_text(surface: Surface, digits: int) -> str:
    """Return a line per node: axes, value, standard error, origin; units in brackets behind the names, empty where unknown."""
    header = [f"{axis.name} [{axis.unit}]" for axis in (surface.x, surface.y)]
    lines = [[*header, f"delta_W_c [{surface.unit}]", f"standard_error [{surface.unit}]", "origin"]]
    for (i, j), origin in np.ndenumerate(surface.origin):
        numbers = (surface.x.nodes[i], surface.y.nodes[j], surface.values[i, j], surface.standard_error[i, j])
        words = [f"{number:.{digits}g}" if np.isfinite(number) else "" for number in numbers]
        lines.append([*words, ORIGINS[int(origin)]])
    return "".join(f"{','.join(line)}\n" for line in lines)


def cdfx_text(item: DcmMap, digits: int, comments: Sequence[str]) -> str:
    """Return a map as CDF 2.0: a value group for every Y, with the values along X; both axes are the map's own."""
    how = {"plain": _plain, "rounded": lambda value: f"{value:.{digits}g}"}
    return filled("lpvobs.io.calibration", "map.cdfx", how, item=item, comments=comments)


def _plain(said: str) -> str:
    return escape("".join(filter(str.isprintable, said)))


def lab_text(parameters: Sequence[str], channels: Sequence[str]) -> str:
    """Return a label list of INCA: parameters to calibrate, and channels that a log needs, to measure."""
    return "\r\n".join(["[SETTINGS]", "Version;V1.1", "", "[RAMCELL]", *channels, "", "[LABEL]", *parameters, ""])


def write_netcdf(path: Path, surface: Surface, comments: list[str]) -> None:
    """Write a netCDF-4 file by the CF conventions, every number as it is."""
    axes = (surface.x, surface.y)
    contents: hdf.Contents = {axis.name: hdf.Field(axis.nodes, Item(axis.unit, axis.long_name)) for axis in axes}
    contents |= mapping.fields(surface_layout(surface.x.name, surface.y.name, surface.unit, "origin"), surface)
    with hdf.creating(path) as file:
        file.attrs["Conventions"] = "CF-1.8"
        file.attrs["title"] = ERROR
        file.attrs["history"] = "; ".join(comments)
        hdf.write_fields(file, contents)


def changes(surface: Surface, old: OldMap, digits: int) -> list[Change]:
    """Return the nodes whose numbers, both rounded to `digits`, differ from the old ones; first by speed, then by fuel."""
    rounded = np.vectorize(lambda value: float(f"{value:.{digits}g}"), otypes=[float])
    before, after = rounded(old.ours.values.T), rounded(surface.values)
    speed, fuel = np.meshgrid(surface.x.nodes, surface.y.nodes, indexing="ij")
    columns = (each[before != after].tolist() for each in (speed, fuel, before, after, surface.origin))
    return [Change(x, y, was, now, ORIGINS[origin]) for x, y, was, now, origin in zip(*columns, strict=True)]
