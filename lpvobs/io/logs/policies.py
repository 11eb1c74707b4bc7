"""The samples of a log that can be used: what to do with its defects, and the rules that find them.

The rules look at the log alone, not at an engine's constants. A healthy log trips none of them: they ask for what noise and
quantisation do not do. They cannot see a wrong unit that leaves every reading possible, such as g/s said to be kg/h.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.channels import Channel, Pulsation, Sensor
from lpvobs.errors import DataError
from lpvobs.observer.readings import put_right
from lpvobs.records import Array, DefectFound, Defects, Piece

Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]
Values = Mapping[str, Array]
Channels = Mapping[str, Channel]

MOST_BACKWARD = 0.1  # share of the samples that may be dropped for their time; more is not a repair
MOST_IMPOSSIBLE = 0.1
"""Share of a channel's readings outside its possible range that a fault of the sensor explains; more is a wrong unit."""
MOST_BELOW = 0.02  # share of a channel's readings that may lie below what bounds it physically; more is a wrong unit
MOVES, RESTS, DEAD = 0.05, 0.01, 0.2
"""Standard deviation over the typical range from which on a channel moves, and to which it stands but for noise; and the
correlation with channels that move under which it follows none."""
FASTEST = 2e-4
"""[s] Smallest median step of a log. Times in milliseconds or minutes that are called seconds lie far from it."""
MOVING, MOVERS = 0.3, 2
"""A channel moves when it crosses this share of its range; so many others have to move for one that stands still to be stuck."""
SATURATED_SHARE, SATURATED_RUN, PILED = 0.005, 10, 3
"""Least share of samples at the very top, in runs of so many samples, and how many more there than just below the top."""
MOST_STILL_AT_TOP = 120.0
"""[s]; what may stand still for longer, such as fuel at full load or a coarse temperature, may do so at its top."""
SPIKE, SPIKE_NOISE, SPIKE_SPACING = 0.1, 30.0, 0.03
"""Least height over the typical range and over the noise (median absolute deviation), largest spacing [s] of its neighbours."""


@dataclass(frozen=True)
class ChannelLimits:
    """Where a working sensor of one engine reads, in the channel's unit; None leaves what holds for the kind of engine."""

    low: float | None = None  # a sample below is a defect
    high: float | None = None  # a sample above is a defect
    typical: tuple[float, float] | None = None  # range in which the median of a whole log lies

    def __post_init__(self) -> None:
        for low, high in ((self.low, self.high), self.typical or (None, None)):
            if low is not None and high is not None and not low < high:
                raise ValueError(f"the lower limit {low:g} must be below the upper limit {high:g}")


@dataclass(frozen=True)
class LogPolicies:
    """What to do with defects; the configuration's `[policies]`."""

    gap_limit: float = 1.0  # [s]; a longer step between samples splits the log into segments
    # `refuse` the log, or `drop` the samples whose time is not later than every earlier one
    backward_time: str = "refuse"
    # of channels of which the configured engine's sensors read elsewhere than those of most of its kind
    limits: Mapping[str, ChannelLimits] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.gap_limit > 0:
            raise ValueError("gap_limit must be positive")
        if self.backward_time not in ("refuse", "drop"):
            raise ValueError("backward_time must be 'refuse' or 'drop'")

    def limited(self, channels: Mapping[str, Channel]) -> dict[str, Channel]:
        """Return channels with the limits that are configured in place of their own."""
        own = {name: {k: v for k, v in asdict(item).items() if v is not None} for name, item in self.limits.items()}
        return {name: replace(channel, **own.get(name, {})) for name, channel in channels.items()}

    def right(self, pieces: Iterable[Piece]) -> Iterable[Piece]:
        """Return readings as recorded."""
        return pieces


@dataclass(frozen=True)
class Reading(LogPolicies):
    """The policies, and what is known of the sensors, for whoever works with what they should have shown."""

    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    narrowest: float = 0.0  # [s], half width of the narrowest window
    pulsation: Pulsation | None = None  # of the engine's air flow sensor

    def right(self, pieces: Iterable[Piece]) -> Iterator[Piece]:
        """Yield readings put right."""
        return put_right(pieces, self.sensors, self.narrowest, self.pulsation)


def together(one: Defects, other: Defects) -> Defects:
    """Return what two parts of a log lost; findings of a kind and channel are counted together, from the first of them on."""
    findings = {(item.kind, item.channel): item for item in one.findings}
    for item in other.findings:
        known = findings.get((item.kind, item.channel), replace(item, samples=0))
        findings[item.kind, item.channel] = replace(known, samples=known.samples + item.samples)
    return Defects(
        one.samples_read + other.samples_read,
        dict(Counter(one.dropped) + Counter(other.dropped)),
        one.dropped_rows + other.dropped_rows,
        one.gaps + other.gaps,
        one.repeated + other.repeated,
        tuple(findings.values()),
    )


