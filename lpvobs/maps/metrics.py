"""How far a map is from a known error surface, and how close any map on the same grid could come."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lpvobs.maps.excitation import node_values
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Item

NEGLIGIBLE = 0.01  # samples whose reference is under this share of its maximum are left out of the mean relative error


@dataclass(frozen=True)
class Metrics:
    """Errors of a map along one log, over the samples whose nodes were all estimated.

    The paper does not define the mean relative error behind its 10.41 % and 5.28 %. Here: the mean of
    |estimate - reference| / |reference|, without samples whose |reference| is under 1 % of its maximum.
    """

    samples: Annotated[int, Item("1", "number of samples compared with the reference")]
    mean_relative_error: Annotated[float, Item("1", "mean of |estimate - reference| / |reference|", gaps=True)]
    share_left_out: Annotated[float, Item("1", "share of samples left out of the mean relative error", gaps=True)]
    rms_ratio: Annotated[float, Item("1", "rms of the error / rms of the reference", gaps=True)]
    rmse: Annotated[float, Item("kg/s", "rms of estimate - reference", gaps=True)]
    bias: Annotated[float, Item("kg/s", "mean of estimate - reference", gaps=True)]
    visited_cells: Annotated[int, Item("1", "number of grid cells that contain a compared sample")]
    floor_mean_relative_error: Annotated[float, Item("1", "mean relative error of the best bilinear fit", gaps=True)]
    floor_rms_ratio: Annotated[float, Item("1", "rms ratio of the best bilinear fit to the reference", gaps=True)]


def compare(grid: Grid, theta: Array, fuel: Array, speed: Array, reference: Array) -> Metrics:
    """Return the errors of a map, shape (p_2, p_1) [kg/s], NaN where not estimated, along N operating points, shape (N,)."""
    return compare_pieces(grid, theta, lambda: [(fuel, speed, reference)])


def compare_pieces(grid: Grid, theta: Array, pieces: Callable[[], Iterable[tuple[Array, Array, Array]]]) -> Metrics:
    """Return the same for operating points and references that come piece by piece, and are gone through twice."""
    # `pieces` returns fuel, speed and reference, piece by piece, each time from the beginning.
    gram, right, visited = np.zeros((grid.size, grid.size)), np.zeros(grid.size), np.zeros(grid.size, dtype=bool)
    samples, largest, sums, shares = 0, 0.0, np.zeros(3), np.zeros(4)
    for fuel, speed, truth, error in _known(grid, theta, pieces()):
        nodes, weights = grid.regressors(fuel, speed)
        more = normal_equations(grid.size, nodes, weights, truth)
        gram, right = gram + more[0], right + more[1]
        visited[nodes[:, 0]] = True  # the first node of a cell tells it from the others
        samples, largest = samples + truth.size, max(largest, float(np.abs(truth).max(initial=0.0)))
        sums += (error.sum(), error @ error, truth @ truth)
    if samples == 0:
        nan = float("nan")
        return Metrics(0, nan, nan, nan, nan, nan, 0, nan, nan)
    best, limit = node_values(gram, right), max(NEGLIGIBLE * largest, np.finfo(float).tiny)
    for fuel, speed, truth, error in _known(grid, theta, pieces()):
        floor, on = grid.interpolate(best, fuel, speed) - truth, np.abs(truth) >= limit
        relative = (np.abs(each[on] / truth[on]).sum() for each in (error, floor))
        shares += (np.count_nonzero(on), *relative, floor @ floor)
    counted, relative_sum, floor_sum, floor_squares = shares
    return Metrics(
        samples=samples,
        mean_relative_error=_over(relative_sum, counted),
        share_left_out=1.0 - counted / samples,
        rms_ratio=float(np.sqrt(_over(sums[1], sums[2]))),
        rmse=float(np.sqrt(sums[1] / samples)),
        bias=float(sums[0] / samples),
        visited_cells=int(np.count_nonzero(visited)),
        floor_mean_relative_error=_over(floor_sum, counted),
        floor_rms_ratio=float(np.sqrt(_over(floor_squares, sums[2]))),
    )


def _known(grid: Grid, theta: Array, pieces: Iterable[tuple[Array, Array, Array]]) -> Iterator[tuple[Array, ...]]:
    """Yield fuel, speed, reference and error of the samples of each piece where all of them are known."""
    for fuel, speed, truth in pieces:
        error = grid.interpolate(np.asarray(theta, dtype=float), fuel, speed) - truth
        on = np.isfinite(error)
        yield fuel[on], speed[on], truth[on], error[on]


def _over(total: float, count: float) -> float:
    return float(total / count) if count > 0 else float("nan")


def best_fit(grid: Grid, nodes: NDArray[np.int64], weights: Array, values: Array) -> Array:
    """Return the node values, shape (p,), whose bilinear map fits N values best; zero where no sample went."""
    return node_values(*normal_equations(grid.size, nodes, weights, values))


def normal_equations(p: int, nodes: NDArray[np.int64], weights: Array, values: Array) -> tuple[Array, Array]:
    """Return the sums of Psi^T Psi, shape (p, p), and of Psi^T times each of N values, shape (p,), from `Grid.regressors`."""
    gram = np.zeros(p * p)
    for a, b in np.ndindex(4, 4):
        gram += np.bincount(nodes[:, a] * p + nodes[:, b], weights[:, a] * weights[:, b], minlength=p * p)
    right = np.bincount(nodes.ravel(), (weights * values[:, None]).ravel(), minlength=p)
    return gram.reshape(p, p), right.astype(float)
