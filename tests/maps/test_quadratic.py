"""Extrapolation by Eq. (37): exactness, standard errors, intervals, the paper's coefficients."""

import numpy as np
import pytest

from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.errors import DataError
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import best_fit
from lpvobs.maps.quadratic import (
    COEFFICIENTS,
    evaluate,
    fit,
    interval_factor,
    outer_coverage,
    scaled_terms,
    terms,
)

EQ_39, EQ_40 = PUBLISHED.surfaces.values()
NODE_ERROR = 2e-4  # kg/s, a fifth of a gram per second: what a good estimate leaves


@pytest.fixture(scope="module")
def visited(grid):
    """Return the nodes outside the area that the paper's ETC part 1 leaves out."""
    u, n = grid.fuel[None, :], grid.speed[:, None]
    return (n > 800) & (n < 3200) & ~((u > 40) & (n < 2000))


def on_nodes(grid, coefficients):
    return evaluate(np.array(coefficients), *np.meshgrid(grid.fuel, grid.speed))


def noise_of(grid, seed, correlation=0.4):
    """Return a covariance that couples neighbours, and a function that draws from it."""
    rng = np.random.default_rng(seed)
    n, u = np.divmod(np.arange(grid.size), grid.fuel.size)
    near = np.abs(u[:, None] - u) + np.abs(n[:, None] - n)
    covariance = NODE_ERROR**2 * correlation**near
    root = np.linalg.cholesky(covariance)
    return covariance, lambda: (root @ rng.standard_normal(grid.size)).reshape(grid.shape)


@pytest.mark.parametrize("coefficients", PUBLISHED.surfaces.values(), ids=PUBLISHED.surfaces)
def test_a_noiseless_quadratic_comes_back_in_the_papers_units(grid, visited, coefficients):
    surface = on_nodes(grid, coefficients)
    found = fit(grid, np.where(visited, surface, np.nan), NODE_ERROR**2 * np.eye(grid.size), visited)
    # Coefficients of 1e-9 beside 1e-3: each to a relative 1e-8 shows that the scaling worked; raw normal equations lose them.
    np.testing.assert_allclose(found.coefficients, coefficients, rtol=1e-8)
    np.testing.assert_allclose(found.delta_W_c, surface, rtol=0, atol=1e-14)
    # Nothing is left for a lack of fit but its floor, a millionth of the rms.
    assert found.lack_of_fit < 2e-6 * np.sqrt(np.mean(surface[visited] ** 2))


def test_estimated_nodes_stay_as_they_are_and_filled_ones_are_marked(grid, visited):
    covariance, draw = noise_of(grid, 1)
    theta = np.where(visited, on_nodes(grid, EQ_40) + draw(), np.nan)
    found = fit(grid, theta, covariance, visited)
    np.testing.assert_array_equal(found.delta_W_c[visited], theta[visited])
    np.testing.assert_array_equal(found.support, np.where(visited, 1, 2))
    assert found.support.dtype == np.int8
    np.testing.assert_allclose(found.map_standard_error[visited], NODE_ERROR, rtol=1e-12)
    assert np.isfinite(found.delta_W_c).all()
    assert found.nodes == visited.sum()
    np.testing.assert_allclose(found.delta_W_c[~visited], on_nodes(grid, found.coefficients)[~visited], rtol=1e-9)


def test_covariances_of_nodes_without_support_are_not_read(grid, visited):
    covariance, draw = noise_of(grid, 2)
    theta = on_nodes(grid, EQ_40) + draw()
    hidden = ~visited.reshape(-1)
    wild = covariance.copy()
    wild[hidden] = wild[:, hidden] = 1e6
    a, b = fit(grid, theta, covariance, visited), fit(grid, np.where(visited, theta, np.nan), wild, visited)
    np.testing.assert_array_equal(a.coefficients, b.coefficients)
    np.testing.assert_array_equal(a.map_standard_error, b.map_standard_error)


def test_standard_errors_against_monte_carlo(grid, visited):
    covariance, draw = noise_of(grid, 3)
    surface = on_nodes(grid, EQ_39)
    fits = [fit(grid, surface + draw(), covariance, visited) for _ in range(200)]
    spread = np.std([found.coefficients for found in fits], axis=0)
    stated = np.mean([found.standard_error for found in fits], axis=0)
    # 200 draws know a standard deviation to 5 %. The lack of fit can only be positive, so the statement errs upward a little.
    np.testing.assert_array_less(0.85 * spread, stated)
    np.testing.assert_array_less(stated, 1.25 * spread)


