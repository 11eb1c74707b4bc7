"""Extrapolation by universal kriging: Eq. (37) as trend, and a Gaussian process for what a sensor's error has beyond a quadratic.

z = X beta + f + e at the estimated nodes: beta is not known at all, f is a process with the Matern covariance of order 5/2 and a
length along each axis, and e has the full covariance of the estimate, in which a few constants of the engine move all nodes
together. Lengths and amplitude of f are not known either: every combination counts with its restricted likelihood, in which beta
is integrated out (Patterson and Thompson 1971). So the intervals hold what the data leave open of all of it, and grow with the
distance from the data. Rasmussen and Williams 2006, Eq. (2.41), (2.42) and (4.17). No library has all of it: `docs/by-hand.md`.
"""

from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import (
    ESTIMATED,
    EXTRAPOLATED,
    SMOOTHED,
    Filled,
    refuse_too_few,
    scaled_terms,
    standard_errors,
    to_raw,
)
from lpvobs.records import Array

LENGTHS = tuple(np.geomspace(0.1, 3.2, 6).tolist())
"""Half widths of the grid: from less than a node to what nobody can tell from the trend."""
AMPLITUDES = tuple(np.geomspace(0.01, 3.0, 9).tolist())
"""Of the process over the rms of the map: from less than noise to more than any sensor's error has beyond a quadratic."""
USUAL, SPREAD = 0.3, 1.0
"""Of that ratio before any data: middle, and standard deviation of its logarithm. Sensors' errors are no quadratics: with all
amplitudes alike beforehand, 85 instead of 88 % of the nodes beyond FTP75 were inside their 90 % intervals (100 surfaces)."""
LEAST_WEIGHT = 1e-3
"""Of the likeliest combination: what weighs less changes no interval by a hundredth."""
ROUNDING = 1e-10
"""Share of a variance by which a long process without noise stays positive definite."""
MOST_NODES = 300
"""That tell lengths and amplitude; of more, evenly spread ones are taken, for neighbours on a fine grid say the same."""


