"""Channels with time bases of their own brought to the stamps of one log, each by its rule."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lpvobs.errors import DataError
from lpvobs.ingest import resample
from lpvobs.ingest.profiles import ChannelRules, Profile
from lpvobs.ingest.record import ChannelDone
from lpvobs.ingest.recordings import MOST_BYTES
from lpvobs.ingest.repairs import RecordedSamples
from lpvobs.records import Array

USUAL_STEPS = 2.5
"""A channel may be held or bridged for so many of its own usual steps, if that is longer than the raster's gap."""

FASTER = 1.5
"""A channel this many times as fast as the raster is averaged unless its profile says otherwise."""


def on_raster(
    samples: Mapping[str, RecordedSamples], profile: Profile
) -> tuple[Array, dict[str, Array], dict[str, ChannelDone]]:
    """Return the stamps of the log, every channel at them, and what was done to it."""
    rate = profile.raster.rate
    if rate == 0:
        at = _common(samples)
    else:
        span = max(item.time[-1] for item in samples.values()) - min(item.time[0] for item in samples.values())
        needed = 8.0 * (span * rate + 1) * (len(samples) + 1)
        if needed > MOST_BYTES:
            file = next(iter(samples.values())).done.file
            raise DataError(
                f"{file}: {span:.6g} s at {rate:g} Hz would take {needed / 2**30:.3g} GiB, expected at most "
                f"{MOST_BYTES / 2**30:.0f}; check the unit of time, or lower rate in the profile's [raster]"
            )
        at = resample.raster([item.time for item in samples.values()], rate, profile.raster.gap)
    placed = {name: _placed(item, at, profile.channels[name], profile) for name, item in samples.items()}
    return (
        at,
        {name: values for name, (values, _) in placed.items()},
        {name: done for name, (_, done) in placed.items()},
    )


def _common(samples: Mapping[str, RecordedSamples]) -> Array:
    """Return the one time base that all channels share."""
    first, *others = samples
    for name in others:
        if not np.array_equal(samples[name].time, samples[first].time):
            raise DataError(
                f"{samples[name].done.file}: channel '{name}' is recorded at other times than '{first}', expected one "
                f"time base; state rate in the profile's [raster]"
            )
    return samples[first].time


def _placed(item: RecordedSamples, at: Array, rules: ChannelRules, profile: Profile) -> tuple[Array, ChannelDone]:
    """Return a channel at the stamps of the log, and what was done to it."""
    finite = np.isfinite(item.values)
    t, v = item.time[finite], item.values[finite]
    step = resample.median_step(t)
    limit = rules.limit or max(profile.raster.gap, USUAL_STEPS * step if t.size > 1 else 0.0)
    rule, why = _rule(step, rules, profile.raster.rate)
    if rule == "as recorded":
        values = item.values
    elif t.size == 0:
        values = np.full(at.size, np.nan)
    elif rule == "hold":
        values = resample.hold(t, v, at, limit)
    elif rule == "linear":
        values = resample.linear(t, v, at, limit)
    else:
        width = 1.0 / profile.raster.rate if profile.raster.rate else resample.median_step(at)
        values = resample.mean(t, v, at, limit, width)
    values = np.where(np.isfinite(values), values, np.nan)
    far = resample.bridged(t, at) if t.size > 1 and rule != "as recorded" else False
    return values, replace(
        item.done,
        rate=1.0 / step if t.size > 1 else None,
        rule=rule,
        rule_from=why,
        limit=limit,
        bridged=int(np.count_nonzero(far & np.isfinite(values))),
        without_value=int(np.count_nonzero(~np.isfinite(values))),
    )


def _rule(step: float, rules: ChannelRules, rate: float) -> tuple[str, str]:
    """Return how a channel comes to the raster, and who said so."""
    aliased = rate > 0 and step * rate * FASTER < 1
    if rules.rule:
        note = "; faster than the raster: aliases" if aliased and rules.rule != "mean" else ""
        return rules.rule, f"profile{note}"
    if rate == 0:
        return "as recorded", "no rate in the profile"
    return ("mean", "default: faster than the raster") if aliased else ("linear", "default: not faster than the raster")