@pytest.mark.parametrize("scatter", [0.0, 5e-4])
def test_prediction_intervals_cover_a_quadratic_with_scatter(grid, visited, scatter):
    covariance, draw = noise_of(grid, 4)
    rng = np.random.default_rng(5)
    hits, count = 0, 0
    for _ in range(120):
        truth = on_nodes(grid, EQ_40) + scatter * rng.standard_normal(grid.shape)
        found = fit(grid, truth + draw(), covariance, visited)
        inside = np.abs(found.delta_W_c - truth) <= interval_factor(found.nodes, 0.9) * found.map_standard_error
        hits, count = hits + inside[~visited].sum(), count + (~visited).sum()
    # 120 surfaces; far nodes of one surface miss together, so of the order of 120 independent looks: 2.7 % each way, twice.
    assert 0.85 < hits / count < 0.965


def test_intervals_cover_errors_that_all_nodes_share(grid, visited):
    """A wrong engine constant moves all nodes together, in a shape that is no quadratic; it must not pass for lack of fit."""
    noise, draw = noise_of(grid, 8)
    rng = np.random.default_rng(9)
    u, n = np.meshgrid(grid.fuel / 56.0, grid.speed / 4000.0)
    shapes = 1e-3 * np.stack([n, n * np.sqrt(u + 0.1), np.sqrt(n + 0.1)]).reshape(3, -1)
    covariance = noise + shapes.T @ shapes
    hits, count = 0, 0
    for _ in range(120):
        theta = on_nodes(grid, EQ_40) + draw() + (rng.standard_normal(3) @ shapes).reshape(grid.shape)
        found = fit(grid, theta, covariance, visited, noise)
        inside = (
            np.abs(found.delta_W_c - on_nodes(grid, EQ_40))
            <= interval_factor(found.nodes, 0.9) * found.map_standard_error
        )
        hits, count = hits + inside[~visited].sum(), count + (~visited).sum()
    # 120 draws of three numbers that move everything: 2.7 % each way, three times, since what is missed is missed everywhere.
    assert 0.82 < hits / count < 0.98


def test_errors_that_nodes_may_share_do_not_excuse_scatter(grid, visited):
    """The constants could be wrong by more than what is seen; the scatter between nodes is a lack of fit all the same."""
    noise, draw = noise_of(grid, 11)
    rng = np.random.default_rng(12)
    shape = 5e-3 * np.sin(np.repeat(grid.speed / 150.0, grid.fuel.size))  # far from any quadratic
    found = [
        fit(grid, theta, noise + np.outer(shape, shape), visited, noise).lack_of_fit
        for theta in (on_nodes(grid, EQ_40) + draw() + 1e-3 * rng.standard_normal(grid.shape) for _ in range(20))
    ]
    # The mean of twenty values that are each good to about 7 %.
    assert np.mean(found) == pytest.approx(1e-3, rel=0.06)


def test_what_the_bilinear_grid_does_to_a_quadratic_is_taken_back(grid, visited):
    """Nodes of the best bilinear fit along a drive lie off the surface; told so by the design, the coefficients are exact."""
    rng = np.random.default_rng(10)
    j, i = np.nonzero(visited[:-1, :-1] & visited[1:, 1:] & visited[1:, :-1] & visited[:-1, 1:])
    cell = rng.integers(j.size, size=20_000)
    u, n = 4.0 * (i[cell] + rng.random(20_000)), 250.0 * (j[cell] + rng.random(20_000))
    regressors = grid.regressors(u, n)
    nodes = best_fit(grid, *regressors, evaluate(np.array(EQ_40), u, n))
    design = np.stack([best_fit(grid, *regressors, column) for column in scaled_terms(grid, u, n).T], axis=1)
    reached = np.bincount(regressors[0].ravel(), regressors[1].ravel(), grid.size).reshape(grid.shape) > 1.0
    covariance = NODE_ERROR**2 * np.eye(grid.size)
    told = fit(grid, nodes.reshape(grid.shape), covariance, reached, design=design)
    untold = fit(grid, nodes.reshape(grid.shape), covariance, reached)
    np.testing.assert_allclose(told.coefficients, EQ_40, rtol=1e-6)  # both fits carry the same ridge of 1e-9
    assert np.abs(untold.coefficients / EQ_40 - 1.0).max() > 1e-3


