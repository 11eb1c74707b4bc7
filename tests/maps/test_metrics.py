"""Errors of a map, by hand on a tiny case, and their floor."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import best_fit, compare

TINY = Grid(np.array([0.0, 10.0]), np.array([1000.0, 2000.0, 3000.0]))


def test_by_hand():
    theta = np.array([[1.0, 2.0], [3.0, 4.0], [np.nan, 6.0]])
    u, n = np.array([0.0, 10.0, 5.0, 0.0, 10.0]), np.array([1000.0, 1000.0, 1500.0, 2500.0, 3000.0])
    reference = np.array([2.0, -2.0, 2.5, 7.0, 0.01])
    # estimates 1, 2, 2.5, unknown, 6; errors -1, 4, 0, -, 5.99; 0.01 is under 1 % of 2.5 and left out of the mean
    found = compare(TINY, theta, u, n, reference)
    assert found.samples == 4
    assert found.mean_relative_error == pytest.approx((0.5 + 2.0 + 0.0) / 3)
    assert found.share_left_out == pytest.approx(0.25)
    rmse = np.sqrt((1.0 + 16.0 + 0.0 + 5.99**2) / 4)
    assert found.rmse == pytest.approx(rmse)
    assert found.bias == pytest.approx((-1.0 + 4.0 + 0.0 + 5.99) / 4)
    assert found.rms_ratio == pytest.approx(rmse / np.sqrt((4.0 + 4.0 + 6.25 + 1e-4) / 4))
    assert found.visited_cells == 2


def test_cells_count_once_they_have_a_compared_sample():
    u, n = np.array([1.0, 9.0, 5.0]), np.array([1100.0, 1900.0, 2500.0])
    theta = np.ones((3, 2))
    assert compare(TINY, theta, u[:2], n[:2], np.ones(2)).visited_cells == 1
    assert compare(TINY, theta, u, n, np.array([1.0, np.nan, 1.0])).visited_cells == 2
    assert compare(TINY, theta, u, n, np.array([1.0, 1.0, np.nan])).visited_cells == 1


def test_an_exact_map_has_no_error_and_floor():
    rng = np.random.default_rng(1)
    theta, u, n = rng.standard_normal((3, 2)), rng.uniform(-1, 11, 500), rng.uniform(900, 3100, 500)
    found = compare(TINY, theta, u, n, TINY.interpolate(theta, u, n))
    assert found.rmse == 0.0
    assert found.mean_relative_error == 0.0
    assert found.floor_rms_ratio < 1e-8  # the ridge of the best fit, 1e-9


@given(st.integers(0, 2**32 - 1))
def test_no_map_comes_under_the_floor(seed):
    rng = np.random.default_rng(seed)
    u, n = rng.uniform(0, 10, 60), rng.uniform(1000, 3000, 60)
    reference = np.sin(0.4 * u) + 1e-3 * n
    optimum = np.linalg.lstsq(
        np.stack([TINY.interpolate(np.eye(6)[i], u, n) for i in range(6)], axis=1), reference, rcond=None
    )[0]
    rival = (optimum + 10 ** rng.uniform(-6, 0) * rng.standard_normal(6)).reshape(3, 2)
    found = compare(TINY, rival, u, n, reference)
    assert found.floor_rms_ratio <= found.rms_ratio * (1 + 1e-7)  # the ridge
    # The floor is attained by the best map, up to the ridge.
    assert compare(TINY, optimum.reshape(3, 2), u, n, reference).rms_ratio == pytest.approx(
        found.floor_rms_ratio, rel=1e-6
    )


def test_the_floor_on_several_columns_is_that_of_dense_least_squares():
    grid = Grid(np.array([0.0, 3.0, 10.0, 11.0]), np.array([1000.0, 1900.0, 2600.0]))
    rng = np.random.default_rng(3)
    u, n = rng.uniform(0, 10, 120), rng.uniform(1000, 2600, 120)  # nothing in the last column
    reference = np.sin(0.7 * u) + 2e-3 * n
    dense = np.stack([grid.interpolate(np.eye(12)[i], u, n) for i in range(12)], axis=1)
    fitted = dense @ np.linalg.lstsq(dense, reference, rcond=None)[0]
    found = compare(grid, np.zeros(grid.shape), u, n, reference)
    assert found.visited_cells == 4
    assert found.rms_ratio == pytest.approx(1.0, rel=1e-14)  # a map of zeros misses all of it
    # The ridge of the best fit, 1e-9, over nodes that are told apart well.
    assert found.floor_rms_ratio == pytest.approx(
        np.sqrt(np.mean((fitted - reference) ** 2) / np.mean(reference**2)), rel=1e-6
    )
    assert found.floor_mean_relative_error == pytest.approx(np.mean(np.abs(fitted / reference - 1.0)), rel=1e-4)


def test_best_fit_is_dense_least_squares_and_zero_where_no_sample_went():
    rng = np.random.default_rng(2)
    u, n = rng.uniform(0, 10, 80), rng.uniform(1000, 2000, 80)
    values = rng.standard_normal(80)
    dense = np.stack([TINY.interpolate(np.eye(6)[i], u, n) for i in range(6)], axis=1)
    expected = np.linalg.lstsq(dense[:, :4], values, rcond=None)[0]
    found = best_fit(TINY, *TINY.regressors(u, n), values)
    np.testing.assert_allclose(found[:4], expected, rtol=0, atol=1e-6)  # the ridge
    np.testing.assert_array_equal(found[4:], 0.0)


@pytest.mark.parametrize("reference", [np.array([np.nan, np.nan]), np.array([0.0, 0.0])])
def test_nothing_to_compare_with_gives_nan_not_a_warning(reference):
    found = compare(TINY, np.ones((3, 2)), np.array([1.0, 2.0]), np.array([1100.0, 1200.0]), reference)
    assert np.isnan(found.mean_relative_error)
    assert np.isnan(found.rms_ratio)


def test_no_estimated_node_gives_no_samples():
    found = compare(TINY, np.full((3, 2), np.nan), np.array([1.0]), np.array([1100.0]), np.array([1.0]))
    assert found.samples == 0
    assert np.isnan(found.rmse)
