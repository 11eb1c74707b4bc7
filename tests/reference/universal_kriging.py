"""Universal kriging by the textbook: the trend's coefficients get a prior so wide that it says nothing, and one normal distribution
of everything is conditioned on the data. No Cholesky factors, no formulas of restricted likelihood."""

import numpy as np
from scipy.special import gamma, kv

WIDE = 1e3
"""Times the rms of the data, of a coefficient."""


def matern(r, order=2.5):
    """Return the Matern correlation by its general formula, Rasmussen and Williams, Eq. (4.14)."""
    s = np.sqrt(2.0 * order) * np.maximum(r, 1e-6)
    return np.where(r < 1e-6, 1.0, 2.0 ** (1.0 - order) / gamma(order) * s**order * kv(order, s))


def conditioned(place, trend, chosen, design, z, noise, lengths, amplitude, order=2.5, cubic=0.0):
    """Return values of all nodes, their covariance, and the logarithm of the likelihood of z but for a constant.

    For a wide prior it is the restricted likelihood. Of endless order the process has the Gaussian correlation; besides it there
    are the four terms of third order, each with `cubic` times its amplitude.
    """
    away = [(place[:, None, i] - place[None, :, i]) / lengths[i] for i in (0, 1)]
    r = np.hypot(*away)
    process = amplitude**2 * (matern(r, order) if np.isfinite(order) else np.exp(-(r**2) / 2))
    for power in range(4):
        term = place[:, 0] ** (3 - power) * place[:, 1] ** power
        process = process + (cubic * amplitude) ** 2 * np.outer(term, term)
    wide = (WIDE * np.sqrt(np.mean(z**2))) ** 2
    every = process + wide * trend @ trend.T
    seen = process[np.ix_(chosen, chosen)] + wide * design @ design.T + noise
    cross = process[:, chosen] + wide * trend @ design.T
    mean = cross @ np.linalg.solve(seen, z)
    covariance = every - cross @ np.linalg.solve(seen, cross.T)
    return mean, covariance, -0.5 * z @ np.linalg.solve(seen, z) - 0.5 * np.linalg.slogdet(seen)[1]
