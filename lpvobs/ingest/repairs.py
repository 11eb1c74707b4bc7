"""One channel of one source: its samples in the unit of the log, repaired as the profile says, every repair counted."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.ingest.clocks import TimeBase
from lpvobs.ingest.layouts import refreshed
from lpvobs.ingest.profiles import ChannelRules, Profile
from lpvobs.ingest.record import ChannelDone, Repairs
from lpvobs.ingest.recordings import Column, ForeignRecording, as_numbers
from lpvobs.io.logs.units import canonical, convert, is_broken
from lpvobs.records import Array

TURNS_MISSED = 0.1
"""Share of a polled column's changes that may stand in rows of other columns; with more, it was not polled in turn."""


@dataclass(frozen=True)
class RecordedSamples:
    """One channel as recorded, in the unit of the log."""

    time: Array  # (N,) [s], strictly increasing
    values: Array  # (N,) [unit of the log]; NaN where the recording has no value
    done: ChannelDone  # where it comes from and what was repaired


def samples_of(
    recording: ForeignRecording, full: str, column: Column, base: TimeBase, clock: str, name: str, profile: Profile
) -> RecordedSamples:
    """Return the channel `name` of a source: its column and time base, both with their full names, and the profile."""
    rules, path, file_unit = profile.channels[name], recording.path, recording.heads[full].unit
    try:
        numbers = as_numbers(column.data, profile.source.decimal)
    except ValueError as error:
        raise DataError(f"{path}: channel '{name}' ('{full}') {error}; export it as numbers") from None
    if numbers.values.size != base.time.size:
        raise DataError(
            f"{path}: channel '{name}' ('{full}') has {numbers.values.size} samples and its time {base.time.size}; "
            f"name the right time base: time in the profile's [channels.{name}]"
        )
    if numbers.values.size and numbers.unreadable == numbers.values.size:
        raise DataError(
            f"{path}: channel '{name}' ('{full}') holds text such as '{numbers.example[:20]}', expected numbers; check decimal"
        )
    keep, late = base.keep, 0
    if profile.source.polled:
        mine, late = _in_turn(recording, full, clock, numbers.values)
        keep = keep & mine
    values, unit, repairs = _repaired(path, file_unit, numbers.values[keep], name, rules)
    reading: Repairs = {"out_of_turn": late, "unreadable": numbers.unreadable, "example": numbers.example}
    done = ChannelDone(
        file=path.name,
        source=full,
        unit_in_file=file_unit,
        unit_read_as=unit,
        unit=rules.unit,
        meaning=rules.meaning,
        samples=int(np.count_nonzero(np.isfinite(values))),
        repairs={key: count for key, count in [*reading.items(), *repairs.items()] if count},
    )
    return RecordedSamples(base.time[keep], values, done)


def _in_turn(recording: ForeignRecording, full: str, clock: str, values: Array) -> tuple[NDArray[np.bool_], int]:
    """Return the rows in which a polled column is refreshed, and how often it changes in others."""
    turns = [name for name in recording.heads if name != clock]
    turn = turns.index(full)
    late, changes = refreshed(values, turn, len(turns))
    if late > 1 and late > TURNS_MISSED * changes:
        raise DataError(
            f"{recording.path}: '{full}' changes {late} of {changes} times in rows of other columns, expected one column per "
            f"row in turn; lines are missing, or leave out polled in the profile's [source]"
        )
    return np.arange(values.size) % len(turns) == turn, late


def _repaired(path: Path, file_unit: str, raw: Array, name: str, rules: ChannelRules) -> tuple[Array, str, Repairs]:
    """Return values in the unit of the log, the unit that they were read in, and what was repaired."""
    unit = canonical(rules.source_unit or file_unit)
    if not unit:
        raise DataError(
            f"{path}: channel '{name}' has no unit in the file; state source_unit in the profile's [channels.{name}]"
        )
    invalid = np.isin(raw, rules.invalid)
    try:
        values = convert(rules.scale * np.where(invalid, np.nan, raw) + rules.offset, unit, rules.unit)
    except ValueError as error:
        raise DataError(f"{path}: channel '{name}' has the {error}; mend unit or source_unit in the profile") from None
    outside = (values < rules.low) | (values > rules.high)
    counts: dict[str, int | str] = {
        "empty": int(np.count_nonzero(~np.isfinite(raw))),
        "invalid": int(np.count_nonzero(invalid)),
        "out_of_range": int(np.count_nonzero(outside)),
    }
    if (rules.scale, rules.offset) != (1.0, 0.0):
        counts["rescaled"] = f"{rules.scale:g} * recorded + {rules.offset:g} {unit}"
    if file_unit and rules.source_unit and canonical(file_unit) != unit:
        counts["unit"] = f"the file says {file_unit}, the profile {rules.source_unit}"
    elif is_broken(rules.source_unit or file_unit):
        counts["unit_spelling"] = f"{rules.source_unit or file_unit} read as {unit}"
    return np.where(outside | ~np.isfinite(values), np.nan, values), unit, counts
