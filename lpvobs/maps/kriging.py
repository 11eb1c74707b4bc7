"""Extrapolation by universal kriging: Eq. (37) as trend, and a Gaussian process for what a sensor's error has beyond a quadratic.

z = X beta + f + e at the estimated nodes: beta is not known at all, f is a process with a length along each axis, and e has the
full covariance of the estimate, in which a few constants of the engine move all nodes together. How smooth f is, its lengths and
its amplitude are not known either: every combination counts with its restricted likelihood, in which beta is integrated out
(Patterson and Thompson 1971). So the intervals hold what the data leave open of all of it, and grow with the distance from the
data. Rasmussen and Williams 2006, Eq. (2.41), (2.42), (4.9) and (4.17). No library has all of it: `docs/by-hand.md`.
"""

from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby, product

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.maps import quadratic
from lpvobs.maps.grid import Grid
from lpvobs.records import Array

PROCESSES = ((False, 0.0), (True, 0.0), (True, 0.3))
"""Whether the process is smooth (Gaussian instead of Matern covariance), and its cubic part over its amplitude. An error over the
air flow has one: the flow of an engine is cubic over the map. On 100 surfaces of five families, drawn for this choice, the rms
beyond the data was 0.76 and 0.88 (ETC part 1, FTP75) of the quadratic's, for 0.79 and 0.89 with Matern alone, and 82 and 84 % of
the nodes beyond King's law were inside their 90 % intervals, for 74 and 83; without the cubic part 79 and 83."""
LENGTHS = tuple(np.geomspace(0.1, 3.2, 7).tolist())
"""Half widths of the grid: from less than a node to what nobody can tell from the trend."""
AMPLITUDES = tuple(np.geomspace(0.01, 3.0, 6).tolist())
"""Of the process over the rms of the map: from less than noise to more than any sensor's error has beyond a quadratic."""
USUAL, SPREAD = 0.3, 2.0
"""Of that ratio before any data: middle, and standard deviation of its logarithm. Sensors' errors are no quadratics: with all
amplitudes alike beforehand, 85 instead of 88 % of the nodes beyond FTP75 were inside their 90 % intervals (100 surfaces). With a
standard deviation of one, surfaces that are quadratics paid a tenth of their rms for it."""
LEAST_WEIGHT = 1e-3  # of the likeliest combination: what weighs less changes no interval by a hundredth
ROUNDING = 1e-10  # share of a variance by which a long process without noise stays positive definite
MOST_NODES = 300
"""That tell lengths and amplitude; of more, evenly spread ones are taken, for neighbours on a fine grid say the same."""
Process = tuple[tuple[bool, float], tuple[float, float]]  # one of PROCESSES, and its lengths


