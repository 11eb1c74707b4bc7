"""One source: its time bases in seconds, and its channels in the units of the log, every repair counted."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.ingest.profiles import Profile
from lpvobs.ingest.record import ChannelDone, SourceDone
from lpvobs.ingest.recordings import Column, ForeignRecording, as_numbers, find, nearest
from lpvobs.io.arrow import pa, pc
from lpvobs.io.logs.parquet import as_floats
from lpvobs.io.logs.units import canonical, convert, is_broken
from lpvobs.io.safety.atomic import file_digest
from lpvobs.records import Array

DAY = 86400.0
SLAB = 1 << 16
MOST_BACKWARD = 0.1  # share of the stamps that may be dropped for running backward; more is not a repair
TURNS_MISSED = 0.1
"""Share of a polled column's changes that may stand in rows of other columns; with more, it was not polled in turn."""


def stamps(data: "pa.Array | pa.ChunkedArray", unit: str, decimal: str = ".") -> tuple[Array, dict[str, int]]:
    """Return a time column in seconds, NaN where it has no time, and how many entries are unreadable and nights have passed.

    The unit is one of time, `clock` for h:mm:ss.sss, or `datetime` for ISO 8601 text or Arrow time stamps. Raises ValueError for
    another unit, or if the column holds something else.
    """
    if pa.types.is_dictionary(data.type):
        data = data.cast(data.type.value_type)
    if unit in ("clock", "datetime"):
        if pa.types.is_integer(data.type) or pa.types.is_floating(data.type):
            raise ValueError(f"holds {data.type}, but its unit '{unit}' needs text or time stamps")
        return _clock(data) if unit == "clock" else _dates(data)
    if pa.types.is_timestamp(data.type) or pa.types.is_time(data.type):
        raise ValueError(f"holds {data.type}; expected numbers in {unit}, or the unit 'datetime'")
    values, read = as_numbers(data, decimal)
    return convert(values, unit, "s"), {"unreadable": int(read.get("unreadable", 0))}


def _clock(data: "pa.Array | pa.ChunkedArray") -> tuple[Array, dict[str, int]]:
    """Return times of day as seconds that go on past midnight: a step back of more than half a day is the next day."""
    text = pc.replace_substring(pc.utf8_trim_whitespace(pc.fill_null(data.cast(pa.string()), "")), ",", ".")
    parts = pc.extract_regex(text, r"^(?P<h>\d+):(?P<m>\d+)(?::(?P<s>\d+\.?\d*))?$").flatten()
    hours, minutes, seconds = (as_floats(pc.replace_substring_regex(part, "^$", "0")) for part in parts)
    right = (hours < 24) & (minutes < 60) & (seconds < 61)
    time = np.where(right, 3600.0 * hours + 60.0 * minutes + seconds, np.nan)
    unreadable = np.count_nonzero(~right) - pc.sum(pc.equal(text, ""), min_count=0).as_py()
    known = np.flatnonzero(right)
    nights = np.cumsum(np.diff(time[known]) < -0.5 * DAY)
    time[known[1:]] += DAY * nights
    return time, {"nights": int(nights.max(initial=0)), "unreadable": int(unreadable)}


