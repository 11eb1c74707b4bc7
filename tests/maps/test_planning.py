"""What to drive next: the time that a plan asks for, against driving that long."""

import numpy as np
import pytest

from lpvobs.maps.excitation import corners, excitation, plan
from lpvobs.maps.grid import Grid

GRID = Grid(fuel=np.arange(0.0, 21.0, 4.0), speed=np.arange(0.0, 1251.0, 250.0))
RATE, SIGMA = 100.0, 1e-3
"""[Hz] of white noise of so many [kg/s]."""


def driven(seconds):
    """Return operating points spread evenly over each cell for so long, shape (cells,) [s], and their time."""
    rng = np.random.default_rng(3)
    u, n = [], []
    columns = GRID.fuel.size - 1
    for cell, length in enumerate(seconds):
        count = round(length * RATE)
        u.append(GRID.fuel[cell % columns] + 4.0 * rng.random(count))
        n.append(GRID.speed[cell // columns] + 250.0 * rng.random(count))
    u, n = np.concatenate(u), np.concatenate(n)
    return u, n, np.arange(u.size) / RATE


def known(seconds):
    """Return excitation, covariance of the nodes and which are known after such a drive, by the textbook's normal equations."""
    u, n, time = driven(seconds)
    found = excitation(GRID, u, n, time, ((0, time.size),))
    nodes, weights = GRID.regressors(u, n)
    X = np.zeros((time.size, GRID.size))
    np.put_along_axis(X, nodes, weights, axis=1)
    gram = X.T @ X
    seen = np.diag(gram) > 0
    covariance = np.zeros_like(gram)
    covariance[np.ix_(seen, seen)] = SIGMA**2 * np.linalg.inv(gram[np.ix_(seen, seen)])
    return found.cells(), covariance, seen.reshape(GRID.shape)


def worst(covariance, cell):
    nodes = corners(*GRID.shape)[cell]
    return np.linalg.eigvalsh(covariance[np.ix_(nodes, nodes)])[-1]


@pytest.mark.parametrize("cell", [0, 4, 2])
def test_driving_as_long_as_planned_reaches_the_goal(cell):
    seconds = np.full(25, 20.0)
    seconds[cell] = 0.5  # at a corner or an edge: in the middle, neighbours would know its nodes for it
    cells, covariance, seen = known(seconds)
    found = plan(GRID, seen, cells, covariance, np.sqrt(np.diag(covariance)).reshape(GRID.shape))
    before = worst(covariance, cell)
    seconds[cell] += found.time.ravel()[cell]
    after = worst(known(seconds)[1], cell)
    assert before > 2.0 * found.goal**2
    assert 0.5 < after / found.goal**2 < 1.5  # the rate is a median of cells: neighbours help some more than others


def test_a_cell_nobody_drove_comes_before_known_ones_and_far_ones_are_left_out():
    seconds = np.zeros(25)
    seconds[[0, 1, 5, 6]] = 20.0
    cells, covariance, seen = known(seconds)
    deviation = np.where(seen, np.sqrt(np.diag(covariance)).reshape(GRID.shape), 0.01)
    found = plan(GRID, seen, cells, covariance, deviation)
    assert np.isnan(found.time[4, 4])
    assert np.isfinite(found.time[2, 2])
    assert all(cells[cell] == 0.0 for cell in found.cells[:3])
    assert found.deviation[found.cells[0]] == 0.01


def test_equally_known_cells_leave_little_to_do():
    cells, covariance, seen = known(np.full(25, 20.0))
    found = plan(GRID, seen, cells, covariance, np.sqrt(np.diag(covariance)).reshape(GRID.shape))
    assert np.nanmax(found.time) < 40.0  # twice the drive: edges know less than the middle, whose goal it is


def test_no_noise_no_plan():
    seen = np.ones(GRID.shape, dtype=bool)
    nothing = np.zeros((GRID.size, GRID.size))
    assert plan(GRID, seen, np.ones((5, 5)), nothing, np.zeros(GRID.shape)) is None


def test_the_time_for_a_second_of_excitation():
    cells, _, _ = known(np.full(25, 36.0))
    assert cells == pytest.approx(1.0, rel=0.1)  # 3600 random points: their mean square wanders by a few per cent
