"""Signals that follow a channel slowly."""

from itertools import pairwise

import numpy as np
import pytest

from lpvobs.engines.followers import Follower, followed, with_followers
from lpvobs.records import Defects, Log, Piece

WALL = {"wall": Follower("gas", 2.0)}


def log_of(time, gas, segments=None):
    """Return a log of one channel."""
    n = time.size
    return Log("", "", time, {"gas": gas}, {}, segments or ((0, n),), np.arange(n), Defects(n))


def test_a_step_is_followed_exactly_at_any_spacing():
    time = np.cumsum(np.random.default_rng(1).uniform(0.05, 0.4, 60))
    gas = np.where(time < time[20], 300.0, 400.0)
    found = with_followers(WALL, log_of(time, gas))["wall"]
    after = np.exp(-(time[20:] - time[19]) / 2.0)
    np.testing.assert_allclose(found[:20], 300.0)
    np.testing.assert_allclose(found[20:], 400.0 - 100.0 * after, rtol=1e-12)


def test_every_segment_begins_with_the_channel_itself():
    time, gas = np.arange(40.0), np.where(np.arange(40) % 20 < 10, 300.0, 400.0)
    found = with_followers(WALL, log_of(time, gas, ((0, 15), (15, 40))))["wall"]
    assert found[15] == gas[15] == 400.0
    assert found[14] < 400.0


@pytest.mark.parametrize("cuts", [(7,), (1, 2, 30), (15,)])
def test_how_a_recording_is_cut_changes_no_bit(cuts):
    rng = np.random.default_rng(2)
    log = log_of(np.cumsum(rng.uniform(0.1, 0.3, 40)), rng.normal(300.0, 20.0, 40), ((0, 15), (15, 40)))
    (whole,) = log.pieces()
    ends = [0, *cuts, 40]
    pieces = [Piece(whole.time[a:b], {"gas": whole.channels["gas"][a:b]}, whole.begins[a:b]) for a, b in pairwise(ends)]
    parts = np.concatenate([piece.channels["wall"] for piece in followed(WALL, pieces)])
    np.testing.assert_array_equal(parts, with_followers(WALL, log)["wall"])