def test_lack_of_fit_is_the_scatter_around_the_quadratic(grid, visited):
    rng = np.random.default_rng(6)
    covariance, draw = noise_of(grid, 7)
    found = [
        fit(
            grid, on_nodes(grid, EQ_40) + 1e-3 * rng.standard_normal(grid.shape) + draw(), covariance, visited
        ).lack_of_fit
        for _ in range(40)
    ]
    # About 100 nodes know a standard deviation to 7 %, the mean of 40 fits to 1 %.
    assert np.mean(found) == pytest.approx(1e-3, rel=0.04)


def plain_lack(X, z, noise, variances):
    """Return the lack of fit of three rounds of weighting, with every matrix written out."""
    lack = 0.0
    for _ in range(3):
        W = np.diag(1.0 / (variances + lack))
        M = np.eye(z.size) - X @ np.linalg.inv(X.T @ W @ X) @ X.T @ W
        excess = z @ M.T @ W @ M @ z - np.trace(W @ M @ noise @ M.T)
        lack = max(excess / np.trace(W @ M @ M.T), 0.0)
    return np.sqrt(lack)


def test_lack_of_fit_with_nodes_of_very_different_quality():
    small = Grid(np.linspace(0.0, 40.0, 5), np.linspace(1000.0, 3000.0, 5))
    rng = np.random.default_rng(8)
    variances = 10.0 ** rng.uniform(-9.0, -5.0, small.size)
    theta = on_nodes(small, EQ_40) + 1e-3 * rng.standard_normal(small.shape)
    found = fit(small, theta, np.diag(variances), np.ones(small.shape, dtype=bool)).lack_of_fit
    n, u = np.meshgrid(small.speed, small.fuel, indexing="ij")
    X = scaled_terms(small, u, n).reshape(-1, 6)
    expected = plain_lack(X, theta.ravel(), np.diag(variances), variances)
    assert expected > 5e-4  # otherwise both may be zero for another reason
    assert found == pytest.approx(expected, rel=1e-9)  # six digits are lost in the inverse, of sixteen


def test_each_side_is_taken_away_in_turn():
    small = Grid(np.linspace(0.0, 8.0, 9), np.linspace(0.0, 9.0, 10))
    n, u = np.meshgrid(small.speed, small.fuel, indexing="ij")
    left = []
    every, noise = np.ones(small.shape, dtype=bool), 1e-10 * np.eye(90)
    theta = 1e-3 * u + 1e-5 * np.random.default_rng(9).standard_normal(small.shape)

    def watched(supported):
        left.append((u[supported].min(), u[supported].max(), n[supported].min(), n[supported].max()))
        return fit(small, theta, noise, supported)

    outer_coverage(watched, small, theta, noise, every)
    # A fifth of the nodes and what ties with them: of nine columns the outer one, since two are more than a fifth; of ten rows two.
    assert left == [(0, 7, 0, 9), (1, 8, 0, 9), (0, 8, 0, 7), (0, 8, 2, 9)]


def test_nodes_known_exactly_count_alike():
    small = Grid(np.linspace(0.0, 40.0, 5), np.linspace(1000.0, 3000.0, 5))
    theta = on_nodes(small, EQ_40) + 1e-4 * np.random.default_rng(10).standard_normal(small.shape)
    every = np.ones(small.shape, dtype=bool)
    exact = fit(small, theta, np.zeros((25, 25)), every)
    alike = fit(small, theta, 1e-20 * np.eye(25), every)
    np.testing.assert_allclose(exact.coefficients, alike.coefficients, rtol=1e-6)  # a lack of fit of 1e-4 hides 1e-10
    assert exact.lack_of_fit == pytest.approx(alike.lack_of_fit, rel=1e-6)


def test_one_node_known_exactly_makes_all_count_alike():
    """Nothing can be weighted by the reciprocal of a variance of zero."""
    small = Grid(np.linspace(0.0, 40.0, 5), np.linspace(1000.0, 3000.0, 5))
    theta = on_nodes(small, EQ_40) + 1e-4 * np.random.default_rng(11).standard_normal(small.shape)
    every, noise = np.ones(small.shape, dtype=bool), 1e-20 * np.eye(25)
    noise[7, 7] = 0.0
    found, alike = fit(small, theta, noise, every), fit(small, theta, 1e-20 * np.eye(25), every)
    np.testing.assert_allclose(found.coefficients, alike.coefficients, rtol=1e-6)  # a lack of fit of 1e-4 hides 1e-10
    assert found.lack_of_fit == pytest.approx(alike.lack_of_fit, rel=1e-6)


