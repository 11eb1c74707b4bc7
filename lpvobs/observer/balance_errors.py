"""How wrong each balance is in each cell of the map, and the mixture of balances that is least wrong.

The errors are correlated in time (smoothing, transients that the model follows badly), so a variance per sample would promise too
much. What counts for an average is the spectral density at low frequency: the squared integral of the residual over a visit to a
cell, per time of the visit. It is computed from residuals about each balance's own map, which takes out any constant error, and
averaged over neighbouring cells; visits that the own map has used up to fit its nodes are not counted as evidence. Beside it stand
the errors that no time averages out: those of the engine's constants. No weight depends on the noise of the sample it weighs:
weights that correlate with errors bias.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.maps.grid import Grid
from lpvobs.records import Array

LEAST_TIME = 1e-2
"""[s] of the average over all cells that every cell is given, so that one far from any visit has a density, too."""
LEAST_DENSITY = 1e-15
"""[kg^2/s], some hundredths of a milligram per second over a second: far below any sensor; balances without errors need it."""

LEAST_LEFT = 0.05
"""Share of the visits to a cell that count as evidence even if the own map has used up all of them."""


@dataclass(frozen=True)
class Mixture:
    """Per cell of the grid, numbered row by row.

    Attributes
    ----------
    share : ndarray, shape (cells, B)
        Of each balance in the flow; between 0 and 1, sum 1.
    density : ndarray, shape (cells,)
        [kg^2/s], spectral density of the error of sensor minus mixture.
    """

    share: Array
    density: Array


def cell_numbers(grid: Grid, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of the cell, row by row, from the first of its four nodes, shape (N,)."""
    p_1 = grid.fuel.size
    return np.asarray(nodes[:, 0] // p_1 * (p_1 - 1) + nodes[:, 0] % p_1, dtype=np.int64)


@dataclass(frozen=True)
class Evidence:
    """What the visits to each cell say of the errors of B balances, cells numbered row by row.

    Attributes
    ----------
    power : ndarray, shape (cells, B, B)
        [kg^2], over visits, the products of the integrals of the residuals about each balance's own map.
    time : ndarray, shape (cells,)
        [s], spent there.
    visits : ndarray, shape (cells,)
        Their number.
    slope : ndarray, shape (cells, B, q)
        [kg], integral of the slope of each balance by each relative constant.
    leverage : ndarray, shape (cells,)
        Nodes that the own map has fitted to the data of the cell.
    """

    power: Array
    time: Array
    visits: Array
    slope: Array
    leverage: Array


def mix(shape: tuple[int, int], evidence: Evidence, constants_variance: Array) -> Mixture:
    """Return the mixture of balances with the least variance, random and constant errors together, in every cell.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of cells.
    evidence : Evidence
    constants_variance : ndarray, shape (q,)
    """
    spent, power = evidence.time, evidence.power
    left = spent * np.clip(1.0 - evidence.leverage / np.maximum(evidence.visits, 1.0), LEAST_LEFT, 1.0)
    time = _pool(spent, shape) + LEAST_TIME
    usable = _pool(left, shape) + LEAST_TIME
    noise = (_pool(power, shape) + LEAST_TIME * power.sum(0) / left.sum()) / usable[:, None, None]
    noise = noise + LEAST_DENSITY * np.eye(noise.shape[-1])
    mean_slope = _pool(evidence.slope, shape) / time[:, None, None]
    constant = (mean_slope * constants_variance) @ mean_slope.swapaxes(-1, -2)
    share = _least_variance(noise / time[:, None, None] + constant)
    return Mixture(share, np.einsum("ca,cab,cb->c", share, noise, share))


def _least_variance(covariance: Array) -> Array:
    """Return the weights of sum one, none negative, that minimise the variance, shape (cells, B)."""
    B = covariance.shape[-1]
    best = np.zeros(covariance.shape[:2])
    least = np.full(covariance.shape[0], np.inf)
    for chosen in range(1, 2**B):  # every subset of the balances; there are few
        subset = [b for b in range(B) if chosen >> b & 1]
        inverse = np.linalg.inv(covariance[:, subset][:, :, subset])
        weights = inverse.sum(-1) / inverse.sum((-1, -2))[:, None]
        variance = 1.0 / inverse.sum((-1, -2))
        better = (weights >= 0).all(-1) & (variance < least)
        least[better] = variance[better]
        best[better] = 0.0
        best[np.ix_(better, subset)] = weights[better]
    return best


def _pool(values: Array, shape: tuple[int, int]) -> Array:
    """Return values per cell averaged with those of neighbouring cells: a Gaussian of one cell, nothing outside the grid."""
    spread = values.reshape(*shape, -1)
    pooled = np.einsum("jk,kix,li->jlx", _neighbours(shape[0]), spread, _neighbours(shape[1]), optimize=True)
    return np.asarray(pooled.reshape(values.shape))


def _neighbours(count: int) -> Array:
    """Return the weights of the cells in a row about each of them, shape (count, count)."""
    away = np.arange(-3, 4)
    kernel = np.exp(-0.5 * away**2)
    weights = np.zeros((count, count))
    for step, weight in zip(away, kernel / kernel.sum(), strict=True):
        weights += weight * np.eye(count, k=int(step))
    return weights
