"""The mixture of balances: sound weights, the least variance, the density of its error."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference import visits

from lpvobs.maps.grid import Grid
from lpvobs.observer.balance_errors import LEAST_DENSITY, LEAST_TIME, Evidence, cell_numbers
from lpvobs.observer.balance_errors import mix as mixed
from lpvobs.observer.cells import LONGEST_VISIT

GRID = Grid(np.array([0.0, 4.0, 8.0, 20.0]), np.array([500.0, 1000.0, 2000.0]))
ROWS, COLUMNS = 2, 3
NO_LEVERAGE = np.zeros(ROWS * COLUMNS)  # residuals about the truth, not about a fit


def drive(seed, B=2, q=3, N=900, common=0.5):
    """Return what `mix` needs: residuals that share a part, a wandering operating point, two segments."""
    rng = np.random.default_rng(seed)
    u = 10.0 + 10.0 * np.sin(np.cumsum(rng.normal(0, 0.05, N)))
    n = 1250.0 + 750.0 * np.sin(np.cumsum(rng.normal(0, 0.05, N)))
    steps = rng.uniform(0.005, 0.02, N)
    steps[[0, N // 3]] = 0.0
    sizes = 10.0 ** rng.uniform(-4, -2, (B, 1))
    residual = sizes * (rng.standard_normal((B, N)) + common * rng.standard_normal(N))
    slope = 0.03 * rng.standard_normal((B, q, 1)) * (1.0 + 0.1 * rng.standard_normal((B, q, N)))
    cells = cell_numbers(GRID, GRID.regressors(u, n)[0])
    return residual, slope, np.full(q, 0.01**2 / 3), steps, cells, ((0, N // 3), (N // 3, N))


def mix(residual, slope, variance, steps, cells, segments, leverage):
    """Return the mixture, with the visits gathered in plain loops."""
    found = visits.evidence(residual, slope, steps, cells, segments, ROWS * COLUMNS, LONGEST_VISIT)
    return mixed((ROWS, COLUMNS), Evidence(*found, leverage), variance)


def slow(data):
    residual, slope, variance, steps, cells, segments = data
    return visits.covariances(
        residual, slope, variance, steps, cells, segments, ROWS, COLUMNS, LONGEST_VISIT, LEAST_TIME, LEAST_DENSITY
    )


def test_cells_are_numbered_row_by_row():
    u, n = np.meshgrid([2.0, 6.0, 10.0], [700.0, 1500.0])
    np.testing.assert_array_equal(cell_numbers(GRID, GRID.regressors(u.ravel(), n.ravel())[0]), np.arange(6))
    outside = cell_numbers(GRID, GRID.regressors(np.array([-9.0, 99.0]), np.array([0.0, 9000.0]))[0])
    np.testing.assert_array_equal(outside, [0, 5])


@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_weights_lie_between_zero_and_one_and_sum_to_one(seed, B):
    share = mix(*drive(seed, B=B, N=200), NO_LEVERAGE).share
    assert share.shape == (6, B)
    assert share.min() >= 0.0
    np.testing.assert_allclose(share.sum(axis=1), 1.0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("common", [0.0, 0.5, 5.0])
@pytest.mark.parametrize("B", [2, 3])
def test_no_other_mixture_has_less_variance(B, common):
    data = drive(1, B=B, common=common)
    share = mix(*data, NO_LEVERAGE).share
    _, covariance = slow(data)
    fine = np.linspace(0.0, 1.0, 201 if B == 2 else 61)
    rivals = np.array([w for w in product(fine, repeat=B - 1) if sum(w) <= 1.0 + 1e-12])
    rivals = np.column_stack([rivals, 1.0 - rivals.sum(axis=1)])
    variance = np.einsum("ca,cab,cb->c", share, covariance, share)
    brute = np.einsum("wa,cab,wb->wc", rivals, covariance, rivals)
    # Never worse than the best of the net, and the net, half a per cent fine, comes close to it.
    assert (variance <= brute.min(axis=0) * (1 + 1e-9)).all()
    assert (brute.min(axis=0) <= variance * 1.02).all()


def test_strongly_correlated_errors_leave_one_balance_out():
    """Two balances with a common error: the unconstrained optimum would give the worse one a negative weight."""
    rng = np.random.default_rng(2)
    residual, slope, variance, steps, cells, segments = drive(2, q=0)
    shared = rng.standard_normal(cells.size)
    residual = np.stack([1e-3 * shared, 3e-3 * shared + 1e-4 * rng.standard_normal(cells.size)])
    share = mix(residual, slope, variance, steps, cells, segments, NO_LEVERAGE).share
    np.testing.assert_array_equal(share[:, 1], 0.0)
    np.testing.assert_array_equal(share[:, 0], 1.0)


def test_density_is_that_of_the_mixture():
    data = drive(3)
    found = mix(*data, NO_LEVERAGE)
    noise, _ = slow(data)
    # The least density is about a millionth of these.
    np.testing.assert_allclose(found.density, np.einsum("ca,cab,cb->c", found.share, noise, found.share), rtol=1e-5)


def test_density_of_white_noise_is_variance_times_step():
    rng = np.random.default_rng(4)
    N, h, sigma = 60_000, 0.01, 2e-3
    cells = np.repeat(rng.integers(0, 6, N // 50), 50)
    residual = sigma * rng.standard_normal((1, N))
    found = mix(residual, np.zeros((1, 0, N)), np.empty(0), np.full(N, h), cells, ((0, N),), NO_LEVERAGE)
    # Some 200 visits in each of six cells, averaged with neighbours: the variance of a variance over about 500 visits, 6 %.
    np.testing.assert_allclose(found.density, sigma**2 * h, rtol=0.25)


def test_a_slow_error_counts_for_more_than_a_fast_one_of_the_same_size():
    rng = np.random.default_rng(5)
    N = 20_000
    fast = 1e-3 * rng.standard_normal(N)
    slowly = np.repeat(1e-3 * rng.standard_normal(N // 100), 100)
    cells = np.repeat(rng.integers(0, 6, N // 100), 100)
    residual = np.stack([fast, slowly])
    share = mix(residual, np.zeros((2, 0, N)), np.empty(0), np.full(N, 0.01), cells, ((0, N),), NO_LEVERAGE).share
    assert share[:, 0].min() > 0.95  # the ratio of the densities is a hundred


def test_uncertain_constants_count_against_a_balance():
    residual, slope, _, steps, cells, segments = drive(6, q=1, common=0.0)
    residual[1] = residual[0][::-1]
    slope[0], slope[1] = 0.05, 0.0
    lenient = mix(residual, slope, np.array([1e-12]), steps, cells, segments, NO_LEVERAGE).share
    strict = mix(residual, slope, np.array([0.1]), steps, cells, segments, NO_LEVERAGE).share
    assert (lenient[:, 0] > 0.05).all()
    assert (strict[:, 0] < 1e-2).all()


def test_a_cell_that_nobody_visited_has_a_density_too():
    residual, slope, variance, steps, cells, segments = drive(7)
    found = mix(residual, slope, variance, steps, np.zeros_like(cells), segments, NO_LEVERAGE)
    assert (found.density > 0).all()
    assert np.isfinite(found.density).all()


def test_visits_that_the_map_used_up_are_no_evidence():
    """White noise on two-second visits to one cell, residuals about the four nodes that fit it best: the density is the noise's."""
    rng = np.random.default_rng(6)
    N, h, sigma, found, naive = 1000, 0.01, 2e-3, [], []
    steps, zero = np.full(N, h), np.zeros((1, 0, N))
    for _ in range(300):
        # five visits, each at a place of its own, so that the fit takes four of five visit means away
        u, n = np.repeat(rng.uniform(0.0, 4.0, 5), 200), np.repeat(rng.uniform(500.0, 1000.0, 5), 200)
        nodes, weights = GRID.regressors(u, n)
        X = np.zeros((N, GRID.size))
        np.put_along_axis(X, nodes, weights, axis=1)
        noise = sigma * rng.standard_normal(N)
        residual = (noise - X @ np.linalg.lstsq(X, noise, rcond=None)[0])[None]
        cells = cell_numbers(GRID, nodes)
        leverage = np.zeros(ROWS * COLUMNS)
        leverage[0] = 4.0
        arguments = (residual, zero, np.empty(0), steps, cells, ((0, N),))
        found.append(mix(*arguments, leverage).density[0])
        naive.append(mix(*arguments, NO_LEVERAGE).density[0])
    assert np.mean(naive) < 0.4 * sigma**2 * h
    # One visit in five is left: 300 draws of one degree of freedom know the mean to 8 %.
    np.testing.assert_allclose(np.mean(found), sigma**2 * h, rtol=0.3)
