"""The rules that bring a channel to the raster."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lpvobs.ingest.resample import bridged, hold, linear, mean, median_step, raster

T = np.array([0.0, 1.0, 2.0, 10.0, 11.0])
V = np.array([1.0, 3.0, 2.0, 8.0, 9.0])


def test_hold_by_hand():
    at = np.array([-0.1, 0.0, 0.9, 1.0, 2.5, 3.6, 10.2, 11.5])
    np.testing.assert_array_equal(hold(T, V, at, 1.5), [np.nan, 1.0, 1.0, 3.0, 2.0, np.nan, 8.0, 9.0])


def test_linear_by_hand():
    at = np.array([-0.1, 0.0, 0.25, 1.5, 5.0, 10.0, 10.5, 11.0, 11.1])
    np.testing.assert_allclose(
        linear(T, V, at, 1.5), [np.nan, 1.0, 1.5, 2.5, np.nan, 8.0, 8.5, 9.0, np.nan], rtol=1e-15
    )


def test_mean_by_hand():
    # The box from 0.5 to 1.5 holds 0.5 s from 2 to 3 and 0.5 s from 3 to 2.5: (1.25 + 1.375) / 1. Of the one around 10.25 only the
    # later three quarters are there, from 8 to 8.75; of the one around 10 only half; of the one around 5 nothing.
    at = np.array([1.0, 10.25, 10.0, 5.0])
    np.testing.assert_allclose(mean(T, V, at, 1.5, 1.0), [2.625, 8.375, np.nan, np.nan], rtol=1e-14)


def slow_mean(t, v, at, limit, width):
    """Return the mean from many points of the line between neighbours."""
    points = at + width * ((np.arange(20_000) + 0.5) / 20_000 - 0.5)
    found = linear(t, v, points, limit)
    known = np.isfinite(found)
    return found[known].mean() if known.mean() > 0.75 else np.nan


@given(st.integers(0, 10_000))
def test_mean_is_the_mean_of_the_line(seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.01, 0.5, 30))
    v, at = rng.standard_normal(30), rng.uniform(t[3], t[-4])
    width = rng.uniform(0.05, 1.0)
    wanted = slow_mean(t, v, at, 0.4, width)
    found = mean(t, v, np.array([at]), 0.4, width)[0]
    if np.isfinite(wanted) and np.isfinite(found):
        # 20000 points: each end of a hole is placed to 1/20000 of the box, with jumps of at most 6 standard deviations
        assert found == pytest.approx(wanted, abs=5e-3)


@pytest.mark.parametrize("rule", [hold, linear])
def test_a_raster_at_the_stamps_changes_nothing(rule):
    np.testing.assert_array_equal(rule(T, V, T, 0.5), V)


def test_mean_removes_what_the_raster_cannot_show():
    """A sine at 10 Hz, sampled at 1 kHz, on a raster of 10 Hz: linear folds it to a constant, the mean to nothing."""
    t = np.arange(0, 4, 1e-3)
    v = np.cos(2 * np.pi * 10 * t)
    at = np.arange(1.0, 3.0, 0.1)
    assert np.abs(linear(t, v, at, 1.0)).max() > 0.99
    assert (
        np.abs(mean(t, v, at, 1.0, 0.1)).max() < 1e-3
    )  # the line between samples misses the sine by (pi f dt)^2 = 1e-3


def test_the_raster_leaves_gaps_open():
    at = raster([T, np.array([0.5, 2.5])], 4.0, 2.0)
    np.testing.assert_allclose(at, [*np.arange(0, 2.51, 0.25), *np.arange(10, 11.01, 0.25)], rtol=1e-15)


def test_bridged_counts_what_stands_between_distant_samples():
    assert bridged(T, np.array([0.0, 0.5, 2.0, 5.0, 10.0])).tolist() == [False, False, False, True, False]
    assert median_step(T) == 1.0
    assert np.isnan(median_step(T[:1]))
