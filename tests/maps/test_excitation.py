"""Which nodes and cells a drive informs (Eq. 29)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import membership

from lpvobs.maps.excitation import excitation
from lpvobs.maps.grid import Grid

SMALL = Grid(np.array([0.0, 4.0, 10.0]), np.array([500.0, 1000.0, 2000.0, 2500.0]))


def wander(seed, N=400):
    """Return an uneven drive over and beyond the small grid."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.005, 0.03, N))
    return rng.uniform(-2, 12, N), rng.uniform(300, 2700, N), time


def of(grid, u, n, time, segments=None):
    return excitation(grid, u, n, time, segments or ((0, time.size),))


def test_gram_is_the_plain_double_loop():
    u, n, time = wander(1)
    slow = membership.gram(SMALL.fuel, SMALL.speed, u, n, time)
    # Sums of 400 products, each rounded a few times.
    np.testing.assert_allclose(of(SMALL, u, n, time).gram, slow, rtol=0, atol=1e-14 * slow.max() * 400)


def test_cells_are_the_smallest_eigenvalues_of_the_time_spent_there():
    u, n, time = wander(2)
    found = of(SMALL, u, n, time).cells()
    for j in range(3):
        for i in range(2):
            total = np.zeros((4, 4))
            nodes = [j * 3 + i, j * 3 + i + 1, j * 3 + i + 3, j * 3 + i + 4]
            for k in range(1, time.size):
                at_u = np.clip(np.searchsorted(SMALL.fuel, u[k]) - 1, 0, 1)
                at_n = np.clip(np.searchsorted(SMALL.speed, n[k]) - 1, 0, 2)
                if (at_u, at_n) == (i, j):
                    row = membership.psi(SMALL.fuel, SMALL.speed, u[k], n[k])[nodes]
                    total += (time[k] - time[k - 1]) * np.outer(row, row)
            # Eigenvalues are good to eps times the largest entry, of the order of a second.
            assert found[j, i] == pytest.approx(max(np.linalg.eigvalsh(total)[0], 0.0), abs=1e-13)


def test_segments_do_not_count_the_gap_and_logs_add_up():
    u, n, time = wander(3)
    time[200:] += 1000.0
    whole = of(SMALL, u, n, time, ((0, 200), (200, 400)))
    first, second = (of(SMALL, u[part], n[part], time[part]) for part in (slice(0, 200), slice(200, 400)))
    total = first + second
    np.testing.assert_allclose(whole.gram, total.gram, rtol=0, atol=1e-12)  # rounding of 1000 s time stamps
    np.testing.assert_allclose(whole.cell_gram, total.cell_gram, rtol=0, atol=1e-12)
    # Psi sums to one, so the whole Gram sums to the time driven: the gap is not in it.
    assert whole.gram.sum() == pytest.approx(time[199] - time[0] + time[399] - time[200], rel=1e-12)


def test_time_that_informs_a_node_when_all_others_are_unknown():
    u, n, time = wander(4)
    excited = of(SMALL, u, n, time)
    expected = 1.0 / np.diag(np.linalg.inv(excited.gram))  # Schur complement of all other nodes
    # The ridge is 1e-9 of the largest diagonal entry and is subtracted again to first order.
    np.testing.assert_allclose(excited.nodes(), expected, rtol=1e-5)
    assert (excited.nodes() <= np.diag(excited.gram)).all()


def test_standing_on_a_node_informs_it_alone_for_as_long_as_it_lasts():
    time = np.linspace(0.0, 8.0, 801)
    excited = of(SMALL, np.full(801, 4.0), np.full(801, 1000.0), time)
    expected = np.zeros(SMALL.size)
    expected[1 * 3 + 1] = 8.0
    np.testing.assert_allclose(excited.nodes(), expected, rtol=1e-13)  # the ridge is taken back, up to rounding
    assert excited.cells().max() == 0.0


@pytest.mark.parametrize(
    ("u_ends", "n_ends"),
    [
        ((0.5, 3.5), (700.0, 700.0)),
        ((2.0, 2.0), (550.0, 950.0)),
        ((0.3, 3.9), (520.0, 930.0)),
        ((1.0, 2.5), (990.0, 600.0)),
    ],
)
def test_a_straight_line_through_a_cell_does_not_inform_its_four_nodes(u_ends, n_ends):
    s = np.linspace(0.0, 1.0, 5001)
    u, n = (end[0] + (end[1] - end[0]) * s for end in (u_ends, n_ends))
    excited = of(SMALL, u, n, 100.0 * s)
    # 100 s in the cell; the functions on a line span at most three dimensions of four. What is left is the ridge, 1e-9 of 100 s.
    assert excited.cells()[0, 0] < 1e-9
    assert excited.nodes().max() < 1e-4


def test_hours_of_idling_elsewhere_do_not_make_up_for_a_line():
    """What is left of a line must be small beside the line itself, not beside the longest stay of the drive."""
    grid = Grid(np.arange(0.0, 57.0, 4.0), np.arange(0.0, 4001.0, 250.0))
    s = np.tile(np.linspace(0.0, 1.0, 1500), 20)
    hours = np.full(360_000, 1.0)
    u, n = np.concatenate((4.0 * hours, 20.0 + 3.9 * s)), np.concatenate((750.0 * hours, 1510.0 + 230.0 * s))
    nodes = of(grid, u, n, 0.1 * np.arange(u.size)).nodes().reshape(grid.shape)
    assert nodes[6:8, 5:7].max() < 0.02  # 3000 s on a line in this cell


def test_a_curve_through_the_same_cell_does():
    s = np.linspace(0.0, 1.0, 5001)
    u, n = 2.0 + 2.0 * np.cos(6.28 * s), 750.0 + 250.0 * np.sin(12.0 * s)
    excited = of(SMALL, u, n, 100.0 * s)
    assert excited.cells()[0, 0] > 0.5
    np.testing.assert_array_equal(np.flatnonzero(excited.nodes() >= 1.0), [0, 1, 3, 4])


@given(st.integers(0, 2**32 - 1))
def test_more_data_never_inform_less(seed):
    u, n, time = wander(seed, 120)
    part, whole = of(SMALL, u[:80], n[:80], time[:80]), of(SMALL, u, n, time)
    # Gram matrices grow in the sense of Loewner; the ridge, 1e-9 of about a second, and its removal leave their own size.
    assert (whole.nodes() >= part.nodes() - 1e-8).all()
    assert (whole.cells() >= part.cells() - 1e-12).all()


def test_a_drive_without_a_step_informs_nothing():
    one = np.array([2.0])
    excited = excitation(SMALL, one, np.array([700.0]), np.array([0.0]), ((0, 1),))
    assert excited.nodes().max() == 0.0
    assert excited.cells().max() == 0.0
