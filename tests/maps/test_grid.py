"""The four-node form against the dense Psi(v) of Eq. (18)-(23)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference.membership import membership, psi

from lpvobs.maps.grid import Grid, seek, share

UNEVEN = Grid(np.array([-1.0, 0.5, 4.0, 4.5, 30.0]), np.array([600.0, 610.0, 2000.0, 4100.0]))
# A weight is a quotient and a product of numbers of order one: a few units in the last place.
ROUNDING = 1e-14


def dense(grid, u, n):
    nodes, weights = grid.regressors(np.array([u]), np.array([n]))
    row = np.zeros(grid.size)
    np.add.at(row, nodes[0], weights[0])
    return row


@st.composite
def axes(draw):
    first = draw(st.floats(-50, 50))
    gaps = draw(st.lists(st.floats(0.01, 500), min_size=1, max_size=6))
    return first + np.concatenate(([0.0], np.cumsum(gaps)))


def on_or_off(nodes):
    """Draw a value inside, outside, or exactly on a node."""
    return st.one_of(st.sampled_from(list(map(float, nodes))), st.floats(float(nodes[0]) - 100, float(nodes[-1]) + 100))


@given(st.data(), axes(), axes())
def test_local_form_is_the_dense_one(data, u_nodes, n_nodes):
    u, n = data.draw(on_or_off(u_nodes)), data.draw(on_or_off(n_nodes))
    row = dense(Grid(u_nodes, n_nodes), u, n)
    # Narrow intervals beside far-off values: (v - node) loses about |v| eps / width, at most 3000 * 2e-16 / 0.01.
    np.testing.assert_allclose(row, psi(u_nodes, n_nodes, u, n), rtol=0, atol=1e-10)
    assert abs(row.sum() - 1.0) < 4 * ROUNDING
    assert row.min() >= 0.0
    assert np.count_nonzero(row) <= 4


@pytest.mark.parametrize(
    ("u", "n", "count"),
    [
        (-5.0, 100.0, 1), (99.0, 100.0, 1), (-5.0, 9000.0, 1), (99.0, 9000.0, 1),  # case 1: beyond two edges
        (2.0, 100.0, 2), (2.0, 9000.0, 2),  # case 2: beyond the ends of the speed axis
        (-5.0, 700.0, 2), (99.0, 700.0, 2),  # case 3: beyond the ends of the fuel axis
        (2.0, 700.0, 4), (4.2, 605.0, 4),  # case 4: inside
    ],
)  # fmt: skip
def test_the_four_cases_of_remark_2(u, n, count):
    row = dense(UNEVEN, u, n)
    assert np.count_nonzero(row) == count
    np.testing.assert_allclose(row, psi(UNEVEN.fuel, UNEVEN.speed, u, n), rtol=0, atol=ROUNDING)


def test_a_node_takes_part_alone_where_the_drive_stands_on_it():
    for j, n in enumerate(UNEVEN.speed):
        for i, u in enumerate(UNEVEN.fuel):
            row = dense(UNEVEN, u, n)
            assert row[j * UNEVEN.fuel.size + i] == 1.0  # exact: eta is 0 / width or width / width
            assert np.count_nonzero(row) == 1


def test_a_point_on_a_grid_line_belongs_to_the_interval_below():
    """Intervals are open on the left, Eq. (14) and (15); the weights are the same either way, the cell it counts for is not."""
    nodes, _ = UNEVEN.regressors(np.array([4.0, 4.0 + 1e-9]), np.array([2000.0, 2000.0 + 1e-9]))
    np.testing.assert_array_equal(nodes[:, 0], [1 * 5 + 1, 2 * 5 + 2])


def test_an_interval_is_found_from_any_other():
    """Along a drive the search starts where the last sample was; it must end where a search from nowhere does."""
    nodes = UNEVEN.fuel
    for value in (*nodes, -7.0, 0.2, 4.2, 29.0, 31.0):
        i = int(np.clip(np.searchsorted(nodes, value) - 1, 0, nodes.size - 2))
        assert all(seek(nodes, value, start) == i for start in range(nodes.size - 1))
    assert share(nodes, 1.375, 1) == 0.25  # (1.375 - 0.5) / 3.5
    assert (share(nodes, -9.0, 0), share(nodes, 99.0, 3)) == (0.0, 1.0)


def test_theta_stacks_the_speed_blocks():
    theta = np.arange(UNEVEN.size, dtype=float).reshape(UNEVEN.shape)  # rows are speeds, Eq. (23)
    u, n = np.meshgrid(UNEVEN.fuel, UNEVEN.speed)
    np.testing.assert_array_equal(UNEVEN.interpolate(theta, u.ravel(), n.ravel()), theta.ravel())


def test_interpolation_is_psi_times_theta_and_is_held_outside():
    rng = np.random.default_rng(3)
    theta = rng.standard_normal(UNEVEN.size)
    u, n = rng.uniform(-20, 60, 300), rng.uniform(-500, 6000, 300)
    slow = [psi(UNEVEN.fuel, UNEVEN.speed, *v) @ theta for v in zip(u, n, strict=True)]
    np.testing.assert_allclose(UNEVEN.interpolate(theta, u, n), slow, rtol=0, atol=10 * ROUNDING)
    held = UNEVEN.interpolate(theta, np.clip(u, -1.0, 30.0), np.clip(n, 600.0, 4100.0))
    np.testing.assert_array_equal(UNEVEN.interpolate(theta, u, n), held)


def test_a_bilinear_surface_is_reproduced_inside():
    rng = np.random.default_rng(4)
    u, n = rng.uniform(-1, 30, 200), rng.uniform(600, 4100, 200)
    surface = lambda u, n: 3.0 - 0.2 * u + 1e-3 * n + 4e-5 * u * n  # noqa: E731 the formula is the test
    nodes = surface(UNEVEN.fuel[None, :], UNEVEN.speed[:, None])
    np.testing.assert_allclose(UNEVEN.interpolate(nodes, u, n), surface(u, n), rtol=1e-13)  # rounding


def test_an_unknown_node_spoils_only_what_it_takes_part_in():
    theta = np.zeros(UNEVEN.shape)
    theta[1, 2] = np.nan
    u, n = np.array([2.0, 4.0, 0.5, 4.5, 2.0]), np.array([700.0, 605.0, 700.0, 700.0, 3000.0])
    np.testing.assert_array_equal(np.isnan(UNEVEN.interpolate(theta, u, n)), [True, True, False, False, False])


def test_exactly_one_interval_holds_a_value():
    for value in (-2.0, -1.0, 0.0, 0.5, 4.4999, 30.0, 31.0):
        assert sum(membership(UNEVEN.fuel, value)) == 1.0


@pytest.mark.parametrize(
    "nodes", [[1.0], [0.0, 0.0], [1.0, 0.0], [0.0, np.nan, 2.0], [0.0, np.inf], [[0.0, 1.0], [2.0, 3.0]]]
)
def test_an_axis_that_is_none_is_refused(nodes):
    good = np.array([0.0, 1.0])
    with pytest.raises(ValueError, match="axis speed"):
        Grid(good, np.array(nodes))
    with pytest.raises(ValueError, match="axis fuel"):
        Grid(np.array(nodes), good)
