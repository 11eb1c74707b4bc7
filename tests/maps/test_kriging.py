"""Universal kriging: the textbook's values and intervals, special cases, coverage on surfaces that are drawn."""

import numpy as np
import pytest
from reference.universal_kriging import conditioned

from lpvobs.errors import DataError
from lpvobs.maps import kriging
from lpvobs.maps.grid import Grid
from lpvobs.maps.kriging import krige
from lpvobs.maps.quadratic import ESTIMATED, EXTRAPOLATED, SMOOTHED, evaluate, fit, interval_factor, scaled_terms

GRID = Grid(np.linspace(0.0, 56.0, 8), np.linspace(500.0, 4000.0, 8))
N, U = np.meshgrid(GRID.speed, GRID.fuel, indexing="ij")
PLACE = scaled_terms(GRID, U, N).reshape(-1, 6)[:, (1, 3)]
TREND = scaled_terms(GRID, U, N).reshape(-1, 6)
VISITED = (N > 800) & (N < 3200) & ~((U > 40) & (N < 2000))
QUADRATIC = evaluate(np.array([2.1e-5, -8.62e-4, 1.46e-9, -6.4e-6, -1.84e-8, 0.0032316]), U, N)
BUMP = 3e-3 * np.exp(-(((U - 25.0) / 10.0) ** 2) - ((N - 2000.0) / 500.0) ** 2)


def shared_noise(seed=1, size=1e-4):
    """Return a covariance in which one constant of an engine moves all nodes together."""
    rng = np.random.default_rng(seed)
    common = 1.0 + 0.5 * rng.standard_normal((GRID.size, 2))
    return size**2 * (0.2 * np.eye(GRID.size) + common @ common.T)


@pytest.mark.parametrize(("order", "cubic"), [(2.5, 0.0), (np.inf, 0.0), (np.inf, 0.3), (2.5, 1.0)])
def test_with_one_choice_it_is_the_textbook(monkeypatch, order, cubic):
    monkeypatch.setattr(kriging, "PROCESSES", ((order == np.inf, cubic),))
    monkeypatch.setattr(kriging, "LENGTHS", (0.4,))
    monkeypatch.setattr(kriging, "AMPLITUDES", (0.5,))
    noise, chosen = shared_noise(), np.flatnonzero(VISITED)
    found = krige(GRID, QUADRATIC + BUMP, noise, VISITED, TREND, smooth=True)
    z, own = (QUADRATIC + BUMP).ravel()[chosen], noise[np.ix_(chosen, chosen)]
    amplitude = 0.5 * np.sqrt(np.mean(z**2) + np.mean(np.diag(own)))
    mean, covariance, _ = conditioned(PLACE, TREND, chosen, TREND[chosen], z, own, (0.4, 0.4), amplitude, order, cubic)
    # The textbook's wide prior costs it six digits.
    np.testing.assert_allclose(found.delta_W_c.ravel(), mean, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.covariance, covariance, rtol=0, atol=1e-3 * covariance.max())
    assert found.lack_of_fit == pytest.approx(amplitude)
    np.testing.assert_allclose(found.lengths, [0.4 * 28.0, 0.4 * 1750.0])


def test_lengths_and_amplitude_count_by_their_restricted_likelihood(monkeypatch):
    lengths, amplitudes = (0.4, 0.5), (0.06, 0.1)
    monkeypatch.setattr(kriging, "LENGTHS", lengths)
    monkeypatch.setattr(kriging, "AMPLITUDES", amplitudes)
    noise, chosen = shared_noise(size=3e-4), np.flatnonzero(VISITED)
    surface = QUADRATIC + BUMP
    found = krige(GRID, surface, noise, VISITED, TREND, smooth=True)
    z, own = surface.ravel()[chosen], noise[np.ix_(chosen, chosen)]
    size = np.sqrt(np.mean(z**2) + np.mean(np.diag(own)))
    processes = [(2.5, 0.0), (np.inf, 0.0), (np.inf, 0.3)]
    choices = [(a, b, share * size, p) for a in lengths for b in lengths for share in amplitudes for p in processes]
    each = [conditioned(PLACE, TREND, chosen, TREND[chosen], z, own, (a, b), s, *p) for a, b, s, p in choices]
    before = [-0.5 * (np.log(s / size / 0.3) / 2.0) ** 2 for _, _, s, _ in choices]
    weights = np.exp(np.array([item[2] for item in each]) + before - max(item[2] for item in each))
    weights /= weights.sum()
    assert 0.05 < weights.max() < 0.99  # otherwise nothing is averaged
    means, spreads = np.array([item[0] for item in each]), np.array([np.diag(item[1]) for item in each])
    mean = weights @ means
    np.testing.assert_allclose(
        found.delta_W_c.ravel(), mean, rtol=0, atol=2e-5
    )  # what weighs under a thousandth is left out
    spread = np.sqrt(weights @ (spreads + means**2) - mean**2)
    np.testing.assert_allclose(found.map_standard_error.ravel(), spread, rtol=0.02)


