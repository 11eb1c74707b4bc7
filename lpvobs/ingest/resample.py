"""Channels with time bases of their own brought from their stamps to those of one log, each by the rule that the profile states.

In the pure functions of arrays, t is strictly increasing and v finite, both of shape (N,).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.ingest import profiles, record, recordings, repairs
from lpvobs.records import Array

SLACK = 1e-9  # [s] Rounding of stamps; a sample this much too old is not too old


def _neighbours(t: Array, at: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the numbers of the samples at or before each time, and of those after them; at the ends the outermost."""
    left = np.clip(np.searchsorted(t, at + SLACK, side="right") - 1, 0, t.size - 1)
    return left, np.minimum(left + 1, t.size - 1)


def hold(t: Array, v: Array, at: Array, limit: float) -> Array:
    """Return the last sample at or before each time, NaN where it is older than `limit` [s] or there is none.

    Examples
    --------
    >>> hold(np.array([0.0, 1.0]), np.array([5.0, 7.0]), np.array([0.5, 1.0, 1.8]), 0.7)
    array([ 5.,  7., nan])
    """
    left, _ = _neighbours(t, at)
    age = at - t[left]
    return np.where((age >= -SLACK) & (age <= limit + SLACK), v[left], np.nan)


def linear(t: Array, v: Array, at: Array, limit: float) -> Array:
    """Return the value on the line between the neighbours of each time, NaN where these are further apart than `limit` [s].

    A sample at the very time stands for itself, however far away its neighbours are.

    Examples
    --------
    >>> linear(np.array([0.0, 1.0, 9.0]), np.array([5.0, 7.0, 8.0]), np.array([0.5, 1.0, 5.0]), 2.0)
    array([ 6.,  7., nan])
    """
    left, right = _neighbours(t, at)
    there = np.abs(at - t[left]) <= SLACK
    between = (at > t[left]) & (right > left) & (t[right] - t[left] <= limit + SLACK)
    share = np.clip((at - t[left]) / np.where(right > left, t[right] - t[left], 1.0), 0.0, 1.0)
    return np.where(there, v[left], np.where(between, v[left] + share * (v[right] - v[left]), np.nan))


def mean(t: Array, v: Array, at: Array, limit: float, width: float) -> Array:
    """Return the mean of the signal over `width` [s] around each time: a centred box, which delays nothing.

    The signal is the line between neighbours; where these are further apart than `limit` [s] there is none. NaN where less than
    three quarters of the box hold signal, as at both ends. The box suppresses what lies at multiples of 1/width altogether, and at
    half of it by 3.9 dB.

    Examples
    --------
    >>> mean(np.arange(5.0), np.array([0.0, 2.0, 0.0, 2.0, 0.0]), np.array([2.0]), 1.5, 2.0)
    array([1.])
    """
    step = np.diff(t)
    step = np.where(step <= limit + SLACK, step, 0.0)
    cover = np.concatenate(([0.0], np.cumsum(step)))
    area = np.concatenate(([0.0], np.cumsum(step * 0.5 * (v[1:] + v[:-1]))))
    (low_cover, low_area), (high_cover, high_area) = (
        _integrals(t, v, cover, area, np.clip(at + side, t[0], t[-1]), limit) for side in (-width / 2, width / 2)
    )
    held = high_cover - low_cover
    return np.where(held >= 0.75 * width - SLACK, (high_area - low_area) / np.where(held > 0, held, 1.0), np.nan)


def _integrals(t: Array, v: Array, cover: Array, area: Array, at: Array, limit: float) -> tuple[Array, Array]:
    """Return time covered by signal, and integral of the signal, from the first stamp to each time."""
    left = np.clip(np.searchsorted(t, at, side="right") - 1, 0, max(t.size - 2, 0))
    right = np.minimum(left + 1, t.size - 1)
    step = t[right] - t[left]
    inside = np.where(step <= limit + SLACK, at - t[left], 0.0)
    slope = (v[right] - v[left]) / np.where(step > 0, step, 1.0)
    return cover[left] + inside, area[left] + inside * (v[left] + 0.5 * inside * slope)


