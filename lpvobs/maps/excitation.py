"""Persistency of excitation of every cell, Eq. (29), and which cells to drive next, and for how long."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.maps.grid import Grid
from lpvobs.records import Additive, Array

RIDGE = 1e-9  # share of a node's own time that keeps nodes which nothing tells apart at zero, instead of failing


@dataclass(frozen=True)
class Excitation(Additive):
    """How well a drive excites the map; that of two drives adds up."""

    gram: Array  # (p, p) [s], the integral of Psi^T Psi over the drive
    cell_gram: Array  # (p_2 - 1, p_1 - 1, 4, 4) [s], of the local regressor Psi_l over the time spent in each cell

    def cells(self) -> Array:
        """Return delta_1 of Eq. (29) of every cell, shape (p_2 - 1, p_1 - 1), [s]: the smallest eigenvalue."""
        return np.asarray(np.maximum(np.linalg.eigvalsh(self.cell_gram)[..., 0], 0.0))  # Eq. (29)

    def nodes(self) -> Array:
        """Return the time that informs each node when all others are unknown, shape (p,), [s]."""
        # The reciprocal of the diagonal of the inverse Gram matrix: zero for a node whose value cannot be told from its
        # neighbours', the time spent exactly on the node at best.
        touched = np.flatnonzero(np.diag(self.gram) > 0)
        time = np.zeros(self.gram.shape[0])
        if touched.size:
            stay = np.diag(self.gram)[touched]
            gram = self.gram[np.ix_(touched, touched)] / np.sqrt(stay[:, None] * stay)
            inverse = np.linalg.inv(gram + RIDGE * np.eye(touched.size))
            time[touched] = stay * np.maximum(1.0 / np.diag(inverse) - RIDGE, 0.0)
        return time


def node_values(gram: Array, right: Array) -> Array:
    """Return node values that solve gram theta = right, shape of `right`; zero for nodes without data."""
    # A direction that the data leave open gets the smallest values, by the ridge of `Excitation.nodes`.
    stay = np.diag(gram)
    touched = np.flatnonzero(stay > 0)
    values = np.zeros(right.shape)
    inner = gram[np.ix_(touched, touched)] + np.diag(RIDGE * stay[touched])
    values[touched] = np.linalg.solve(inner, right[touched])
    return values


def of_cells(grid: Grid, gram: Array) -> Excitation:
    """Return the excitation from the integral of Psi_l^T Psi_l over the stay in each cell, cells row by row, (cells, 4, 4) [s]."""
    p_2, p_1 = grid.shape
    total = np.zeros((grid.size, grid.size))
    nodes = corners(p_2, p_1)
    np.add.at(total, (nodes[:, :, None], nodes[:, None, :]), gram)
    return Excitation(total, gram.reshape(p_2 - 1, p_1 - 1, 4, 4))


def corners(p_2: int, p_1: int) -> NDArray[np.int64]:
    """Return the numbers of the four nodes of each cell of a map of p_2 times p_1 nodes, cells row by row, shape (cells, 4)."""
    first = (np.arange(p_2 - 1)[:, None] * p_1 + np.arange(p_1 - 1)).ravel()
    return np.asarray(first[:, None] + np.array([0, 1, p_1, p_1 + 1]))


def cell_numbers(grid: Grid, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of the cell, row by row, from the first of its four nodes, shape (N,)."""
    p_1 = grid.fuel.size
    return np.asarray(nodes[:, 0] // p_1 * (p_1 - 1) + nodes[:, 0] % p_1, dtype=np.int64)


def steps_of(time: Array, segments: tuple[tuple[int, int], ...]) -> Array:
    """Return the time that each sample stands for, shape (N,) [s]; the first of a segment stands for none."""
    steps = np.diff(time, prepend=time[:1])
    steps[[start for start, _ in segments]] = 0.0
    return steps


def excitation(grid: Grid, fuel: Array, speed: Array, time: Array, segments: tuple[tuple[int, int], ...]) -> Excitation:
    """Return the excitation of the map along N operating points, each array of shape (N,)."""
    p_2, p_1 = grid.shape
    step, cells = steps_of(time, segments), np.zeros(((p_2 - 1) * (p_1 - 1), 4, 4))
    nodes, weights = grid.regressors(fuel, speed)
    numbers = cell_numbers(grid, nodes)
    for a, b in np.ndindex(4, 4):
        cells[:, a, b] = np.bincount(numbers, step * weights[:, a] * weights[:, b], minlength=len(cells))  # Eq. (29)
    return of_cells(grid, cells)


EVENLY = 36.0
"""[s] of driving that is spread evenly over a cell for one second of excitation: a hat function and its neighbour have the Gram
matrix [[1/3, 1/6], [1/6, 1/3]] on their interval, with smallest eigenvalue 1/6, and Psi is a product of two such pairs."""
SLOW = 0.9
"""Quantile of the cells' variance at one second of excitation that is taken for all: most learn from their neighbours, too."""
MOST_CELLS = 8


@dataclass(frozen=True)
class Plan:
    """What is left to drive."""

    goal: float  # [kg/s], standard error from noise that the middle one of the estimated nodes has
    # (p_2 - 1, p_1 - 1) [s] to drive in each cell until the worst known combination of its nodes has that standard
    # error, too: zero where it has, NaN where no drive has been in the cell or next to it
    time: Array
    deviation: Array  # (p_2 - 1, p_1 - 1) [kg/s], largest standard error of the cell's nodes as they are now
    cells: tuple[tuple[int, int], ...]  # at most `MOST_CELLS`, the largest fall of variance per second of driving first


def plan(grid: Grid, supported: NDArray[np.bool_], excitation: Array, noise: Array, deviation: Array) -> Plan | None:
    """Return what to drive next; None where no cell tells how fast knowledge grows.

    A second of excitation adds the same to the information about the nodes of any cell: delta_1 of Eq. (29) times the largest
    eigenvalue of the nodes' covariance says how much, in the cells known so far whose neighbours helped least.

    `supported` nodes, shape (p_2, p_1), are estimated; `excitation` [s] is delta_1 of every cell. `noise`, shape (p, p)
    [kg^2/s^2], is the covariance of the nodes from noise alone: more driving does nothing against wrong constants of the
    engine. `deviation`, shape (p_2, p_1) [kg/s], is the standard error of every node as it is now, or what is assumed of one
    without a value.
    """
    nodes = corners(*grid.shape)
    whole = supported.ravel()[nodes].all(1)
    known = whole & (excitation.ravel() > 0.0)
    if not known.any():
        return None
    largest = np.full(whole.size, np.inf)
    blocks = noise[nodes[:, :, None], nodes[:, None, :]]
    largest[whole] = np.linalg.eigvalsh(blocks[whole])[:, -1]
    goal = float(np.median(np.diag(noise)[supported.ravel()]))
    rate = float(np.quantile(largest[known] * excitation.ravel()[known], SLOW))
    if not (goal > 0.0 and rate > 0.0):
        return None
    time = EVENLY * rate * np.maximum(1.0 / goal - 1.0 / largest, 0.0)
    visited = excitation > 0.0
    near = np.lib.stride_tricks.sliding_window_view(np.pad(visited, 1), (3, 3)).any((2, 3)).ravel()
    worst = deviation.ravel()[nodes].max(1)
    worth = np.where(near & (time > 0.0), (worst**2 - goal) / np.maximum(time, 1e-9), 0.0)
    best = [int(i) for i in np.argsort(-worth, kind="stable")[:MOST_CELLS] if worth[i] > 0.0]
    shape = excitation.shape
    return Plan(
        goal=float(np.sqrt(goal)),
        time=np.where(near, time, np.nan).reshape(shape),
        deviation=worst.reshape(shape),
        cells=tuple((i // shape[1], i % shape[1]) for i in best),
    )