def test_estimated_nodes_stay_unless_smoothing_is_asked_for():
    noise = shared_noise()
    theta = np.where(VISITED, QUADRATIC + BUMP, np.nan)
    plain, smooth = (krige(GRID, theta, noise, VISITED, TREND, smooth=wish) for wish in (False, True))
    np.testing.assert_array_equal(plain.delta_W_c[VISITED], theta[VISITED])
    np.testing.assert_array_equal(plain.support, np.where(VISITED, ESTIMATED, EXTRAPOLATED))
    on = np.flatnonzero(VISITED)
    np.testing.assert_array_equal(plain.covariance[np.ix_(on, on)], noise[np.ix_(on, on)])
    np.testing.assert_array_equal(smooth.support, np.where(VISITED, SMOOTHED, EXTRAPOLATED))
    np.testing.assert_allclose(smooth.delta_W_c[~VISITED], plain.delta_W_c[~VISITED], rtol=1e-9)
    assert np.all(smooth.map_standard_error[VISITED] < plain.map_standard_error[VISITED])


def test_the_joint_covariance_is_that_of_the_errors(monkeypatch):
    monkeypatch.setattr(kriging, "AMPLITUDES", (1e-4,))  # the surface is a quadratic: noise is all that there is
    monkeypatch.setattr(kriging, "LENGTHS", (1.0,))
    noise = shared_noise(2, 2e-4)
    root = np.linalg.cholesky(noise)
    rng = np.random.default_rng(3)
    predicted, errors = 0.0, []
    for _ in range(200):
        found = krige(
            GRID, QUADRATIC + (root @ rng.standard_normal(GRID.size)).reshape(GRID.shape), noise, VISITED, TREND
        )
        errors.append((found.delta_W_c - QUADRATIC).ravel())
        predicted = predicted + found.covariance / 200
    seen = np.cov(np.array(errors).T)
    region = VISITED | (N > 3200)
    mean = region.ravel() / region.sum()
    # Variances of 200 draws are known to a tenth; by node errors alone the mean would have a fifth of its own.
    assert mean @ predicted @ mean == pytest.approx(mean @ seen @ mean, rel=0.3)
    assert mean @ np.diag(np.diag(predicted)) @ mean < 0.2 * (mean @ seen @ mean)
    assert np.linalg.eigvalsh(predicted)[0] > -1e-3 * np.diag(predicted).max()


def test_a_bump_beside_the_data_is_carried_on_and_the_quadratic_is_not_believed():
    noise = shared_noise()
    surface = QUADRATIC + BUMP
    found, old = krige(GRID, surface, noise, VISITED, TREND), fit(GRID, surface, noise, VISITED)
    away = [np.sqrt(np.mean((each.delta_W_c - surface)[~VISITED] ** 2)) for each in (found, old)]
    assert away[0] < 0.7 * away[1]
    assert np.all(found.map_standard_error[~VISITED] > 1e-4)


def test_where_the_data_say_nothing_the_interval_says_so():
    near = (N < 2100) & (U < 30)
    found = krige(GRID, QUADRATIC + BUMP, shared_noise(), near, TREND)
    assert found.map_standard_error[-1, -1] > 3.0 * found.map_standard_error[4, 3] > 0.0
    assert found.map_standard_error[-1, -1] > 5e-3


def test_the_map_may_be_in_any_unit():
    noise, surface = shared_noise(), QUADRATIC + BUMP
    one, other = krige(GRID, surface, noise, VISITED, TREND), krige(GRID, 1e3 * surface, 1e6 * noise, VISITED, TREND)
    np.testing.assert_allclose(other.delta_W_c, 1e3 * one.delta_W_c, rtol=1e-6)
    np.testing.assert_allclose(other.map_standard_error, 1e3 * one.map_standard_error, rtol=1e-6)


@pytest.mark.slow
def test_coverage_over_surfaces_drawn_from_a_process_of_its_kind():
    rng = np.random.default_rng(5)
    away = [(PLACE[:, None, i] - PLACE[:, i]) / length for i, length in ((0, 0.5), (1, 0.9))]
    r = np.sqrt(5.0) * np.hypot(*away)
    process = np.linalg.cholesky((1 + r + r * r / 3) * np.exp(-r) + 1e-9 * np.eye(GRID.size))
    noise = shared_noise(6, 1e-4)
    root, held = np.linalg.cholesky(noise), []
    for _ in range(30):
        truth = TREND @ rng.uniform(-5e-3, 5e-3, 6) + 1e-3 * process @ rng.standard_normal(GRID.size)
        found = krige(GRID, (truth + root @ rng.standard_normal(GRID.size)).reshape(GRID.shape), noise, VISITED, TREND)
        error = np.abs(found.delta_W_c.ravel() - truth).reshape(GRID.shape)
        held.append(np.mean((error <= interval_factor(found.nodes, 0.9) * found.map_standard_error)[~VISITED]))
    # Nodes of one surface hang together: the mean of thirty surfaces is known to four per cent.
    assert 0.82 < np.mean(held) < 0.97


def test_of_very_many_nodes_some_tell_lengths_and_amplitude(monkeypatch):
    noise, surface = shared_noise(), QUADRATIC + BUMP
    whole = krige(GRID, surface, noise, VISITED, TREND)
    monkeypatch.setattr(kriging, "MOST_NODES", 20)
    few = krige(GRID, surface, noise, VISITED, TREND)
    assert few.nodes == whole.nodes
    np.testing.assert_allclose(few.delta_W_c, whole.delta_W_c, atol=1e-3)


def test_too_few_nodes_are_refused():
    with pytest.raises(DataError, match="6 estimated nodes do not determine"):
        krige(GRID, QUADRATIC, shared_noise(), (N < 1200) & (U < 20), TREND)
