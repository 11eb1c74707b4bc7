"""`extrapolate`: every node of a map, by kriging or by the quadratic of Eq. (37), into a result."""

from dataclasses import replace
from functools import partial
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from lpvobs.api.files import File, expect_one_of, updating
from lpvobs.errors import UsageError
from lpvobs.io.results.results import StoredResult, read_result, update
from lpvobs.io.results.surfaces import axes_of, write_extrapolation
from lpvobs.kinds import Fraction, KgPerS
from lpvobs.maps.kriging import krige
from lpvobs.maps.quadratic import EXTRAPOLATED, Filled, fit, interval_factor, outer_coverage
from lpvobs.records import Array
from lpvobs.report.outputs import QuadraticOutput

METHODS = ("kriging", "quadratic")


class ExtrapolateOutput(QuadraticOutput):
    """How the map was filled, and how often the outer nodes are predicted by the others."""

    result: str
    outer_coverage: Fraction
    half_widths: Annotated[
        tuple[KgPerS, KgPerS] | None,
        Meta(description="kg/s, half-width of the filled nodes' 90 % intervals: the median and the largest."),
    ]


def extrapolate(result: File, method: str = "kriging", *, smooth: bool = False) -> tuple[Filled, float]:
    """Fill the nodes that no log informed, and write `/extrapolation` into the result.

    Raises DataError if the file is no result, or its nodes do not determine the quadratic; UsageError if the method is unknown,
    or a quadratic is to smooth.

    Parameters
    ----------
    method : str
        `kriging`: Eq. (37) as trend, and what the sensor's error has beyond it as a process whose lengths and amplitude come from
        the map; `quadratic`: Eq. (37) alone, as in the paper.
    smooth : bool
        Replace estimated nodes as well by what the process makes of all of them; they are marked `smoothed`.

    Notes
    -----
    The share returned is of the outer estimated nodes: how many lie inside their 90 % interval when they take no part in the fit.
    Coefficients of Eq. (37) are in kg/s over the units of the map's axes. The observer as published has no covariance: its nodes
    count alike, and a quadratic is all that they allow.
    """
    return fill(result, method, smooth)[1:]


def fill(result: File, method: str = "kriging", smooth: bool = False) -> tuple[StoredResult, Filled, float]:
    """Return what `extrapolate` does behind the result that has it."""
    expect_one_of("--method", method, METHODS)
    if smooth and method == "quadratic":
        raise UsageError(
            "--smooth: only --method kriging can smooth the estimated nodes, not the quadratic; drop --smooth, or use --method "
            "kriging"
        )
    with updating(result) as path:
        stored = read_result(path)
        known = bool(np.isfinite(stored.covariance).all())
        if not known and smooth:
            raise UsageError(
                f"--smooth: {path}: smoothing needs a covariance, but a map of method {stored.method} has none; estimate the map "
                "again with --method observer"
            )
        covariance, noise = (each if known else np.zeros_like(each) for each in (stored.covariance, stored.noise))
        grid, theta, design = stored.grid, stored.theta, stored.design

        def under(errors: Array, used: NDArray[np.bool_], smoothed: bool = False) -> Filled:
            if known and method == "kriging":
                return krige(grid, theta, errors, used, design, smoothed)
            return fit(grid, theta, errors, used, noise, design)

        filled = under(covariance, stored.supported, smooth)
        held = outer_coverage(partial(under, noise), grid, theta, noise, stored.supported)
        update(stored, lambda file: write_extrapolation(file, axes_of(file), stored.grid, filled, held))
    return replace(stored, extrapolation=filled), filled, held


def half_widths(filled: Filled) -> tuple[float, float] | None:
    """Return half of the middle and of the widest 90 % interval [kg/s] of the nodes that were filled; None where none was."""
    errors = filled.map_standard_error[filled.support == EXTRAPOLATED]
    half = interval_factor(filled.nodes, 0.9) * errors
    return (float(np.median(half)), float(half.max())) if half.size else None