def raster(times: list[Array], rate: float, gap: float) -> Array:
    """Return evenly spaced times, shape (M,), at a rate [Hz] from the first to the last of all channels' stamps [s].

    None lies where no channel has a sample for longer than `gap` [s].
    """
    stamps = np.unique(np.concatenate(times))
    count = int(np.floor((stamps[-1] - stamps[0]) * rate + 1e-6)) + 1
    at = stamps[0] + np.arange(count) / rate
    left, right = _neighbours(stamps, at)
    inside = (stamps[right] - stamps[left] > gap) & (at > stamps[left] + SLACK) & (at < stamps[right] - SLACK)
    return np.asarray(at[~inside])


def median_step(t: Array) -> float:
    """Return the usual distance of samples [s], NaN for fewer than two."""
    return float(np.median(np.diff(t))) if t.size > 1 else float("nan")


def bridged(t: Array, at: Array) -> NDArray[np.bool_]:
    """Return which times stand between samples more than twice the usual step apart: the rule speaks there, not the sensor."""
    left, right = _neighbours(t, at)
    return np.asarray((t[right] - t[left] > 2.0 * median_step(t)) & (at > t[left] + SLACK))


USUAL_STEPS = 2.5  # of its own that a channel may be held or bridged for, if that is longer than the raster's gap
FASTER = 1.5  # a channel this many times as fast as the raster is averaged unless its profile says otherwise


def on_raster(
    samples: Mapping[str, repairs.RecordedSamples], profile: profiles.Profile
) -> tuple[Array, dict[str, Array], dict[str, record.ChannelDone]]:
    """Return the stamps of the log, every channel at them, and what was done to it."""
    rate = profile.raster.rate
    if rate == 0:
        at = _common(samples)
    else:
        span = max(item.time[-1] for item in samples.values()) - min(item.time[0] for item in samples.values())
        recordings.check_size(
            f"{next(iter(samples.values())).done.file}: a log of {span:.6g} s at {rate:g} Hz",
            8.0 * (span * rate + 1) * (len(samples) + 1),
            "check the unit of time, or lower rate in the profile's [raster]",
        )
        at = raster([item.time for item in samples.values()], rate, profile.raster.gap)
    values, done = {}, {}
    for name, item in samples.items():
        values[name], done[name] = _placed(item, at, profile.channels[name], profile)
    return at, values, done


def _common(samples: Mapping[str, repairs.RecordedSamples]) -> Array:
    first, *others = samples
    for name in others:
        if not np.array_equal(samples[name].time, samples[first].time):
            raise DataError(
                f"{samples[name].done.file}: channel '{name}' is recorded at other times than '{first}', expected one "
                f"time base; set rate in the profile's [raster]"
            )
    return samples[first].time


def _placed(
    item: repairs.RecordedSamples, at: Array, rules: profiles.ChannelRules, profile: profiles.Profile
) -> tuple[Array, record.ChannelDone]:
    """Return a channel at the stamps of the log, and what was done to it."""
    finite = np.isfinite(item.values)
    t, v = item.time[finite], item.values[finite]
    step = median_step(t)
    limit = rules.limit or max(profile.raster.gap, USUAL_STEPS * step if t.size > 1 else 0.0)
    rule, why = _rule(step, rules, profile.raster.rate)
    if rule == "as recorded":
        values = item.values
    elif t.size == 0:
        values = np.full(at.size, np.nan)
    elif rule == "mean":
        values = mean(t, v, at, limit, 1.0 / profile.raster.rate if profile.raster.rate else median_step(at))
    else:
        values = {"hold": hold, "linear": linear}[rule](t, v, at, limit)
    values = np.where(np.isfinite(values), values, np.nan)
    far = bridged(t, at) if t.size > 1 and rule != "as recorded" else False
    return values, replace(
        item.done,
        rate=1.0 / step if t.size > 1 else None,
        rule=rule,
        rule_from=why,
        limit=limit,
        bridged=int(np.count_nonzero(far & np.isfinite(values))),
        without_value=int(np.count_nonzero(~np.isfinite(values))),
    )


def _rule(step: float, rules: profiles.ChannelRules, rate: float) -> tuple[str, str]:
    """Return how a channel comes to the raster, and who said so."""
    aliased = rate > 0 and step * rate * FASTER < 1
    if rules.rule:
        note = "; faster than the raster, so it aliases" if aliased and rules.rule != "mean" else ""
        return rules.rule, f"profile{note}"
    if rate == 0:
        return "as recorded", "no rate in the profile"
    return ("mean", "default: faster than the raster") if aliased else ("linear", "default: not faster than the raster")
