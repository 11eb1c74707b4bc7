"""CDFX (ASAM CDF 2.0) and INCA's label lists for further calibration tools; maps in the units of control units."""

from collections.abc import Sequence
from dataclasses import replace
from xml.sax.saxutils import escape

import numpy as np

from lpvobs.errors import UsageError
from lpvobs.io.calibration.dcm import DcmMap
from lpvobs.io.logs.units import canonical, convert
from lpvobs.io.results.surfaces import LEFT_OUT, NONE, Surface
from lpvobs.io.templates import filled
from lpvobs.records import Array

FACTOR, PERCENT, PER_STROKE = "factor", "%", "mg/cycle"


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
    return replace(
        surface,
        values=np.where(known, values, np.nan),
        standard_error=np.where(known, np.abs(by) * surface.standard_error, np.nan),
        covariance=surface.covariance * np.outer(scale, scale),
        origin=np.where(known, surface.origin, LEFT_OUT).astype(np.int8),
        unit=name,
    )


def cdfx_text(item: DcmMap, digits: int, comments: Sequence[str]) -> str:
    """Return a map as CDF 2.0: a value group for every Y, with the values along X; both axes are the map's own."""
    how = {"plain": _plain, "rounded": lambda value: f"{value:.{digits}g}"}
    return filled("lpvobs.io.calibration", "map.cdfx", how, item=item, comments=comments)


def _plain(said: str) -> str:
    return escape("".join(letter for letter in said if letter.isprintable()))


def lab_text(parameters: Sequence[str], channels: Sequence[str]) -> str:
    """Return a label list of INCA: parameters to calibrate, and channels that a log needs, to measure."""
    return "\r\n".join(["[SETTINGS]", "Version;V1.1", "", "[RAMCELL]", *channels, "", "[LABEL]", *parameters, ""])