@dataclass(frozen=True)
class KnownNodes:
    """What is known at the estimated nodes, and where all nodes lie, in half widths of the grid."""

    place: Array  # (p, 2)
    trend: Array  # (p, 6) terms of the quadratic
    cubes: Array  # (p, 4) terms of third order
    chosen: NDArray[np.int64]  # (N,) nodes that are estimated
    design: Array  # (N, 6) what the estimator finds for each term
    z: Array  # (N,) [kg/s]
    noise: Array  # (N, N) [kg^2/s^2]

    @property
    def size(self) -> float:
        """Rms of the map, which amplitudes are shares of [kg/s]."""
        return float(np.sqrt(np.mean(self.z**2) + np.mean(np.diag(self.noise))))

    def correlation(self, rows: NDArray[np.int64], columns: NDArray[np.int64], process: Process) -> Array:
        """Return the covariance between nodes of a process of amplitude one: Gaussian or Matern of order 5/2, and cubic."""
        (smooth, cubic), lengths = process
        away = [(self.place[rows, None, i] - self.place[columns, i]) / lengths[i] for i in (0, 1)]
        square = away[0] ** 2 + away[1] ** 2
        if smooth:
            found = np.exp(-0.5 * square)  # (4.9)
        else:
            r = np.sqrt(5.0 * square)
            found = (1.0 + r + r * r / 3.0) * np.exp(-r)  # (4.17)
        if cubic:
            found += (cubic * self.cubes[rows]) @ (cubic * self.cubes[columns]).T
        return np.asarray(found)

    def thinned(self, most: int) -> "KnownNodes":
        """Return the same with at most so many estimated nodes."""
        kept = np.arange(0, self.chosen.size, -(-self.chosen.size // most))
        own = np.ix_(kept, kept)
        return replace(self, chosen=self.chosen[kept], design=self.design[kept], z=self.z[kept], noise=self.noise[own])


class Weighted:
    """The map under one process and amplitude; both sides are whitened by the covariance of process and noise."""

    def __init__(self, data: KnownNodes, amplitude: float, correlation: Array):
        self.data, self.power = data, amplitude**2
        covariance = self.power * correlation + data.noise
        covariance[np.diag_indices_from(covariance)] *= 1.0 + ROUNDING
        self.root = np.linalg.cholesky(covariance)
        self.whitened = partial(scipy.linalg.solve_triangular, self.root, lower=True, check_finite=False)
        both = self.whitened(np.column_stack([data.design, data.z]))
        self.X, self.z = both[:, :-1], both[:, -1]
        self.information = self.X.T @ self.X
        self.beta = np.linalg.solve(self.information, self.X.T @ self.z)

    def log_likelihood(self) -> float:
        """Return the restricted one, but for a constant."""
        left = self.z - self.X @ self.beta
        half = np.log(np.diag(self.root)).sum() + 0.5 * np.linalg.slogdet(self.information)[1]
        return float(-half - 0.5 * left @ left)

    def predicted(self, nodes: NDArray[np.int64], across: Array) -> tuple[Array, Array, Array, Array]:
        """Return values at nodes, their errors' covariance with those of the estimated nodes, over the noise's, and two factors.

        `across` is the correlation of the estimated nodes with these. The covariance of the errors at these nodes is the process's
        own, less the square of the first factor (what the estimated nodes tell), and with that of the second (the trend's error).
        """
        data = self.data
        near = self.whitened(self.power * across)
        beyond = data.trend[nodes].T - self.X.T @ near
        trend = np.linalg.solve(self.information, beyond)
        weights = near + self.X @ trend
        root = np.linalg.cholesky(np.linalg.inv(self.information))
        return weights.T @ self.z, self.whitened(weights, trans=1), near, root.T @ beyond


def krige(
    grid: Grid, theta: Array, covariance: Array, supported: NDArray[np.bool_], design: Array, smooth: bool = False
) -> quadratic.Filled:
    """Return the map with every node filled by universal kriging; with `smooth` the estimated nodes are replaced as well.

    The map theta, shape (p_2, p_1) [kg/s], and its covariance, shape (p, p) [kg^2/s^2], engine included, are read at supported
    nodes only; `design`, shape (p, 6), is as for `lpvobs.maps.quadratic.fit`. Raises DataError if the estimated nodes do not
    determine the six coefficients of Eq. (37).
    """
    data = known_nodes(grid, theta, covariance, supported, design)
    few, size = data.thinned(MOST_NODES), data.size
    choices, found = [], []
    for process in product(PROCESSES, product(LENGTHS, LENGTHS)):
        correlation = few.correlation(few.chosen, few.chosen, process)
        for amplitude in size * np.array(AMPLITUDES):
            choices.append((process, amplitude))
            found.append(Weighted(few, amplitude, correlation).log_likelihood())
    lengths, amplitudes = np.array([process[1] for process, _ in choices]), np.array([each for _, each in choices])
    likelihoods = found - 0.5 * (np.log(amplitudes / size / USUAL) / SPREAD) ** 2
    weights = np.exp(likelihoods - likelihoods.max())
    kept = np.flatnonzero(weights >= LEAST_WEIGHT)
    weights = weights[kept] / weights[kept].sum()
    filled = np.arange(grid.size) if smooth else np.flatnonzero(~supported)
    # Mean and square of the mixture, the spread of the means included, of the trend's coefficients and of the values.
    beta, beta_square = np.zeros(6), np.zeros((6, 6))
    values, square = np.zeros(filled.size), np.zeros((filled.size, filled.size))
    joint = np.zeros((data.chosen.size, filled.size))
    places = ((data.chosen, data.chosen), (data.chosen, filled), (filled, filled))
    for process, alike in groupby(zip(weights, kept, strict=True), lambda item: choices[item[1]][0]):
        own, across, among = (data.correlation(*pair, process) for pair in places)
        power, less, more = 0.0, [], []  # one sum of large matrices for all amplitudes of a process
        for weight, choice in alike:
            of_it = Weighted(data, choices[choice][1], own)
            mean, shared, near, trend = of_it.predicted(filled, across)
            power += weight * of_it.power
            less.append(np.sqrt(weight) * near)
            more.append(np.sqrt(weight) * np.vstack([trend, mean]))
            values += weight * mean
            beta += weight * of_it.beta
            beta_square += weight * np.linalg.inv(of_it.information)
            beta_square += np.outer(weight * of_it.beta, of_it.beta)
            joint += weight * shared
        among *= power
        square += among
        for sign, factors in ((-1.0, less), (1.0, more)):
            factor = np.concatenate(factors)
            square += sign * (factor.T @ factor)
    back, spread = quadratic.to_raw(grid), 0.5 * (beta_square + beta_square.T) - np.outer(beta, beta)
    whole = np.zeros((grid.size, grid.size))
    if not smooth:
        joint = data.noise @ joint
        whole[np.ix_(data.chosen, data.chosen)] = data.noise
        whole[np.ix_(data.chosen, filled)], whole[np.ix_(filled, data.chosen)] = joint, joint.T
    whole[np.ix_(filled, filled)] = 0.5 * (square + square.T) - np.outer(values, values)
    map_values = np.where(supported, theta, 0.0).ravel()
    map_values[filled] = values
    code = quadratic.SMOOTHED if smooth else quadratic.ESTIMATED
    half_widths = 0.5 * np.array([np.ptp(grid.fuel), np.ptp(grid.speed)])
    return quadratic.Filled(
        method="kriging",
        coefficients=back @ beta,
        standard_error=np.sqrt(np.diag(back @ spread @ back.T)),
        lack_of_fit=float(np.exp(weights @ np.log(amplitudes[kept]))),
        lengths=half_widths * np.exp(weights @ np.log(lengths[kept])),
        nodes=int(data.chosen.size),
        delta_W_c=map_values.reshape(grid.shape),
        covariance=whole,
        map_standard_error=quadratic.standard_errors(grid, whole),
        support=np.where(supported, code, quadratic.EXTRAPOLATED).astype(np.int8),
    )


def known_nodes(grid: Grid, theta: Array, covariance: Array, supported: NDArray[np.bool_], design: Array) -> KnownNodes:
    """Return what `krige` knows, from the same arguments."""
    trend = quadratic.terms_at_nodes(grid)
    x, y = place = trend[:, 1], trend[:, 3]
    chosen = np.flatnonzero(supported)
    quadratic.refuse_too_few(design[chosen])
    cubes = np.stack([x**3, x * x * y, x * y * y, y**3], axis=-1)
    z, noise = theta.ravel()[chosen], covariance[np.ix_(chosen, chosen)]
    return KnownNodes(np.stack(place, axis=-1), trend, cubes, chosen, design[chosen], z, noise)