@dataclass(frozen=True)
class _Data:
    """What is known at the estimated nodes, and where all nodes lie, in half widths of the grid."""

    place: Array  # (p, 2)
    trend: Array  # (p, 6) terms of the quadratic
    chosen: NDArray[np.int64]  # (N,) nodes that are estimated
    design: Array  # (N, 6) what the estimator finds for each term
    z: Array  # (N,) [kg/s]
    noise: Array  # (N, N) [kg^2/s^2]

    def correlation(self, rows: NDArray[np.int64], columns: NDArray[np.int64], lengths: tuple[float, float]) -> Array:
        """Return the Matern correlation of order 5/2 between nodes, Rasmussen and Williams (4.17)."""
        away = [(self.place[rows, None, i] - self.place[columns, i]) / lengths[i] for i in (0, 1)]
        r = np.sqrt(5.0) * np.hypot(*away)
        return np.asarray((1.0 + r + r * r / 3.0) * np.exp(-r))

    def thinned(self, most: int) -> "_Data":
        """Return the same with at most so many estimated nodes."""
        kept = np.arange(0, self.chosen.size, -(-self.chosen.size // most))
        own = np.ix_(kept, kept)
        return _Data(self.place, self.trend, self.chosen[kept], self.design[kept], self.z[kept], self.noise[own])


class _Weighted:
    """The map under one choice of lengths and amplitude; both sides are whitened by the covariance of process and noise."""

    def __init__(self, data: _Data, lengths: tuple[float, float], amplitude: float):
        import scipy.linalg  # takes as long to load as estimating a map

        self.data, self.lengths, self.power = data, lengths, amplitude**2
        covariance = self.power * data.correlation(data.chosen, data.chosen, lengths) + data.noise
        covariance[np.diag_indices_from(covariance)] *= 1.0 + ROUNDING
        self.root = np.linalg.cholesky(covariance)
        self.whitened = partial(scipy.linalg.solve_triangular, self.root, lower=True, check_finite=False)
        self.X, self.z = self.whitened(data.design), self.whitened(data.z)
        self.information = self.X.T @ self.X
        self.beta = np.linalg.solve(self.information, self.X.T @ self.z)

    def log_likelihood(self) -> float:
        """Return the restricted one, but for a constant."""
        left = self.z - self.X @ self.beta
        half = np.log(np.diag(self.root)).sum() + 0.5 * np.linalg.slogdet(self.information)[1]
        return float(-half - 0.5 * left @ left)

    def predicted(self, nodes: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Return values at nodes, the covariance of their errors, and that of the estimated nodes' errors with theirs."""
        data = self.data
        near = self.whitened(self.power * data.correlation(data.chosen, nodes, self.lengths))
        beyond = data.trend[nodes].T - self.X.T @ near
        trend = np.linalg.solve(self.information, beyond)
        weights = near + self.X @ trend
        covariance = self.power * data.correlation(nodes, nodes, self.lengths) - near.T @ near + beyond.T @ trend
        return weights.T @ self.z, covariance, self.whitened(data.noise).T @ weights


def krige(
    grid: Grid, theta: Array, covariance: Array, supported: NDArray[np.bool_], design: Array, smooth: bool = False
) -> Filled:
    """Return the map with every node filled by universal kriging.

    Raises DataError if the estimated nodes do not determine the six coefficients of Eq. (37).

    Parameters
    ----------
    theta : ndarray, shape (p_2, p_1)
        [kg/s]
    covariance : ndarray, shape (p, p)
        Of theta, [kg^2/s^2], engine included; read at supported nodes only.
    supported : ndarray of bool, shape (p_2, p_1)
    design : ndarray, shape (p, 6)
        As for `lpvobs.maps.quadratic.fit`.
    smooth : bool
        Replace estimated nodes as well by what the model makes of all of them.
    """
    data = _data(grid, theta, covariance, supported, design)
    size = float(np.sqrt(np.mean(data.z**2) + np.mean(np.diag(data.noise))))
    few = data.thinned(MOST_NODES)
    choices = [(pair, size * share) for pair in product(LENGTHS, LENGTHS) for share in AMPLITUDES]
    before = [-0.5 * (np.log(amplitude / size / USUAL) / SPREAD) ** 2 for _, amplitude in choices]
    likelihoods = np.array([_Weighted(few, *choice).log_likelihood() for choice in choices]) + before
    weights = np.exp(likelihoods - likelihoods.max())
    kept = np.flatnonzero(weights >= LEAST_WEIGHT)
    weights = weights[kept] / weights[kept].sum()
    filled = np.arange(grid.size) if smooth else np.flatnonzero(~supported)
    beta, values = _Mixture(6), _Mixture(filled.size)
    joint = np.zeros((data.chosen.size, filled.size))
    for weight, choice in zip(weights, kept, strict=True):
        found = _Weighted(data, *choices[choice])
        mean, spread, shared = found.predicted(filled)
        values.add(weight, mean, spread)
        beta.add(weight, found.beta, np.linalg.inv(found.information))
        joint += weight * shared
    lengths, amplitudes = np.array([choices[i][0] for i in kept]), np.array([choices[i][1] for i in kept])
    back = to_raw(grid)
    whole = np.zeros((grid.size, grid.size))
    if not smooth:
        whole[np.ix_(data.chosen, data.chosen)] = data.noise
        whole[np.ix_(data.chosen, filled)], whole[np.ix_(filled, data.chosen)] = joint, joint.T
    whole[np.ix_(filled, filled)] = values.covariance()
    map_values = np.where(supported, theta, 0.0).ravel()
    map_values[filled] = values.mean
    half_widths = 0.5 * np.array([np.ptp(grid.fuel), np.ptp(grid.speed)])
    return Filled(
        method="kriging",
        coefficients=back @ beta.mean,
        standard_error=np.sqrt(np.diag(back @ beta.covariance() @ back.T)),
        lack_of_fit=float(np.exp(weights @ np.log(amplitudes))),
        lengths=half_widths * np.exp(weights @ np.log(lengths)),
        nodes=int(data.chosen.size),
        delta_W_c=map_values.reshape(grid.shape),
        covariance=whole,
        map_standard_error=standard_errors(grid, whole),
        support=np.where(supported, SMOOTHED if smooth else ESTIMATED, EXTRAPOLATED).astype(np.int8),
    )


class _Mixture:
    """Mean and covariance of a mixture of normal distributions, the spread of their means included."""

    def __init__(self, size: int):
        self.mean, self.square = np.zeros(size), np.zeros((size, size))

    def add(self, weight: float, mean: Array, covariance: Array) -> None:
        """Add one of them; the weights add up to one."""
        self.mean += weight * mean
        self.square += weight * (covariance + np.outer(mean, mean))

    def covariance(self) -> Array:
        """Return it once all are added."""
        return np.asarray(0.5 * (self.square + self.square.T) - np.outer(self.mean, self.mean))


def _data(grid: Grid, theta: Array, covariance: Array, supported: NDArray[np.bool_], design: Array) -> _Data:
    n, u = np.meshgrid(grid.speed, grid.fuel, indexing="ij")
    trend = scaled_terms(grid, u, n).reshape(-1, 6)
    chosen = np.flatnonzero(supported)
    refuse_too_few(design[chosen])
    return _Data(
        trend[:, (1, 3)], trend, chosen, design[chosen], theta.ravel()[chosen], covariance[np.ix_(chosen, chosen)]
    )
