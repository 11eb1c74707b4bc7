"""The sums by cell against a plain loop over the samples and a list of visits."""

from itertools import pairwise

import numpy as np
import pytest
from reference.membership import psi

from lpvobs.maps.excitation import Excitation, over_nodes
from lpvobs.maps.grid import Grid
from lpvobs.observer import parts
from lpvobs.observer.cells import LONGEST_VISIT, add, end_visit, no_sums, no_visit
from lpvobs.observer.parts import LogInformation, added_up

GRID = Grid(np.array([0.0, 4.0, 10.0]), np.array([500.0, 1000.0, 2000.0, 2500.0]))
B, Q, TERMS, N = 2, 3, 6, 150


def wander(seed):
    """Return operating points that stay a while, steps, and what goes into the sums."""
    rng = np.random.default_rng(seed)
    u, n = (np.repeat(rng.uniform(*ends, N // 3), 3) for ends in ((-2.0, 12.0), (300.0, 2700.0)))
    slope = rng.standard_normal((B, Q, N))
    slope[0, 1] = 0.0
    return u, n, rng.uniform(0.1, 1.2, N), rng.standard_normal((B, N)), slope, rng.standard_normal((N, TERMS))


def filled(u, n, steps, z, slope, terms, cuts=()):
    sums, visit = no_sums(GRID, B, Q), no_visit(B)
    for start, stop in pairwise((0, *cuts, N)):
        part = slice(start, stop)
        add(sums, visit, GRID, (u[part], n[part]), steps[part], z[:, part], slope[:, :, part], terms[part])
    end_visit(sums, visit)
    return sums


def cell_of(u, n):
    """Return the number of a cell, row by row, and its four nodes."""
    i = int(np.clip(np.searchsorted(GRID.fuel, u) - 1, 0, 1))
    j = int(np.clip(np.searchsorted(GRID.speed, n) - 1, 0, 2))
    return 2 * j + i, [3 * j + i, 3 * j + i + 1, 3 * j + i + 3, 3 * j + i + 4]


def visits_of(u, n, steps):
    """Return the cell of every visit and the numbers of its samples."""
    visits, before, stay = [], -1, 0.0
    for k in range(N):
        c, _ = cell_of(u[k], n[k])
        if c != before or stay >= LONGEST_VISIT:
            visits.append((c, []))
            stay = 0.0
        visits[-1][1].append(k)
        before, stay = c, stay + steps[k]
    return visits


def plain(u, n, steps, z, slope, terms):
    """Return the same sums sample by sample and visit by visit."""
    sums, rows = no_sums(GRID, B, Q), np.empty((N, 4))
    for k in range(N):
        c, nodes = cell_of(u[k], n[k])
        row = psi(GRID.fuel, GRID.speed, u[k], n[k])[nodes] * steps[k]
        sums.gram[c] += np.outer(row, row) / steps[k]
        sums.right[c] += np.outer(z[:, k], row)
        sums.slope[c] += slope[:, :, k, None] * row
        sums.terms[c] += np.outer(terms[k], row)
        rows[k] = row
    for c, samples in visits_of(u, n, steps):
        integral, row = (steps * z)[:, samples].sum(axis=1), rows[samples].sum(axis=0)
        sums.visit_power[c] += np.outer(integral, integral)
        sums.visit_cross[c] += np.outer(integral, row)
        sums.visit_gram[c] += np.outer(row, row)
        sums.visits[c] += 1.0
    return sums


@pytest.mark.parametrize("seed", [1, 2])
def test_sums_and_visits_are_those_of_a_plain_loop(seed):
    drive = wander(seed)
    found, expected = filled(*drive), plain(*drive)
    for name, values in expected._asdict().items():
        # Sums of 150 products of numbers about one, each rounded a few times.
        np.testing.assert_allclose(getattr(found, name), values, rtol=0, atol=1e-12, err_msg=name)
    assert (expected.visits > 2).any()


def test_a_map_of_one_cell_holds_what_lies_beyond_it():
    grid = Grid(np.array([0.0, 4.0]), np.array([500.0, 1000.0]))
    sums, visit = no_sums(grid, 1, 1), no_visit(1)
    u, n = np.array([9.0, -1.0]), np.array([2000.0, 100.0])
    add(sums, visit, grid, (u, n), np.array([0.5, 0.25]), np.array([[3.0, 5.0]]), np.zeros((1, 1, 2)), np.zeros((2, 6)))
    end_visit(sums, visit)
    np.testing.assert_array_equal(sums.gram[0], np.diag([0.25, 0.0, 0.0, 0.5]))
    np.testing.assert_array_equal(sums.right[0, 0], [1.25, 0.0, 0.0, 1.5])
    assert sums.visits.tolist() == [1.0]


def test_a_visit_goes_on_across_a_cut():
    drive = wander(3)
    for whole, cut in zip(filled(*drive), filled(*drive, cuts=(1, 50, 51, 100)), strict=True):
        np.testing.assert_array_equal(whole, cut)


def test_the_power_of_visits_is_that_of_their_residuals_about_the_map_that_fits_best():
    u, n, steps, z, slope, terms = wander(4)
    sums = filled(u, n, steps, z, slope, terms)
    excited = Excitation(over_nodes(GRID, sums.gram), sums.gram.reshape(3, 2, 4, 4))
    found = parts._about_own_map(GRID, excited, sums)
    rows = np.array([psi(GRID.fuel, GRID.speed, *v) for v in zip(u, n, strict=True)])
    root = np.sqrt(steps)[:, None]
    own = np.linalg.lstsq(rows * root, z.T * root, rcond=None)[0]
    residual = (z - (rows @ own).T) * steps
    expected = np.zeros_like(found)
    for c, samples in visits_of(u, n, steps):
        integral = residual[:, samples].sum(axis=1)
        expected[c] += np.outer(integral, integral)
    # The ridge of the best fit, 1e-9, over numbers about one.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_parts_of_logs_add_up_over_the_nodes():
    rng = np.random.default_rng(5)
    visited = np.array([0, 3, 5]), np.array([3])
    logs = [
        LogInformation(
            None, cells, *(rng.standard_normal((cells.size, *shape)) for shape in ((4, 4), (4, 4), (4,), (Q + 6, 4)))
        )
        for cells in visited
    ]
    total, excited = added_up(GRID, Q, logs)
    H, h, coupling, gram = np.zeros((12, 12)), np.zeros(12), np.zeros((12, Q + 6)), np.zeros((12, 12))
    for log in logs:
        for place, cell in enumerate(log.cells):
            i, j = cell % 2, cell // 2
            nodes = [3 * j + i, 3 * j + i + 1, 3 * j + i + 3, 3 * j + i + 4]
            H[np.ix_(nodes, nodes)] += log.H[place]
            gram[np.ix_(nodes, nodes)] += log.gram[place]
            h[nodes] += log.h[place]
            coupling[nodes] += log.coupling[place].T
    for part, whole in ((total.H, H), (total.h, h), (total.coupling, coupling), (excited.gram, gram)):
        np.testing.assert_allclose(part, whole, rtol=0, atol=1e-14)  # a few sums of numbers about one
    assert not excited.cell_gram.reshape(6, 4, 4)[[1, 2, 4]].any()


def test_no_visit_leaves_nothing():
    sums = no_sums(GRID, B, Q)
    end_visit(sums, no_visit(B))
    assert all(not values.any() for values in sums)
    assert sums.gram.shape == (6, 4, 4)
