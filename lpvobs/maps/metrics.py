"""How far a map is from a known error surface, and how close any map on the same grid could come."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.maps.excitation import corners, node_values, over_nodes
from lpvobs.maps.grid import Grid, local
from lpvobs.records import Array, Item

NEGLIGIBLE = 0.01  # samples whose reference is under this share of its maximum are left out of the mean relative error


@dataclass(frozen=True)
class Metrics:
    """Errors of a map along one log, over the samples whose nodes were all estimated.

    The paper does not define the mean relative error behind its 10.41 % and 5.28 %. Here: the mean of
    |estimate - reference| / |reference|, without samples whose |reference| is under 1 % of its maximum.
    """

    samples: Annotated[int, Item("1", "samples compared with the reference")]
    mean_relative_error: Annotated[float, Item("1", "mean of |estimate - reference| / |reference|", gaps=True)]
    share_left_out: Annotated[float, Item("1", "share of samples left out of the mean relative error", gaps=True)]
    rms_ratio: Annotated[float, Item("1", "rms of the error / rms of the reference", gaps=True)]
    rmse: Annotated[float, Item("kg/s", "rms of estimate - reference", gaps=True)]
    bias: Annotated[float, Item("kg/s", "mean of estimate - reference", gaps=True)]
    visited_cells: Annotated[int, Item("1", "cells of the grid with a compared sample")]
    floor_mean_relative_error: Annotated[
        float, Item("1", "the same of the best bilinear fit to the reference", gaps=True)
    ]
    floor_rms_ratio: Annotated[float, Item("1", "rms ratio of the best bilinear fit to the reference", gaps=True)]


def compare(grid: Grid, theta: Array, fuel: Array, speed: Array, reference: Array) -> Metrics:
    """Return the errors of a map, shape (p_2, p_1) [kg/s], NaN where not estimated, along N operating points, shape (N,)."""
    return compare_pieces(grid, theta, lambda: [(fuel, speed, reference)])


def compare_pieces(grid: Grid, theta: Array, pieces: Callable[[], Iterable[tuple[Array, Array, Array]]]) -> Metrics:
    """Return the same for operating points and references that come piece by piece, and are gone through twice."""
    # `pieces` returns fuel, speed and reference, piece by piece, each time from the beginning.
    flat = np.ascontiguousarray(theta, dtype=float).reshape(-1)
    cells = (grid.speed.size - 1) * (grid.fuel.size - 1)
    gram, right, visited = np.zeros((cells, 4, 4)), np.zeros((cells, 4)), np.zeros(cells)  # Psi^T Psi, Psi^T reference
    sums = np.zeros(5)  # samples, largest |reference|, sums of e, e^2, reference^2
    for fuel, speed, reference in pieces():
        _fit_sums(grid.fuel, grid.speed, flat, fuel, speed, reference, gram, right, visited, sums)
    samples, largest = int(sums[0]), sums[1]
    if samples == 0:
        nan = float("nan")
        return Metrics(0, nan, nan, nan, nan, nan, 0, nan, nan)
    total = np.zeros(grid.size)
    np.add.at(total, corners(*grid.shape), right)
    best = node_values(over_nodes(grid, gram), total)
    shares = np.zeros(4)
    for fuel, speed, reference in pieces():
        limit = max(NEGLIGIBLE * largest, np.finfo(float).tiny)
        _relative_sums(grid.fuel, grid.speed, flat, best, fuel, speed, reference, limit, shares)
    counted, relative, floor, floor_squares = shares
    return Metrics(
        samples=samples,
        mean_relative_error=_over(relative, counted),
        share_left_out=1.0 - counted / samples,
        rms_ratio=float(np.sqrt(_over(sums[3], sums[4]))),
        rmse=float(np.sqrt(sums[3] / samples)),
        bias=float(sums[2] / samples),
        visited_cells=int(np.count_nonzero(visited)),
        floor_mean_relative_error=_over(floor, counted),
        floor_rms_ratio=float(np.sqrt(_over(floor_squares, sums[4]))),
    )


def _over(total: float, count: float) -> float:
    return float(total / count) if count > 0 else float("nan")


def best_fit(grid: Grid, nodes: NDArray[np.int64], weights: Array, values: Array) -> Array:
    """Return the node values, shape (p,), whose bilinear map fits N values best; zero where no sample went."""
    return node_values(*normal_equations(grid.size, nodes, weights, values))


def normal_equations(p: int, nodes: NDArray[np.int64], weights: Array, values: Array) -> tuple[Array, Array]:
    """Return the sums of Psi^T Psi, shape (p, p), and of Psi^T times each of N values, shape (p,), from `Grid.regressors`."""
    pairs = (nodes[:, :, None] * p + nodes[:, None, :]).ravel()
    gram = np.bincount(pairs, (weights[:, :, None] * weights[:, None, :]).ravel(), minlength=p * p).reshape(p, p)
    right = np.bincount(nodes.ravel(), (weights * values[:, None]).ravel(), minlength=p)
    return gram.astype(float), right.astype(float)


@njit(cache=True)
def _fit_sums(  # type: ignore[no-untyped-def]
    u_nodes, n_nodes, theta, fuel, speed, reference, gram, right, visited, sums
):
    nodes, psi = np.empty(4, dtype=np.int64), np.empty(4)
    for k in range(reference.size):
        cell = _place(u_nodes, n_nodes, fuel[k], speed[k], nodes, psi)
        truth = reference[k]
        error = _value(theta, nodes, psi) - truth
        if not np.isfinite(error):
            continue
        visited[cell] = 1.0
        for m in range(4):
            right[cell, m] += psi[m] * truth
            for o in range(4):
                gram[cell, m, o] += psi[m] * psi[o]
        sums[0] += 1.0
        sums[1] = max(sums[1], abs(truth))
        sums[2] += error
        sums[3] += error * error
        sums[4] += truth * truth


@njit(cache=True)
def _relative_sums(  # type: ignore[no-untyped-def]
    u_nodes, n_nodes, theta, best, fuel, speed, reference, limit, shares
):
    nodes, psi = np.empty(4, dtype=np.int64), np.empty(4)
    for k in range(reference.size):
        _place(u_nodes, n_nodes, fuel[k], speed[k], nodes, psi)
        truth = reference[k]
        error = _value(theta, nodes, psi) - truth
        if not np.isfinite(error):
            continue
        floor = _value(best, nodes, psi) - truth
        shares[3] += floor * floor
        if abs(truth) >= limit:
            shares[0] += 1.0
            shares[1] += abs(error / truth)
            shares[2] += abs(floor / truth)


@njit(cache=True)
def _place(u_nodes, n_nodes, fuel, speed, nodes, psi):  # type: ignore[no-untyped-def]
    """Fill nodes and weights of one operating point and return the number of its cell."""
    local(u_nodes, n_nodes, fuel, speed, nodes, psi)
    return nodes[0] // u_nodes.size * (u_nodes.size - 1) + nodes[0] % u_nodes.size


@njit(cache=True)
def _value(theta, nodes, psi):  # type: ignore[no-untyped-def]
    """Return Psi theta; a node that takes no part may be unknown."""
    total = 0.0
    for m in range(4):
        if psi[m] != 0.0:
            total += psi[m] * theta[nodes[m]]
    return total
