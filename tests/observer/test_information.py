"""The information form against dense least squares, and what it says of nodes that nobody visited."""

import numpy as np
import pytest
from reference.membership import psi

from lpvobs.maps.grid import Grid
from lpvobs.observer.information import Information, solve

GRID = Grid(np.array([0.0, 4.0, 10.0, 20.0]), np.array([500.0, 1000.0, 2000.0]))
PRIOR = 0.1
VARIANCE = np.array([0.01**2 / 3, 0.02**2 / 3])


def problem(seed, N=300, u_max=20.0):
    """Return operating points, weights, data and slopes of one log."""
    rng = np.random.default_rng(seed)
    u, n = rng.uniform(0, u_max, N), rng.uniform(500, 2000, N)
    return u, n, rng.uniform(1e2, 1e5, N), 0.02 * rng.standard_normal(N), 0.05 * rng.standard_normal((2, N))


def informed(u, n, weight, z, g):
    weighted = rows(u, n).T * weight
    return Information(weighted @ rows(u, n), weighted @ z, weighted @ g.T)


def rows(u, n):
    return np.array([psi(GRID.fuel, GRID.speed, *v) for v in zip(u, n, strict=True)])


def test_map_and_covariance_are_those_of_dense_weighted_least_squares():
    u, n, weight, z, g = problem(1)
    found = solve(informed(u, n, weight, z, g), PRIOR)
    # The prior as p more measurements of zero.
    root = np.concatenate((np.sqrt(weight), np.full(GRID.size, 1 / PRIOR)))
    X = np.concatenate((rows(u, n), np.eye(GRID.size))) * root[:, None]
    padding = np.zeros(GRID.size)
    expected = np.linalg.lstsq(X, np.concatenate((z, padding)) * root, rcond=None)[0]
    np.testing.assert_allclose(found.theta, expected, rtol=1e-9)
    response = np.linalg.lstsq(X, np.concatenate((g.T, np.zeros((GRID.size, 2)))) * root[:, None], rcond=None)[0]
    np.testing.assert_allclose(found.response, response, rtol=0, atol=1e-9 * np.abs(response).max())
    dense = np.linalg.inv(X.T @ X) + response @ np.diag(VARIANCE) @ response.T
    # A normal matrix of condition 1e6.
    np.testing.assert_allclose(found.covariance(VARIANCE), dense, rtol=0, atol=1e-9 * dense.max())


def test_no_log_says_nothing():
    p = GRID.size
    found = solve(Information(np.zeros((p, p)), np.zeros(p), np.zeros((p, 2))), PRIOR)
    np.testing.assert_array_equal(found.theta, 0.0)
    np.testing.assert_allclose(found.covariance(VARIANCE), PRIOR**2 * np.eye(GRID.size), rtol=1e-15)


def test_a_node_without_data_keeps_its_prior():
    u, n, weight, z, g = problem(4, u_max=4.0)
    found = solve(informed(u, n, weight, z, g), PRIOR)
    away = np.flatnonzero(np.abs(rows(u, n)).max(axis=0) == 0)
    assert away.size == 6
    np.testing.assert_array_equal(found.theta[away], 0.0)
    np.testing.assert_array_equal(found.response[away], 0.0)
    np.testing.assert_allclose(np.diag(found.covariance(VARIANCE))[away], PRIOR**2, rtol=1e-12)


def test_it_is_the_map_equation_with_a_gain_that_falls():
    """Backward Euler of dtheta/dt = Gamma w Psi^T (z - Psi theta), Gamma^-1 = H, dH/dt = w Psi^T Psi."""
    u, n, weight, z, g = problem(6)
    theta, H = np.zeros(GRID.size), np.eye(GRID.size) / PRIOR**2
    for row, w, value in zip(rows(u, n), weight, z, strict=True):
        Gamma = np.linalg.inv(H)
        theta = np.linalg.solve(np.eye(GRID.size) + w * Gamma @ np.outer(row, row), theta + w * Gamma @ row * value)
        H = H + w * np.outer(row, row)
    np.testing.assert_allclose(solve(informed(u, n, weight, z, g), PRIOR).theta, theta, rtol=1e-8)


def test_constants_owe_the_map_what_the_covariance_says():
    """Monte Carlo: data moved by g beta with beta drawn uniformly within the tolerance move the map by J beta."""
    u, n, weight, z, g = problem(7)
    weight = weight * 1e6  # so that noise does not count
    half_width = np.sqrt(3 * VARIANCE)
    rng = np.random.default_rng(8)
    base = solve(informed(u, n, weight, z, g), PRIOR)
    draws = np.array(
        [
            solve(informed(u, n, weight, z + rng.uniform(-half_width, half_width) @ g, g), PRIOR).theta - base.theta
            for _ in range(800)
        ]
    )
    # 800 draws know a standard deviation to 2.5 %; of uniform numbers somewhat better. Four times that for twelve nodes.
    np.testing.assert_allclose(draws.std(axis=0), np.sqrt(np.diag(base.covariance(VARIANCE))), rtol=0.1)


def test_noise_has_the_covariance_that_is_stated():
    u, n, weight, _, g = problem(9)
    truth = 0.02 * np.sin(np.arange(GRID.size))
    rng = np.random.default_rng(10)
    clean = rows(u, n) @ truth
    draws, covariance = [], np.empty(0)
    for _ in range(800):
        z = clean + rng.standard_normal(u.size) / np.sqrt(weight)
        found = solve(informed(u, n, weight, z, g), 1e3)
        covariance = found.covariance(np.zeros(2))
        draws.append(found.theta - truth)
    np.testing.assert_allclose(np.std(draws, axis=0), np.sqrt(np.diag(covariance)), rtol=0.1)  # 2.5 %, four times
    assert np.abs(np.mean(draws, axis=0) / np.sqrt(np.diag(covariance) / 800)).max() < 4.0


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e8])
def test_covariance_is_symmetric_and_positive_at_any_size_of_information(scale):
    u, n, weight, z, g = problem(11, u_max=3.0)
    covariance = solve(informed(u, n, scale * weight, z, g), PRIOR).covariance(VARIANCE)
    np.testing.assert_allclose(covariance, covariance.T, rtol=0, atol=1e-15 * covariance.max())
    assert np.linalg.eigvalsh(covariance).min() > -1e-15 * covariance.max()
    assert np.diag(covariance).min() > 0.0
