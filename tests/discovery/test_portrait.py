"""What is drawn and said of a residual: bounded, faithful at the extremes, and right about what it follows."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from lpvobs.discovery.map_prior import free_map
from lpvobs.discovery.portrait import MOST_COLUMNS, MOST_POINTS, _spectrum, cross_correlations, portrait
from lpvobs.discovery.refine import refine
from lpvobs.discovery.thresholds import LAGS
from lpvobs.discovery.whiteness import leftover, structure


@pytest.fixture(scope="module")
def stepped(clean, misread, plant, config):
    """Return a step of the gain found, and its log, which starts at 1000 s."""
    prior = free_map(config.grid(), len(config.estimate.tolerance), 0.1)
    log = misread(clean, clean["W_maf"] * np.where(clean.time < 141.7, 1.0, 1.06))
    log = replace(log, time=log.time + 1000.0)
    return refine(plant, config.grid(), prior, [log]), log


@pytest.mark.slow
def test_a_portrait_is_bounded_and_keeps_the_extremes(stepped):
    found, log = stepped
    seen = portrait(found, [log])
    (track,) = seen.tracks
    assert track.time.size <= MOST_COLUMNS
    assert 0.0 <= track.time[0] < track.time[-1] <= 300.0  # since the start of the log
    for linear, extremes in ((found.before, track.before), (found.after, track.after)):
        assert extremes[:, 0].min(1) == pytest.approx(linear.raw[0].min(1))
        assert extremes[:, 1].max(1) == pytest.approx(linear.raw[0].max(1))
    assert seen.cumulated[:, :, -1] == pytest.approx(1.0)
    assert np.all(seen.effective >= 1.0)
    assert np.all(seen.effective <= seen.blocks)
    (partial,) = seen.partials
    assert partial.regressor.size <= MOST_POINTS


def test_a_partial_residual_has_slope_one_at_the_estimate(stepped):
    found, log = stepped
    (partial,) = portrait(found, [log]).partials
    mean, residual, _ = partial.binned
    far = np.abs(mean) > 1.0
    # Views with independent noise make the estimate; here both axes carry the noise of one, which flattens by its share.
    assert np.polyfit(mean[far], residual[far], 1)[0] == pytest.approx(1.0, abs=0.05)
    assert partial.id == "maf.gain"


def test_the_sign_of_a_lag_says_what_comes_first():
    rng = np.random.default_rng(4)
    signal = rng.standard_normal(400)
    residual = 0.1 * rng.standard_normal((2, 400))
    residual[1, 3:] += signal[:-3]  # three blocks later
    values, limit = cross_correlations(residual, np.arange(400), {"cause": signal, "none": rng.standard_normal(400)})
    assert int(np.argmax(np.abs(values[0]))) == LAGS + 3
    assert values[0, LAGS + 3] > 0.9
    assert np.all(np.abs(values[1]) < limit[1])


@pytest.mark.proof
def test_what_is_unexplained_is_placed_in_time(plant, config, clean, misread):
    prior = free_map(config.grid(), len(config.estimate.tolerance), 0.1)
    t = clean.time
    on = ((t > 40) & (t < 80)) | ((t > 120) & (t < 150)) | ((t > 210) & (t < 260))
    log = misread(clean, clean["W_maf"] * np.where(on, 1.1, 1.0))
    found = refine(plant, config.grid(), prior, [log])
    assert found.trace.verdict == "unexplained"
    left = found.trace.left
    assert left == leftover(found.after, [log], structure(found.after).correlated_with)
    assert left.balance in ("compressor", "filling")
    assert 0.0 < left.half_power < 0.02  # Hz; a cycle of about 80 s
    shown = found.trace.as_json(refined=False)["residual"]
    assert {"white", "correlated_with", "when", "where", "frequency"} <= shown.keys()
    said = found.trace.as_json(refined=False)
    assert said["p_value"] < 1e-6
    assert "maf.gain" in [item["id"] for item in said["candidates"]]
    assert not any(item["proven"] for item in said["candidates"])
    assert all(0.0 <= item["explained"] <= 1.0 for item in said["candidates"])


def test_a_stretch_with_much_power_is_named(stepped):
    found, log = stepped
    noise = np.random.default_rng(0).standard_normal(found.after.residual.shape)
    time = found.after.problem.time
    noise[:, :, (time > 100.0) & (time < 140.0)] *= 4.0
    (part,) = leftover(replace(found.after, residual=noise), [log], {}).stretches
    assert part.begin == pytest.approx(100.0, abs=12.0)  # a stretch is about 10 s
    assert part.end == pytest.approx(140.0, abs=12.0)
    assert part.share > 0.9


def test_places_without_a_balance_are_not_what_is_usual(stepped):
    """More than half of a drive where the map was not estimated made the usual power zero, and all else infinitely large."""
    found, log = stepped
    problem = found.after.problem
    driven = problem.time > 180.0
    noise = np.random.default_rng(0).standard_normal(found.after.residual.shape) * driven
    noise[:, :, (problem.time > 220.0) & (problem.time < 240.0)] *= 4.0
    after = replace(found.after, residual=noise, problem=replace(problem, shown=problem.shown & driven))
    left = leftover(after, [log], {})
    (part,) = left.stretches
    assert part.begin == pytest.approx(220.0, abs=12.0)
    assert part.end == pytest.approx(240.0, abs=12.0)
    assert 1.0 < left.times_noise < 100.0


@pytest.mark.parametrize("K", [1000, 255])
def test_a_spectrum_is_that_of_scipy(K):
    residual = np.random.default_rng(4).standard_normal((2, K)).cumsum(1)
    frequency, power = scipy.signal.welch(residual, fs=20.0, nperseg=min(256, K), detrend="constant")
    found = _spectrum(residual, 0.05)
    np.testing.assert_allclose(found[0], frequency[1:], rtol=1e-12)
    np.testing.assert_allclose(found[1], power[:, 1:], rtol=1e-9)  # the largest is 1e5 times the smallest
