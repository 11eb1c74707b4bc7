"""`extrapolate`: the quadratic of Eq. (37) into a result."""

from pathlib import Path

import numpy as np

from lpvobs.io.results.results import add_extrapolation, read_result
from lpvobs.maps.quadratic import QuadraticFit, fit, outer_coverage


def extrapolate_result(path: Path) -> tuple[QuadraticFit, float]:
    """Fit the quadratic to the estimated nodes of a stored result and write `/extrapolation` into it.

    Returned beside the fit: the share of outer estimated nodes that it predicts within their 90 % interval.

    The observer as published has no covariance; its nodes then count alike.

    Raises
    ------
    DataError
        If the file is not a result, or its estimated nodes do not determine the quadratic.
    """
    stored = read_result(path)
    known = np.isfinite(stored.covariance).all()
    covariance, noise = (each if known else np.zeros_like(each) for each in (stored.covariance, stored.noise))
    fitted = fit(stored.grid, stored.theta, covariance, stored.supported, noise, stored.design)
    held = outer_coverage(stored.grid, stored.theta, noise, stored.supported, stored.design)
    add_extrapolation(stored, fitted, held)
    return fitted, held
