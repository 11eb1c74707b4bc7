"""Two views of the same signals."""

from dataclasses import replace

import numpy as np
from reference.drives import log_of

from lpvobs.discovery.places import at, filled, instants


def test_a_parabola_is_seen_exactly_by_both_views():
    time = np.arange(0.0, 20.0, 0.01)
    log = log_of(time, {})
    where = instants(log, 0.1, 0.1)
    value, rate = at(log, (3.0 - 2.0 * time + 0.5 * time**2)[None], where, 0.1)
    for half in (0, 1):  # local quadratics reproduce quadratics: rounding only, amplified by 1/window for the rate
        np.testing.assert_allclose(value[half, 0], 3.0 - 2.0 * where + 0.5 * where**2, rtol=0, atol=1e-9)
        np.testing.assert_allclose(rate[half, 0], -2.0 + where, rtol=0, atol=1e-8)


def test_white_noise_is_independent_between_views_and_correlated_within():
    rng = np.random.default_rng(4)
    time = np.arange(0.0, 600.0, 0.01)
    log = log_of(time, {})
    where = instants(log, 0.3, 0.1)
    value, rate = at(log, rng.standard_normal((1, time.size)), where, 0.1)
    limit = 4.0 / np.sqrt(where.size)  # four standard deviations of a correlation of independent numbers
    assert abs(np.corrcoef(value[0, 0], value[1, 0])[0, 1]) < limit
    assert abs(np.corrcoef(rate[0, 0], rate[1, 0])[0, 1]) < limit
    assert np.corrcoef(value[0, 0], value.mean(0)[0])[0, 1] > 0.6  # a view and the mean of both share half: 0.71


def test_no_window_reaches_across_a_gap():
    time = np.concatenate([np.arange(0.0, 5.0, 0.01), np.arange(60.0, 65.0, 0.01)])
    signal = np.where(time < 30.0, 1.0, 100.0)
    log = log_of(time, {}, ((0, 500), (500, 1000)))
    where = instants(log, 0.1, 0.1)
    assert not np.any((where > 4.9) & (where < 60.1))
    value, rate = at(log, signal[None], where, 0.1)
    np.testing.assert_allclose(value[0, 0], np.where(where < 30.0, 1.0, 100.0), rtol=1e-9)
    np.testing.assert_allclose(rate[1, 0], 0.0, atol=1e-6)


def test_no_instant_stands_where_readings_are_missing_that_are_no_gap_yet():
    """A parabola through three readings on one side gave a speed a rate of -130 000 rpm/s, and `estimate` a ValueError."""
    time = np.delete(np.arange(0.0, 20.0, 0.05), [*range(200, 203), *range(204, 215)])
    log = log_of(time, {})
    where = np.arange(1.0, 19.0, 0.1)
    kept = where[filled(log, where, 0.35)]
    lost = np.setdiff1d(where, kept)
    np.testing.assert_allclose([lost.min(), lost.max()], [9.9, 10.8])  # less than four readings, of seven, on one side
    _, rate = at(log, np.sin(time)[None], kept, 0.35)
    np.testing.assert_allclose(rate[:, 0], np.broadcast_to(np.cos(kept), (2, kept.size)), atol=0.01)


def test_what_follows_a_channel_is_read_but_is_no_channel_of_the_search(laid_out, clean):
    """The ports' temperature is computed: nothing that is found may be said to follow it."""
    problem = laid_out(clean)
    assert "T_ports" in problem.signals.value
    assert "T_ports" not in problem.measured
    hot = replace(clean, channels={**clean.channels, "T_em": clean["T_em"] + 50.0})
    moved = laid_out(hot).signals["T_ports"] - problem.signals["T_ports"]
    np.testing.assert_allclose(moved, 50.0, atol=1e-6)
