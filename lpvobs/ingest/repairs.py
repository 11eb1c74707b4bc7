"""One source: its time bases in seconds, and its channels in the units of the log, every repair counted."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.ingest.guesses import refreshed
from lpvobs.ingest.profiles import ChannelRules, Profile
from lpvobs.ingest.record import ChannelDone, Repairs, SourceDone
from lpvobs.ingest.recordings import Column, ForeignRecording, as_numbers, find, nearest
from lpvobs.io.arrow import pa
from lpvobs.io.logs.units import canonical, convert, is_broken
from lpvobs.io.safety.atomic import file_digest
from lpvobs.records import Array

DAY = 86400.0
SLAB = 1 << 16
MOST_BACKWARD = 0.1  # share of the stamps that may be dropped for running backward; more is not a repair
TURNS_MISSED = 0.1
"""Share of a polled column's changes that may stand in rows of other columns; with more, it was not polled in turn."""


@dataclass(frozen=True)
class Stamps:
    """A time base."""

    time: Array  # (N,) [s], NaN where the file has no time
    unreadable: int = 0  # entries that are no time
    nights: int = 0  # midnights that the time of day has passed


def stamps(data: "pa.Array | pa.ChunkedArray", unit: str, decimal: str = ".") -> Stamps:
    """Return a time column as seconds; raises ValueError for another unit, or if the column holds something else."""
    # The unit is one of time, `clock` for h:mm:ss.sss, or `datetime` for ISO 8601 text or Arrow time stamps.

    if unit in ("clock", "datetime"):
        if pa.types.is_integer(data.type) or pa.types.is_floating(data.type):
            raise ValueError(f"holds {data.type}, but its unit '{unit}' needs text or time stamps")
        return _clock(data) if unit == "clock" else _dates(data)
    if pa.types.is_timestamp(data.type) or pa.types.is_time(data.type):
        raise ValueError(f"holds {data.type}; expected numbers in {unit}, or the unit 'datetime'")
    numbers = as_numbers(data, decimal)
    return Stamps(convert(numbers.values, unit, "s"), numbers.unreadable)


def seconds_of_day(text: str) -> float:
    """Return the seconds since midnight of h:mm, h:mm:ss or h:mm:ss.sss, NaN for anything else.

    Examples
    --------
    >>> seconds_of_day("19:17:19.5"), seconds_of_day("7:05"), seconds_of_day("soon")
    (69439.5, 25500.0, nan)
    """
    parts = text.strip().replace(",", ".").split(":")
    if not 2 <= len(parts) <= 3 or not all(part.replace(".", "", 1).isdecimal() for part in parts):
        return np.nan
    hours, minutes, seconds = (float(part) for part in [*parts, "0"][:3])
    return 3600.0 * hours + 60.0 * minutes + seconds if hours < 24 and minutes < 60 and seconds < 61 else np.nan


def _clock(data: "pa.Array | pa.ChunkedArray") -> Stamps:
    """Return times of day as seconds that go on past midnight: a step back of more than half a day is the next day."""
    slabs, unreadable = [np.empty(0)], 0
    for start in range(0, len(data), SLAB):  # as Python's own text, all of a long recording would not fit into memory
        words = ["" if item is None else str(item) for item in data.slice(start, SLAB).to_pylist()]
        slabs.append(np.array([seconds_of_day(word) for word in words]))
        unreadable += sum(1 for word, value in zip(words, slabs[-1], strict=True) if word.strip() and np.isnan(value))
    time = np.concatenate(slabs)
    known = np.flatnonzero(np.isfinite(time))
    nights = np.cumsum(np.diff(time[known]) < -0.5 * DAY)
    time[known[1:]] += DAY * nights
    return Stamps(time, unreadable, int(nights[-1]) if nights.size else 0)