def _dates(data: "pa.Array | pa.ChunkedArray") -> tuple[Array, dict[str, int]]:
    """Return ISO 8601 text or time stamps as seconds since 1970; a zone is converted, none is taken for UTC."""
    import pandas as pd

    slabs = [np.empty(0)]
    for start in range(0, len(data), SLAB):  # all of a long recording would not fit into memory as Python's own text
        slab = data.slice(start, SLAB).to_pandas()
        found = pd.to_datetime(slab, errors="coerce", utc=True, format="ISO8601")
        slabs.append((found - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy(dtype=float))
    time = np.concatenate(slabs)
    return time, {"unreadable": int(np.count_nonzero(np.isnan(time)) - data.null_count)}


def forward(time: Array) -> NDArray[np.bool_]:
    """Return which stamps are finite and later than every earlier one."""
    latest = np.fmax.accumulate(np.concatenate(([-np.inf], time)))[:-1]
    return np.asarray(time > latest)


def refreshed(values: Array, turn: int, turns: int) -> tuple[int, int]:
    """Return how often a column changes out of its turn, and how often in all; row r is the turn of column r modulo `turns`."""
    changed = np.flatnonzero((values[1:] != values[:-1]) & np.isfinite(values[:-1])) + 1
    return int(np.count_nonzero(changed % turns != turn)), changed.size


def polled(columns: Mapping[str, Array], turns: list[str]) -> float:
    """Return which share of all changes falls into the turn of its column, NaN for under three columns or a hundred changes."""
    # By chance it would be one in the number of columns. `turns` are all columns besides time, in the order of the file.
    counts = [refreshed(values, turns.index(name), len(turns)) for name, values in columns.items()]
    late, every = (sum(count[end] for count in counts) for end in (0, 1))
    return 1.0 - late / every if len(turns) >= 3 and every >= 100 else float("nan")


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
        bases: dict[str, tuple[Array, dict[str, int]]] = {}
        self.samples: dict[str, RecordedSamples] = {}
        for name, full in wanted.items():
            clock = clocks[name] or full
            if clock not in bases:
                bases[clock] = self._time_base(columns[clock], clock, bool(clocks[name]))
            self.samples[name] = self._samples(name, full, columns[full], clock, bases[clock][0])
        repairs = {clock: repairs for clock, (_, repairs) in bases.items() if repairs}
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

    def _time_base(self, column: Column, name: str, is_clock: bool) -> tuple[Array, dict[str, int]]:
        """Return stamps [s], shape (N,), NaN where one is not later than all before, and what was repaired."""
        where, rules, repairs = f"{self.path}: time column '{name}'", self.profile.time, dict[str, int]()
        time = column.time
        if is_clock:
            unit = rules.unit or self.recording.heads[name].unit
            if not unit:
                raise DataError(f"{where} has no unit; set unit in the profile's [time]")
            try:
                time, repairs = stamps(column.data, unit, self.profile.source.decimal)
            except ValueError as error:
                raise DataError(f"{where}: {error}; correct unit in the profile's [time]") from None
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
        later = forward(time)
        backward = np.flatnonzero(np.isfinite(time) & ~later)
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
        return np.where(later, time, np.nan), {key: count for key, count in repairs.items() if count}

    def _samples(self, name: str, full: str, column: Column, clock: str, time: Array) -> RecordedSamples:
        rules, source, file_unit = self.profile.channels[name], self.profile.source, self.recording.heads[full].unit
        where = f"{self.path}: channel '{name}'"
        try:
            raw, repairs = as_numbers(column.data, source.decimal)
        except ValueError as error:
            raise DataError(f"{where} ('{full}') {error}; export it as numbers") from None
        if raw.size != time.size:
            raise DataError(
                f"{where} ('{full}') has {raw.size} samples, but its time column has {time.size}; "
                f"name the right time column with the key time in the profile's [channels.{name}]"
            )
        if raw.size and repairs.get("unreadable") == raw.size:
            text = f"text such as '{str(repairs['example'])[:20]}'"
            raise DataError(f"{where} ('{full}') holds {text}, expected numbers; check decimal in [source]")
        keep = np.isfinite(time)
        if source.polled:
            mine, late = self._in_turn(full, clock, raw)
            keep, repairs = keep & mine, {"out_of_turn": late, **repairs}
        raw = raw[keep]
        unit = canonical(rules.source_unit or file_unit)
        if not unit:
            raise DataError(f"{where} has no unit in the file; set source_unit in [channels.{name}]")
        invalid = np.isin(raw, rules.invalid)
        try:
            values = convert(rules.scale * np.where(invalid, np.nan, raw) + rules.offset, unit, rules.unit)
        except ValueError as error:
            raise DataError(f"{where}: {error}; correct unit or source_unit in the profile") from None
        outside = (values < rules.low) | (values > rules.high)
        values = np.where(outside | ~np.isfinite(values), np.nan, values)
        counts = {"empty": ~np.isfinite(raw), "invalid": invalid, "out_of_range": outside}
        repairs |= {key: int(np.count_nonzero(rows)) for key, rows in counts.items()}
        if (rules.scale, rules.offset) != (1.0, 0.0):
            repairs["rescaled"] = f"{rules.scale:g} * recorded + {rules.offset:g} {unit}"
        if file_unit and rules.source_unit and canonical(file_unit) != unit:
            repairs["unit"] = f"the unit is {file_unit} in the file, but {rules.source_unit} in the profile"
        elif is_broken(rules.source_unit or file_unit):
            repairs["unit_spelling"] = f"{rules.source_unit or file_unit} read as {unit}"
        made = {key: found for key, found in repairs.items() if found}
        count = int(np.count_nonzero(np.isfinite(values)))
        done = ChannelDone(self.path.name, full, file_unit, unit, rules.unit, rules.meaning, count, made)
        return RecordedSamples(time[keep], values, done)

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
