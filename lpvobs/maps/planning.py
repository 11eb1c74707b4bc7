"""Which cells of the map to drive next, and for how long, until their nodes are as well known as those of the others."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.maps.excitation import corners
from lpvobs.maps.grid import Grid
from lpvobs.records import Array

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
    near = scipy.ndimage.binary_dilation(visited, np.ones((3, 3), dtype=bool)).ravel()
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
