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
import scipy.ndimage
from numba import njit
from numpy.typing import NDArray

from lpvobs.maps.grid import Grid
from lpvobs.records import Array

LONGEST_VISIT = 2.0
"""[s]; a longer stay in a cell counts as several visits."""
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
    p_1 = grid.u_delta.size
    return np.asarray(nodes[:, 0] // p_1 * (p_1 - 1) + nodes[:, 0] % p_1, dtype=np.int64)


def mix(
    grid: Grid,
    residual: Array,
    slope: Array,
    constants_variance: Array,
    steps: Array,
    cells: NDArray[np.int64],
    segments: tuple[tuple[int, int], ...],
    leverage: Array,
) -> Mixture:
    """Return the mixture of B balances with the least variance, random and constant errors together, in every cell.

    Parameters
    ----------
    grid : Grid
    residual : ndarray, shape (B, N)
        [kg/s], sensor minus balance, about each balance's own map.
    slope : ndarray, shape (B, q, N)
        [kg/s], of each balance by each relative constant.
    constants_variance : ndarray, shape (q,)
    steps : ndarray, shape (N,)
        [s]
    cells : ndarray of int, shape (N,)
    segments : tuple of (start, stop)
    leverage : ndarray, shape (p_2 - 1, p_1 - 1)
        Nodes that the own map has fitted to the data of each cell.
    """
    shape = (grid.n_e.size - 1, grid.u_delta.size - 1)
    count = shape[0] * shape[1]
    power, spent = np.zeros((count, residual.shape[0], residual.shape[0])), np.zeros(count)
    visits = np.zeros(count)
    for start, stop in segments:
        part = slice(start, stop)
        _visits(residual[:, part], steps[part], cells[part], LONGEST_VISIT, power, spent, visits)
    left = spent * np.clip(1.0 - leverage.ravel() / np.maximum(visits, 1.0), LEAST_LEFT, 1.0)
    time = _pool(spent, shape) + LEAST_TIME
    evidence = _pool(left, shape) + LEAST_TIME
    noise = (_pool(power, shape) + LEAST_TIME * power.sum(0) / left.sum()) / evidence[:, None, None]
    noise = noise + LEAST_DENSITY * np.eye(noise.shape[-1])
    mean_slope = _pool(_sums(slope, steps, cells, spent.size), shape) / time[:, None, None]
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
    """Return values per cell averaged with those of neighbouring cells, shape as given."""
    spread = values.reshape(*shape, *values.shape[1:])
    sigma = (1.0, 1.0, *[0.0] * (values.ndim - 1))
    return np.asarray(scipy.ndimage.gaussian_filter(spread, sigma, mode="constant", truncate=3.0).reshape(values.shape))


def _sums(slope: Array, steps: Array, cells: NDArray[np.int64], count: int) -> Array:
    """Return the integral of each slope over the time in each cell, shape (count, B, q)."""
    B, q, _ = slope.shape
    sums = np.zeros((count, B, q))
    for b in range(B):
        for i in range(q):
            sums[:, b, i] = np.bincount(cells, steps * slope[b, i], minlength=count)
    return sums


@njit(cache=True)
def _visits(residual, steps, cells, longest, power, spent, visits):  # type: ignore[no-untyped-def]
    B, N = residual.shape
    integral = np.zeros(B)
    stay = 0.0
    for k in range(N):
        for b in range(B):
            integral[b] += steps[k] * residual[b, k]
        stay += steps[k]
        if k == N - 1 or cells[k + 1] != cells[k] or stay >= longest:
            for a in range(B):
                for b in range(B):
                    power[cells[k], a, b] += integral[a] * integral[b]
            spent[cells[k]] += stay
            visits[cells[k]] += 1.0
            integral[:] = 0.0
            stay = 0.0
