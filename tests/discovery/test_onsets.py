"""What the search for the ends of an effect finds on healthy drives."""

import numpy as np
import pytest

from lpvobs.discovery.onsets import over_noise
from lpvobs.discovery.thresholds import LEAST_LENGTH

BLOCKS = 300.0


def drives(gains, information=1.0, share=0.5):
    """Return what drives show of two effects, each with one end and with two, from their gains, shape (drives, 2, 2)."""
    gains = np.asarray(gains, dtype=float)
    return [np.stack([each, np.full((2, 2), information), np.full((2, 2), share)], axis=-1) for each in gains]


def found(gains, late=0.0, beyond=0.0, **what):
    """Return by how much onsets on healthy drives gain more than in noise."""
    each = drives(gains, **what)
    n = len(each)
    return over_noise(each, np.full(2, late), np.full(2, beyond), np.full(n, 1000.0), np.full(n, BLOCKS))


def test_the_best_onset_by_noise_is_none():
    """Half of chi-square at every place that has data of its own, on 200 sets of six drives."""
    rng, ends = np.random.default_rng(5), int(BLOCKS / LEAST_LENGTH)
    gains = 0.5 * rng.standard_normal((200, 6, 2, ends**2)) ** 2
    best = np.stack([gains[..., :ends].max(-1), gains.max(-1)], axis=-1)
    each = np.array([found(one) for one in best])
    assert np.quantile(each, 0.9) < 1.3
    assert each.min() == 1.0


def test_one_event_on_one_drive_tells_of_its_effect_and_somewhat_of_the_others():
    quiet = np.ones((6, 2, 2))
    event = quiet.copy()
    event[2, 1, 1] = 50.0
    assert found(quiet) == pytest.approx(1.0)
    by_event = 50.0 / np.log(6 * (BLOCKS / LEAST_LENGTH) ** 2)
    np.testing.assert_allclose(found(event), [[1.0, 0.5 * (1.0 + by_event)], [1.0, by_event]])


def test_what_sizes_vary_by_anyway_is_not_counted_twice():
    gains = np.full((6, 2, 2), 500.0)
    np.testing.assert_allclose(found(gains, late=0.1, beyond=1.0, information=300.0) * 4.0, found(gains))
    # at most as much as the drives show, and more within a shorter time
    np.testing.assert_allclose(found(gains, late=0.1, beyond=0.001, information=300.0) * 2.0, found(gains))
    np.testing.assert_allclose(found(gains, late=0.1, beyond=1.0, information=300.0, share=0.25) * 7.0, found(gains))
