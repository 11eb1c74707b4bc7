"""The sums behind the search over onsets against the same by the definition."""

import numpy as np
import pytest

from lpvobs.discovery.throttled_evidence import (
    best_interval,
    best_size,
    gains_by_end,
    gains_by_onset,
    parabola,
    refined_size,
    weighing,
)

ROUNDING = 1e-9


@pytest.fixture(scope="module")
def problem():
    rng = np.random.default_rng(5)
    n, length = 60, 2.0
    time = np.repeat(np.arange(30) * length + 1.0, 2)
    root = rng.standard_normal((n, n))
    return (
        weighing(root @ root.T / n + np.eye(n), time, length),
        rng.standard_normal(n),
        rng.standard_normal((n, 3)),
        time,
    )


def loss(weights, v):
    return 0.5 * float(v @ weights.P @ v)


def test_every_onset_gains_what_undoing_from_there_gains(problem):
    weights, r, z, time = problem
    gains = gains_by_onset(weights, weights.P @ r, z)
    for k, onset in enumerate(weights.onsets):
        for column in range(z.shape[1]):
            direct = loss(weights, r) - loss(weights, r + np.where(time > onset, z[:, column], 0.0))
            assert gains[k, column] == pytest.approx(direct, rel=ROUNDING, abs=ROUNDING)


def test_every_end_gains_what_undoing_until_there_gains(problem):
    weights, r, z, time = problem
    gains = gains_by_end(weights, weights.P @ r, z[:, 0])
    for k, end in enumerate(weights.onsets):
        direct = loss(weights, r) - loss(weights, r + np.where(time < end, z[:, 0], 0.0))
        assert gains[k] == pytest.approx(direct, rel=ROUNDING, abs=ROUNDING)


def test_the_inverse_is_the_inverse(problem):
    weights = problem[0]
    root = np.random.default_rng(5).standard_normal((60, 60))
    np.testing.assert_allclose(weights.P @ (root @ root.T / 60 + np.eye(60)), np.eye(60), atol=1e-9)


def test_a_parabola_is_met_exactly():
    x = np.array([1e-6, 3e-6, 4e-6])  # sizes of leaks: nothing may be lost to their smallness
    at, height, bend = parabola(x, 5.0 - 2e12 * (x - 2.7e-6) ** 2)
    assert at == pytest.approx(2.7e-6, rel=1e-9)
    assert height == pytest.approx(5.0, rel=1e-9)
    assert bend == pytest.approx(4e12, rel=1e-9)


def test_without_a_maximum_inside_the_best_end_is_taken():
    x = np.array([0.0, 1.0, 2.0])
    assert parabola(x, x**2) == (2.0, 4.0, 0.0)
    assert best_size((0.0, 1.0, 2.0), x) == (2.0, 2.0)


def test_a_size_and_its_deviation_are_those_of_a_quadratic_loss():
    sizes = tuple(np.linspace(0.5, 1.5, 11))
    size, gain, spread = refined_size(lambda s: 7.0 - 0.5 * ((s - 1.0337) / 0.01) ** 2, sizes, 1.1)
    # Parabolas are exact for a parabola; rounding only.
    assert size == pytest.approx(1.0337, abs=1e-6)
    assert gain == pytest.approx(7.0, abs=1e-6)
    assert spread == pytest.approx(0.01, rel=1e-3)


def test_the_best_interval_is_the_best_of_all(problem):
    weights, r, z, time = problem
    every, least = 2, 3
    gain, begin, end, size = best_interval(weights, weights.P @ r, z[:, 0], every, least)
    found = []
    edges = range(0, weights.onsets.size + 1, every)
    for i in edges:
        for j in edges:
            if i >= least * every and j - i >= least * every and j <= weights.onsets.size - least * every:
                on = (time > weights.onsets[i]) & (time < weights.onsets[j])
                d = np.where(on, z[:, 0], 0.0)
                best = -(d @ weights.P @ r) / (d @ weights.P @ d)
                found.append((loss(weights, r) - loss(weights, r + best * d), i, j, best))
    assert (gain, begin, end, size) == pytest.approx(max(found), rel=ROUNDING)
