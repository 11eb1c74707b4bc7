"""What the search for the ends of an effect finds on healthy drives.

What a healthy drive leaves comes and goes: an engine that warms up, a manoeuvre that no other drive has. An onset found on another
drive must gain more than the best one on a healthy drive does.
"""

from collections.abc import Sequence

import numpy as np

from lpvobs.discovery.evidence import best_intervals, ends_of, fit_candidate, gains_of_intervals
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.patterns import beyond_of
from lpvobs.discovery.sizes import slope_of
from lpvobs.discovery.thresholds import LEAST_LENGTH
from lpvobs.engines.effects import Effect
from lpvobs.records import Array


def best_onsets(linear: Linear, effect: Effect) -> Array:
    """Return gain, information and share of the time of an effect with one end, and with two, each at its best, (2, 3).

    Gain and information are those over the variance from block to block; all are one where the drive is too short for an onset.
    """
    if linear.problem.first.size < 3 * LEAST_LENGTH:
        return np.ones((2, 3))
    ranges = best_intervals(gains_of_intervals(linear, slope_of(linear, effect, effect.null)))
    found = []
    for first, last in ranges:
        candidate = fit_candidate(linear, effect, *ends_of(linear, first, last))
        uneven, share = max(candidate.unevenness, 1.0), float(candidate.term.acts(linear.problem.clock).mean())
        found.append((candidate.gain / uneven, candidate.information / uneven, share))
    return np.array([max(found[:2]), found[2]])


def over_noise(found: Sequence[Array], late: Array, beyond: Array, data: Array, blocks: Array) -> Array:
    """Return by how much more each of n effects gains by an onset on a healthy drive than in noise, one at least, shape (n, 2).

    Each effect has the mean of all effects at least: what comes and goes may look like another effect on the next drive.
    `found` is (n, 2, 3) of every drive, `late` and `beyond` what sizes vary by, (n,), as `beyond_noise` gives them, `data` and
    `blocks` are (drives,). The largest of m gains by noise, each half of chi-square, is about log m.
    """
    gain, information, share = np.moveaxis(np.array(found), 3, 0)
    most = beyond[:, None] * data[:, None, None]
    told = 1.0 / (1.0 + beyond_of(information, late[:, None], np.maximum(share, 1e-9), most))
    ends = np.maximum(blocks / LEAST_LENGTH, 2.0)[:, None, None] ** np.array([1.0, 2.0])
    own = np.maximum((told * gain / np.log(len(found) * ends)).max(0), 1.0)
    return np.asarray(np.maximum(own, own.mean(0)))
