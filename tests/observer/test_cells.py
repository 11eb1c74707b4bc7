"""The sums by cell against a plain loop over the samples and a list of visits."""

from itertools import pairwise

import numpy as np
import pytest
from reference.membership import psi

from lpvobs.maps.grid import Grid
from lpvobs.observer.cells import LONGEST_VISIT, add, end_visit, no_sums, no_visit

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
    i = int(np.clip(np.searchsorted(GRID.u_delta, u) - 1, 0, 1))
    j = int(np.clip(np.searchsorted(GRID.n_e, n) - 1, 0, 2))
    return 2 * j + i, [3 * j + i, 3 * j + i + 1, 3 * j + i + 3, 3 * j + i + 4]


def plain(u, n, steps, z, slope, terms):
    """Return the same sums sample by sample, with the visits as lists of samples."""
    sums = no_sums(GRID, B, Q)
    visits, before, stay = [], -1, 0.0
    for k in range(N):
        c, nodes = cell_of(u[k], n[k])
        row = psi(GRID.u_delta, GRID.n_e, u[k], n[k])[nodes] * steps[k]
        sums.gram[c] += np.outer(row, row) / steps[k]
        sums.right[c] += np.outer(z[:, k], row)
        sums.slope[c] += slope[:, :, k, None] * row
        sums.terms[c] += np.outer(terms[k], row)
        if c != before or stay >= LONGEST_VISIT:
            visits.append((c, []))
            stay = 0.0
        visits[-1][1].append((steps[k] * z[:, k], row))
        before, stay = c, stay + steps[k]
    for c, samples in visits:
        integral, row = (sum(item[part] for item in samples) for part in (0, 1))
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


def test_no_visit_leaves_nothing():
    sums = no_sums(GRID, B, Q)
    end_visit(sums, no_visit(B))
    assert all(not values.any() for values in sums)
    assert sums.gram.shape == (6, 4, 4)