def test_the_papers_two_fits_contradict_each_other_outside():
    u, n = 56.0, 2000.0
    assert evaluate(np.array(EQ_39), u, n) == pytest.approx(-7.0e-3, abs=5e-5)  # printed digits: 0.1 g/s
    assert evaluate(np.array(EQ_40), u, n) == pytest.approx(11.8e-3, abs=5e-5)


def test_order_of_the_terms():
    assert COEFFICIENTS == ("a2", "a1", "b2", "b1", "c2", "c1")
    np.testing.assert_array_equal(terms(np.array(3.0), np.array(5.0)), [9.0, 3.0, 25.0, 5.0, 15.0, 1.0])


def chosen(grid, pairs):
    mask = np.zeros(grid.shape, dtype=bool)
    for j, i in pairs:
        mask[j, i] = True
    return mask


@pytest.mark.parametrize(
    "pairs",
    [
        [],
        [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2)],  # six: determined, but no residual tells the lack of fit
        [(3, i) for i in range(15)],  # one speed only
        [(j, 2) for j in range(17)],  # one fuel quantity only
        [(j, i) for j in (3, 7) for i in range(15)],  # two speeds: a pair of lines is a conic
    ],
)
def test_nodes_that_do_not_determine_six_coefficients_are_refused(grid, pairs):
    with pytest.raises(DataError, match=rf"{len(pairs)} estimated nodes") as failure:
        fit(grid, on_nodes(grid, EQ_40), NODE_ERROR**2 * np.eye(grid.size), chosen(grid, pairs))
    assert "\n" not in str(failure.value)


def test_seven_nodes_off_a_conic_suffice(grid):
    mask = chosen(grid, [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2), (5, 9)])
    found = fit(grid, on_nodes(grid, EQ_39), NODE_ERROR**2 * np.eye(grid.size), mask)
    np.testing.assert_allclose(found.coefficients, EQ_39, rtol=1e-7)


def test_better_known_nodes_count_for_more():
    small = Grid(np.linspace(0.0, 40.0, 5), np.linspace(1000.0, 3000.0, 5))
    theta = on_nodes(small, EQ_40)
    theta[2, 2] += 1e-2
    every = np.ones(small.shape, dtype=bool)
    variances = np.full(small.size, 1e-8)
    equal = fit(small, theta, np.diag(variances), every)
    variances[12] = 1e-2
    doubted = fit(small, theta, np.diag(variances), every)
    error = [np.abs(on_nodes(small, found.coefficients) - on_nodes(small, EQ_40)).max() for found in (equal, doubted)]
    assert error[1] < 0.01 * error[0]


def outer_held(grid, theta, noise, visited):
    return outer_coverage(lambda used: fit(grid, theta, noise, used), grid, theta, noise, visited)


def test_outer_nodes_tell_whether_the_surface_goes_on_like_a_quadratic():
    grid = Grid(np.arange(0.0, 57.0, 4.0), np.arange(0.0, 4001.0, 250.0))
    n, u = np.meshgrid(grid.speed, grid.fuel, indexing="ij")
    visited = (n >= 750) & (n <= 3000) & (u <= 40)
    noise = (5e-5) ** 2 * np.eye(grid.size)
    rng = np.random.default_rng(7)
    flat = evaluate(np.array(PUBLISHED.surfaces["FTP75 cold transient, Eq. (40)"]), u, n)
    smooth = [outer_held(grid, flat + 5e-5 * rng.standard_normal(grid.shape), noise, visited) for _ in range(20)]
    # Some 90 nodes are predicted in each of twenty draws.
    assert 0.85 < np.mean(smooth) < 0.95
    bent = flat + 8e-3 * np.clip((u - 28.0) / 12.0, 0.0, 1.0) ** 2 + 5e-5 * rng.standard_normal(grid.shape)
    assert outer_held(grid, bent, noise, visited) < 0.8


def test_too_few_nodes_to_take_any_away_tell_nothing():
    grid = Grid(np.arange(0.0, 57.0, 4.0), np.arange(0.0, 4001.0, 250.0))
    n, u = np.meshgrid(grid.speed, grid.fuel, indexing="ij")
    few = np.zeros(grid.shape, dtype=bool)
    few[3:6, 2:5] = True
    found = outer_held(grid, evaluate(np.array(EQ_40), u, n), 1e-8 * np.eye(grid.size), few)
    assert np.isnan(found)