def usable_rows(
    path: Path, time: Array, values: Values, channels: Channels, policies: LogPolicies, latest: float
) -> tuple[Rows, Defects]:
    """Return the rows that are finite, possible, later than each other and than `latest`, not stuck or spiked; and what was lost.

    Raises DataError for time that runs backward, where the policies do not drop it, and for an odd rate.
    """
    good = {"time": np.isfinite(time)} | {name: _possible(column, channels[name]) for name, column in values.items()}
    dropped = {name: int(np.count_nonzero(~samples)) for name, samples in good.items()}
    keep = np.logical_and.reduce(list(good.values()))
    rows, repeated = _increasing(path, time, np.flatnonzero(keep), policies, latest)
    _refuse_odd_rate(path, time[rows], policies.gap_limit)
    t, kept = time[rows], {name: column[rows] for name, column in values.items()}
    findings = []
    for name, channel in channels.items():
        if not np.isfinite(channel.still) or t.size < 3:
            continue
        for kind, samples in (
            ("stuck", _stuck(t, kept, channels, name)),
            ("saturated", _saturated(kept[name], channel)),
            ("spike", _spikes(t, kept[name], channel)),
        ):
            if samples.size:
                findings.append(DefectFound(kind, name, samples.size, float(t[samples[0]]), "drop"))
                dropped[name] += samples.size
                keep[rows[samples]] = False
    lost = int(keep.size - np.count_nonzero(keep))
    return rows[keep[rows]], Defects(time.size, dropped, lost, repeated=repeated, findings=tuple(findings))


def _increasing(path: Path, time: Array, rows: Rows, policies: LogPolicies, latest: float) -> tuple[Rows, int]:
    """Return the rows whose time is later than every earlier one and `latest`, and how many were removed for it."""
    kept = time[rows]
    before = np.maximum.accumulate(np.concatenate(([latest], kept)))[:-1]
    later = kept > before
    wrong = int(np.count_nonzero(~later))
    if wrong and policies.backward_time == "refuse":
        first = int(np.flatnonzero(~later)[0])
        raise DataError(
            f"{path}: channel 'time' repeats or runs backward {wrong} times, first at {kept[first]:.6g} s, which follows "
            f"{before[first]:.6g} s (row {rows[first]}); expected strictly increasing time; "
            f'repair the log or set backward_time = "drop" in [policies]'
        )
    if wrong > MOST_BACKWARD * kept.size:
        raise DataError(
            f"{path}: channel 'time' repeats or runs backward at {wrong} of {kept.size} samples, expected at most "
            f"{100 * MOST_BACKWARD:.0f} %; a single time far in the future can cause this; repair the log"
        )
    return rows[later], wrong


def refuse_implausible(path: Path, values: Values, channels: Channels) -> None:
    """Raise DataError for a wrong unit or sign of a channel: values (N,) in the contract's units, NaN where the file has none."""
    for rules in ((_dead, _impossible), (_too_low,)):
        for name, rule in product(channels, rules):
            if complaint := rule(name, values, channels):
                raise DataError(f"{path}: channel '{name}' {complaint}")


def _refuse_odd_rate(path: Path, time: Array, gap_limit: float) -> None:
    """Raise DataError for time, shape (N,) [s] and increasing, in steps that only a wrong unit makes; `gap_limit` in s."""
    if time.size < 2:
        return
    step = float(np.median(np.diff(time)))
    if step > gap_limit:
        raise DataError(
            f"{path}: channel 'time' has a median step of {step:.4g} s, expected at most gap_limit = {gap_limit:g} s; "
            f"check the unit of time, record faster, or raise gap_limit in [policies]"
        )
    if step < FASTEST:
        raise DataError(
            f"{path}: channel 'time' has a median step of {step:.4g} s, expected at least {FASTEST:g} s; "
            f"its unit is probably wrong"
        )


def _dead(name: str, values: Values, channels: Channels) -> str:
    """Return what is wrong with a sensor that follows nothing although the engine moves, as one does that is unplugged."""
    follows = channels[name].follows
    chosen = np.logical_and.reduce([_possible(values[each], channels[each]) for each in (name, *follows)])
    if not follows or np.count_nonzero(chosen) <= 0.5 * chosen.size:  # else another rule says why
        return ""
    column = values[name][chosen]
    others = [values[each][chosen] for each in follows if _spread(values[each][chosen], channels[each]) > MOVES]
    if not others or _spread(column, channels[name]) > RESTS:
        return ""
    if column.std() > 0.0 and max(abs(np.corrcoef(column, other)[0, 1]) for other in others) > DEAD:
        return ""
    return (
        f"stays at {np.median(column):.4g} {channels[name].unit} and does not respond to changes of "
        f"{', '.join(follows)}; the sensor is unplugged or dead; connect the sensor and record again"
    )


def _spread(column: Array, channel: Channel) -> float:
    """Return the standard deviation over the width of the range in which medians lie."""
    return float(column.std() / np.ptp(channel.typical))


