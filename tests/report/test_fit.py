"""Fit and residual correlations: what is known of signals made for the purpose, and the same by NumPy's plain sums."""

import numpy as np
import pytest

from lpvobs.report.fit import LAGS, fit_along

N = 2000
TIME = 0.6 * np.arange(N)  # longer than a lag at least: no means
RNG = np.random.default_rng(5)
U, NOISE = RNG.normal(size=(2, N))
READING = 10.0 + np.sin(TIME / 30.0)


def found(residual, known=None, **inputs):
    predicted = READING - residual if known is None else np.where(known, READING - residual, np.nan)
    return fit_along(("map", "log", "filling"), TIME, READING, predicted, inputs or {"u": U})


def test_white_noise_stays_in_its_bands():
    seen = found(0.1 * NOISE)
    assert seen.lags_outside <= 0.04
    assert seen.outside["u"] <= 0.04
    assert seen.band == pytest.approx(2.576 / np.sqrt(N))
    assert seen.autocorrelation[0] == pytest.approx(1.0)


def test_fit_is_that_of_compare():
    seen = found(0.1 * NOISE)
    assert seen.fit == pytest.approx(1.0 - np.linalg.norm(0.1 * NOISE) / np.linalg.norm(READING - READING.mean()))
    assert found(READING - READING.mean()).fit == pytest.approx(0.0)
    assert seen.rms == pytest.approx(np.sqrt(np.mean((0.1 * NOISE) ** 2)))


def test_an_input_that_acts_three_lags_late_shows_at_lag_three():
    late = np.concatenate([np.zeros(3), U[:-3]])
    seen = found(0.1 * NOISE + 0.05 * late)
    assert int(np.argmax(np.abs(seen.cross["u"]))) - LAGS == 3
    assert seen.cross["u"][LAGS + 3] > 4.0 * seen.cross_band["u"]


def test_correlations_are_plain_sums():
    e = np.convolve(NOISE, np.ones(4), "same")
    seen = found(0.1 * e)
    e, u = e - e.mean(), U - U.mean()
    own = np.correlate(e, e, "full")[N - 1 :] / (e @ e)
    np.testing.assert_allclose(seen.autocorrelation, own[: LAGS + 1], atol=1e-9)
    cross = np.correlate(e, u, "full")[N - 1 - LAGS : N + LAGS] / np.sqrt((e @ e) * (u @ u))
    np.testing.assert_allclose(seen.cross["u"], cross, atol=1e-9)
    assert seen.lags_outside >= 3 / 25


def test_slow_signals_have_a_wider_band():
    """Two random walks go together by chance; the band says so."""
    slow = np.cumsum(NOISE), np.cumsum(U)
    seen = found(1e-3 * slow[0], u=slow[1])
    assert seen.cross_band["u"] > 5.0 * seen.band
    assert seen.outside["u"] < 0.5


def test_gaps_and_too_few():
    known = np.arange(N) % 100 < 60
    seen = found(0.1 * NOISE, known)
    assert seen.samples == known.sum()
    assert seen.lags_outside <= 0.08
    assert found(0.1 * NOISE, np.arange(N) < 90) is None