def _dates(data: "pa.Array | pa.ChunkedArray") -> Stamps:
    """Return ISO 8601 text or time stamps as seconds since 1970; a zone is converted, none is taken for UTC."""
    import pandas as pd

    slabs = [np.empty(0)]
    for start in range(0, len(data), SLAB):
        slab = data.slice(start, SLAB).to_pandas()
        found = pd.to_datetime(slab, errors="coerce", utc=True, format="ISO8601")
        slabs.append((found - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy(dtype=float))
    time = np.concatenate(slabs)
    return Stamps(time, int(np.count_nonzero(np.isnan(time)) - data.null_count))


def forward(time: Array) -> NDArray[np.bool_]:
    """Return which stamps are finite and later than every earlier one."""
    latest = np.fmax.accumulate(np.concatenate(([-np.inf], time)))[:-1]
    return np.asarray(time > latest)


@dataclass(frozen=True)
class TimeBase:
    """Stamps [s], shape (N,), which rows of them are used, and what was repaired."""

    time: Array
    keep: NDArray[np.bool_]
    repairs: Mapping[str, int]


@dataclass(frozen=True)
class RecordedSamples:
    """One channel as recorded, in the unit of the log."""

    time: Array  # (N,) [s], strictly increasing
    values: Array  # (N,) [unit of the log]; NaN where the recording has no value
    done: ChannelDone  # where it comes from and what was repaired


class Source:
    """A foreign recording as a profile reads it: its samples by channel, and what was done to it."""

    def __init__(self, recording: ForeignRecording, profile: Profile, wanted: Mapping[str, str]):
        # `wanted` are the channels with the full names of their columns
        self.recording, self.profile, self.path = recording, profile, recording.path
        clocks = {name: self._clock(profile.channels[name].time or profile.time.source) for name in wanted}
        columns = recording.read(list(dict.fromkeys([*wanted.values(), *filter(None, clocks.values())])))
        bases: dict[str, TimeBase] = {}
        self.samples: dict[str, RecordedSamples] = {}
        for name, full in wanted.items():
            clock = clocks[name] or full
            if clock not in bases:
                bases[clock] = self._time_base(columns[clock], clock, bool(clocks[name]))
            self.samples[name] = self._samples(name, full, columns[full], clock, bases[clock])
        repairs = {clock: base.repairs for clock, base in bases.items() if base.repairs}
        self.done = SourceDone(self.path.name, file_digest(self.path), dict(recording.notes), repairs)

    def _clock(self, wanted: str) -> str | None:
        """Return the full name of the column that holds a channel's time, None where the format keeps it with the channel."""
        full = find(self.recording, [wanted], "time") if wanted else None
        if wanted and full is None:
            raise DataError(
                f"{self.path}: time column '{wanted}' is missing; {nearest(self.recording.heads, [wanted])}; "
                f"correct source in the profile's [time]"
            )
        return full

    def _time_base(self, column: Column, name: str, is_clock: bool) -> TimeBase:
        """Return a time base in seconds with the rows that run forward."""
        where, rules = f"{self.path}: time column '{name}'", self.profile.time
        time, repairs = self._seconds(column, name, where) if is_clock else (column.time, {})
        if time is None:
            raise DataError(
                f"{self.path}: this file format stores no time with the channels; name the time column with source in the "
                "profile's [time]"
            )
        stamped = int(np.count_nonzero(np.isfinite(time)))
        if stamped < 2:
            raise DataError(
                f"{where} has {stamped} readable time stamps, expected at least two; check [time] in the profile"
            )
        keep = forward(time)
        backward = np.flatnonzero(np.isfinite(time) & ~keep)
        if backward.size and rules.backward == "refuse":
            raise DataError(
                f"{where} repeats or runs backward {backward.size} times, first at {time[backward[0]]:.6g} s (row {backward[0]}); "
                'expected strictly increasing time; repair the file or set backward = "drop" in the profile\'s [time]'
            )
        if backward.size > MOST_BACKWARD * time.size:
            raise DataError(
                f"{where} repeats or runs backward at {backward.size} of {time.size} samples, expected at most "
                f"{100 * MOST_BACKWARD:.0f} %; repair the file"
            )
        repairs |= {"backward": backward.size, "empty": time.size - stamped - repairs.get("unreadable", 0)}
        return TimeBase(time, keep, {key: count for key, count in repairs.items() if count})

    def _seconds(self, column: Column, name: str, where: str) -> tuple[Array, dict[str, int]]:
        """Return a clock column in seconds, and what in it was repaired."""
        unit = self.profile.time.unit or self.recording.heads[name].unit
        if not unit:
            raise DataError(f"{where} has no unit; set unit in the profile's [time]")
        try:
            found = stamps(column.data, unit, self.profile.source.decimal)
        except ValueError as error:
            raise DataError(f"{where}: {error}; correct unit in the profile's [time]") from None
        return found.time, {"nights": found.nights, "unreadable": found.unreadable}

    def _samples(self, name: str, full: str, column: Column, clock: str, base: TimeBase) -> RecordedSamples:
        """Return a channel from its column and time base."""
        rules, file_unit = self.profile.channels[name], self.recording.heads[full].unit
        where = f"{self.path}: channel '{name}' ('{full}')"
        try:
            numbers = as_numbers(column.data, self.profile.source.decimal)
        except ValueError as error:
            raise DataError(f"{where} {error}; export it as numbers") from None
        if numbers.values.size != base.time.size:
            raise DataError(
                f"{where} has {numbers.values.size} samples, but its time column has {base.time.size}; "
                f"name the right time column with the key time in the profile's [channels.{name}]"
            )
        if numbers.values.size and numbers.unreadable == numbers.values.size:
            text = numbers.example[:20]
            raise DataError(f"{where} holds text such as '{text}', expected numbers; check decimal in [source]")
        keep, late = base.keep, 0
        if self.profile.source.polled:
            mine, late = self._in_turn(full, clock, numbers.values)
            keep = keep & mine
        values, unit, repairs = _repaired(self.path, file_unit, numbers.values[keep], name, rules)
        reading: Repairs = {"out_of_turn": late, "unreadable": numbers.unreadable, "example": numbers.example}
        done = ChannelDone(
            file=self.path.name,
            source=full,
            unit_in_file=file_unit,
            unit_read_as=unit,
            unit=rules.unit,
            meaning=rules.meaning,
            samples=int(np.count_nonzero(np.isfinite(values))),
            repairs={key: count for key, count in [*reading.items(), *repairs.items()] if count},
        )
        return RecordedSamples(base.time[keep], values, done)

    def _in_turn(self, full: str, clock: str, values: Array) -> tuple[NDArray[np.bool_], int]:
        """Return the rows in which a polled column is refreshed, and how often it changes in others."""
        turns = [name for name in self.recording.heads if name != clock]
        turn = turns.index(full)
        late, changes = refreshed(values, turn, len(turns))
        if late > 1 and late > TURNS_MISSED * changes:
            raise DataError(
                f"{self.path}: column '{full}' has {late} of {changes} changes in rows of other columns, expected one "
                f"refreshed column per row; add missing lines, or delete polled in [source] if it is not polled"
            )
        return np.arange(values.size) % len(turns) == turn, late


def _repaired(path: Path, file_unit: str, raw: Array, name: str, rules: ChannelRules) -> tuple[Array, str, Repairs]:
    """Return values in the unit of the log, the unit that they were read in, and what was repaired."""
    unit = canonical(rules.source_unit or file_unit)
    if not unit:
        raise DataError(f"{path}: channel '{name}' has no unit in the file; set source_unit in [channels.{name}]")
    invalid = np.isin(raw, rules.invalid)
    try:
        values = convert(rules.scale * np.where(invalid, np.nan, raw) + rules.offset, unit, rules.unit)
    except ValueError as error:
        raise DataError(f"{path}: channel '{name}': {error}; correct unit or source_unit in the profile") from None
    outside = (values < rules.low) | (values > rules.high)
    counts: dict[str, int | str] = {
        "empty": int(np.count_nonzero(~np.isfinite(raw))),
        "invalid": int(np.count_nonzero(invalid)),
        "out_of_range": int(np.count_nonzero(outside)),
    }
    if (rules.scale, rules.offset) != (1.0, 0.0):
        counts["rescaled"] = f"{rules.scale:g} * recorded + {rules.offset:g} {unit}"
    if file_unit and rules.source_unit and canonical(file_unit) != unit:
        counts["unit"] = f"the unit is {file_unit} in the file, but {rules.source_unit} in the profile"
    elif is_broken(rules.source_unit or file_unit):
        counts["unit_spelling"] = f"{rules.source_unit or file_unit} read as {unit}"
    return np.where(outside | ~np.isfinite(values), np.nan, values), unit, counts