def _impossible(name: str, values: Values, channels: Channels) -> str:
    """Return what is wrong with a median, or many readings, that no working engine shows: a wrong unit or sign."""
    channel, finite, unit = channels[name], values[name][np.isfinite(values[name])], channels[name].unit
    if finite.size == 0:
        return f"has no numbers, expected readings in {unit}; record it again"
    middle, (low, high), top = float(np.median(finite)), channel.typical, finite.max()
    if not low <= middle <= high:
        between = f"expected a median between {low:g} and {high:g}; its unit or sign is probably wrong"
        return f"has the median {middle:.4g} {unit}, {between}"
    outside = 100.0 * float(np.mean(~_possible(finite, channel)))
    if outside > 100.0 * MOST_IMPOSSIBLE:
        possible = f"{channel.low:g} to {channel.high:g} {unit}"
        return f"has {outside:.0f} % of its readings outside {possible}; its unit is probably wrong"
    if top < channel.reaches:
        at_least = f"expected at least {channel.reaches:g} at some time in a log; its unit is probably wrong"
        return f"never exceeds {top:.3g} {unit}, {at_least}"
    if unit == "%" and 0.5 < top <= 1.0 and np.ptp(finite) > 0.3:
        opening = "expected an opening from 0 to 100 %; it is probably a fraction: give it the unit '1'"
        return f"never exceeds {top:.3g} %, {opening}"
    return ""


def _too_low(name: str, values: Values, channels: Channels) -> str:
    """Return what is wrong with a channel below what bounds it, such as exhaust gas that is colder than the air outside."""
    channel = channels[name]
    if channel.above is None:
        return ""
    other, slack = channel.above
    both = _possible(values[name], channel) & _possible(values[other], channels[other])  # what is not is dropped later
    lower = np.count_nonzero(values[name][both] < values[other][both] - slack)
    below = lower / max(int(np.count_nonzero(both)), 1)
    if below <= MOST_BELOW:
        return ""
    return (
        f"is more than {slack:g} {channel.unit} below '{other}' in {100 * below:.0f} % of the log; "
        f"this happens on no engine; the unit of one of the two channels is probably wrong"
    )


def _possible(column: Array, channel: Channel) -> Mask:
    """Return which samples are readings that a working sensor can give; False for NaN."""
    return (column >= channel.low) & (column <= channel.high)


def _stuck(time: Array, values: Values, channels: Channels, name: str) -> Rows:
    """Return the samples at which a channel stands exactly still for longer than it can, while the engine moves."""
    start, stop = _runs(values[name])
    long = time[stop - 1] - time[start] > channels[name].still
    others = [values[other] for other, item in channels.items() if other != name and np.isfinite(item.still)]
    return _samples((a, b) for a, b in zip(start[long], stop[long], strict=True) if _moves(others, a, b))


def _moves(columns: list[Array], start: int, stop: int) -> bool:
    widths = [np.ptp(np.percentile(column, [1.0, 99.0])) for column in columns]
    crossed = [np.ptp(column[start:stop]) > MOVING * width > 0.0 for column, width in zip(columns, widths, strict=True)]
    return sum(map(bool, crossed)) >= MOVERS


def _saturated(column: Array, channel: Channel) -> Rows:
    """Return the samples at the very top of a channel that piles up there; at rest the bottom is read for minutes."""
    top = column.max()
    count = int(np.count_nonzero(column == top))
    below = int(np.count_nonzero(column >= top - 0.02 * (top - column.min()))) - count
    enough = count >= max(SATURATED_RUN, SATURATED_SHARE * column.size, PILED * below)
    if not enough or count == column.size or channel.still > MOST_STILL_AT_TOP:
        return np.empty(0, dtype=np.int64)
    start, stop = _runs(column)
    held = (column[start] == top) & (stop - start >= SATURATED_RUN)
    held &= np.count_nonzero(held) > 1  # once may be a hold of the recorder
    return _samples(zip(start[held], stop[held], strict=True))


def _spikes(time: Array, column: Array, channel: Channel) -> Rows:
    """Return single samples that leap away from two neighbours that agree."""
    away = column[1:-1] - 0.5 * (column[:-2] + column[2:])
    low, high = channel.typical
    tall = (np.abs(away) > SPIKE * (high - low)) & (np.abs(column[2:] - column[:-2]) < 0.2 * np.abs(away))
    if not tall.any():
        return np.empty(0, dtype=np.int64)
    noise = 1.4826 * float(np.median(np.abs(away)))
    near = np.maximum(np.diff(time)[:-1], np.diff(time)[1:]) <= SPIKE_SPACING
    return np.flatnonzero(tall & near & (np.abs(away) > SPIKE_NOISE * noise)) + 1


def _runs(column: Array) -> tuple[Rows, Rows]:
    """Return starts and ends of the runs of equal values."""
    cuts = np.flatnonzero(np.diff(column)) + 1
    return np.concatenate(([0], cuts)), np.concatenate((cuts, [column.size]))


def _samples(ranges: Iterator[tuple[int, int]]) -> Rows:
    """Return the samples in half-open ranges."""
    return np.concatenate([np.empty(0, dtype=np.int64), *(np.arange(start, stop) for start, stop in ranges)])
