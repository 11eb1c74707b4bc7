"""Noise that is remembered: innovations, parts that count, and the power of a direction on every range, by the definition."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.discovery.imbalances import operating_nodes, scenes_with
from lpvobs.discovery.noise import Remembered, noise_of
from lpvobs.discovery.thresholds import AT_ONCE, OUTLIER, SHORT, SLOW

ROUNDING = 1e-9
B, K = 2, 30


@pytest.fixture(scope="module")
def noise():
    """Return noise of two logs, of which some entries are missing."""
    rng = np.random.default_rng(5)
    root = rng.standard_normal((B, B))
    return Remembered(
        clock=np.cumsum(rng.uniform(0.5, 6.0, K)),
        of_log=(np.arange(K) > 17).astype(int),
        shown=rng.random((B, K)) < 0.9,
        scale=rng.uniform(0.5, 2.0, (B, K)),
        own=rng.uniform(0.0, 0.3, (B, K)),
        together=root @ root.T + np.eye(B),
        slow=np.array([0.7, 0.2]),
        used=np.ones(K, dtype=bool),
    )


def covariance(noise):
    """Return the covariance of all pairs of entries, balance by balance, shape (B K, B K), as the class says it."""
    distance = np.abs(noise.clock[:, None] - noise.clock)
    at_once = np.eye(K)
    fast = (1.0 - AT_ONCE) * np.exp(-distance / SHORT) + AT_ONCE * at_once
    slow = np.exp(-distance / SLOW) * (noise.of_log[:, None] == noise.of_log)
    whole = np.zeros((B, K, B, K))
    for a in range(B):
        for b in range(B):
            whole[a, :, b] = noise.together[a, b] * np.outer(noise.scale[a], noise.scale[b]) * fast
        whole[a, :, a] += noise.slow[a] ** 2 * slow + np.diag(noise.own[a])
    return whole.reshape(B * K, B * K)


def squared(values, noise, on):
    """Return the quadratic form of the entries that count with the inverse of their covariance."""
    at = np.flatnonzero(on)
    return values[0].ravel()[at] @ np.linalg.solve(covariance(noise)[np.ix_(at, at)], values[0].ravel()[at])


def drawn(seed):
    values = np.zeros((2, B, K))
    values[0] = np.random.default_rng(seed).standard_normal((B, K))
    return values


def test_innovations_have_the_square_of_the_whole(noise):
    r = drawn(1)
    assert np.sum(noise.whiten(r) ** 2) == pytest.approx(squared(r, noise, noise.shown), rel=ROUNDING)


def test_an_innovation_knows_what_came_before_and_nothing_else(noise):
    r = drawn(7)
    late = r * (np.arange(K) < 20)
    np.testing.assert_array_equal(noise.whiten(r)[..., :20], noise.whiten(late)[..., :20])


def test_many_at_once_are_each_alone(noise):
    both = np.stack([drawn(1), drawn(2)])
    np.testing.assert_allclose(noise.whiten(both)[1], noise.whiten(drawn(2)), rtol=ROUNDING, atol=ROUNDING)


def test_places_that_do_not_count_are_as_if_never_seen(noise):
    used, r = np.arange(K) % 5 != 2, drawn(3)
    white = noise.only(used).whiten(r)
    assert np.sum(white**2) == pytest.approx(squared(r, noise, noise.shown & used), rel=ROUNDING)
    assert not white[..., ~used].any()


def test_every_entry_alone_has_the_variance_of_the_whole(noise):
    root = noise.pointwise().root
    variance = np.diag(covariance(noise)).reshape(B, K)
    expected = np.where(noise.shown, variance**-0.5, 0.0)
    np.testing.assert_allclose(np.einsum("kbb->bk", root), expected, rtol=ROUNDING)


def test_the_power_of_every_range_is_that_of_the_part(noise):
    direction, first = drawn(4), np.array([0, 4, 9, 17, 25])
    powers = noise.ranges(direction, noise.whiten(direction), first)
    edges = np.append(first, K)
    for i in range(edges.size - 1):
        for j in range(i + 1, edges.size):
            part = direction * ((np.arange(K) >= edges[i]) & (np.arange(K) < edges[j]))
            assert powers[i, j] == pytest.approx(np.sum(noise.whiten(part) ** 2), rel=ROUNDING)


def test_a_part_times_the_dual_is_the_product_of_the_whitened(noise):
    direction, other = drawn(5), noise.whiten(drawn(6))
    part = direction * (np.arange(K) > 11)
    back = noise.dual(other[None])[0]
    assert np.sum(part[0] * back[0]) == pytest.approx(np.sum(noise.whiten(part) * other), rel=ROUNDING)


def test_a_balance_that_counts_at_a_third_of_the_places_has_the_noise_of_these(laid_out, clean):
    """Its zeros elsewhere once made its noise too small."""
    problem = laid_out(clean)
    shown = problem.shown.copy()
    shown[1] = np.sin(problem.clock / 3.0) > 0.5
    part = replace(problem, shown=shown)
    nodes = operating_nodes(part, scenes_with(part, (), np.zeros(part.spread.size)))
    rng = np.random.default_rng(8)
    raw = 1e-3 * rng.standard_normal(shown.shape)
    heard = np.where(shown, raw, 0.0)
    always, some = (
        white[on & part.used]
        for white, on in zip(noise_of(part, nodes, heard).whiten(heard)[:2], shown[:2], strict=True)
    )
    assert np.mean(some**2) == pytest.approx(np.mean(always**2), rel=0.15)  # three standard errors


def test_a_moment_that_no_healthy_drive_showed_weighs_as_if_it_were_four_deviations_off(laid_out, clean):
    """One instant of exhaust that ran backwards named a curve of the EGR valve, with p = 1e-137."""
    problem = laid_out(clean)
    beside = replace(problem, bounded=True)
    nodes = operating_nodes(problem, scenes_with(problem, (), np.zeros(problem.spread.size)))
    raw = 1e-3 * np.random.default_rng(9).standard_normal(problem.shown.shape)
    k = int(np.flatnonzero(problem.used)[100])
    raw[0, k] = 0.1
    far, near = (np.abs(noise_of(each, nodes, raw).whiten(raw)) for each in (problem, beside))
    assert far[0, k] > 2.0 * OUTLIER
    assert near[0, k] == pytest.approx(OUTLIER)
    usual = far.max(0) <= OUTLIER
    np.testing.assert_array_equal(near[:, usual], far[:, usual])  # weights that follow the noise would bias it
