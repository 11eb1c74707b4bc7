"""`extrapolate`: the quadratic of Eq. (37) into a result."""

from dataclasses import dataclass, replace

import numpy as np

from lpvobs.api.files import File, updating
from lpvobs.io.results.axes import axes_of
from lpvobs.io.results.extrapolations import write_extrapolation
from lpvobs.io.results.results import StoredResult, read_result, update
from lpvobs.kinds import Fraction
from lpvobs.maps.quadratic import QuadraticFit, fit, outer_coverage
from lpvobs.report.outputs import QuadraticOutput


@dataclass(frozen=True, kw_only=True)
class ExtrapolateOutput(QuadraticOutput):
    """The quadratic of Eq. (37), and how often it predicts the outer nodes."""

    result: str
    outer_coverage: Fraction


def extrapolate(result: File) -> tuple[QuadraticFit, float]:
    """Fill the nodes that no log informed from the quadratic of Eq. (37), and write `/extrapolation` into the result.

    Returns
    -------
    fitted : QuadraticFit
        Coefficients in kg/s over the units of the map's axes with standard errors; for every node, value and interval.
    outer_coverage : float
        Share of the outer estimated nodes inside their 90 % interval when they take no part in the fit.

    Raises
    ------
    DataError
        If the file is no result, or its nodes do not determine the quadratic.

    Notes
    -----
    The observer as published has no covariance; its nodes then count alike.
    """
    _, fitted, held = fill(result)
    return fitted, held


def fill(result: File) -> tuple[StoredResult, QuadraticFit, float]:
    """Return what `extrapolate` does behind the result that has it."""
    with updating(result) as path:
        stored = read_result(path)
        known = np.isfinite(stored.covariance).all()
        covariance, noise = (each if known else np.zeros_like(each) for each in (stored.covariance, stored.noise))
        fitted = fit(stored.grid, stored.theta, covariance, stored.supported, noise, stored.design)
        held = outer_coverage(stored.grid, stored.theta, noise, stored.supported, stored.design)
        update(stored, lambda file: write_extrapolation(file, axes_of(file), stored.grid, fitted, held))
    return replace(stored, extrapolation=fitted), fitted, held
