"""Foreign recordings to a log: names, units, stamps and raster, with every repair counted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.ingest.clocks import MOST_BACKWARD, forward, stamps
from lpvobs.ingest.formats import open_recording
from lpvobs.ingest.placing import RecordedSamples, on_raster
from lpvobs.ingest.profiles import ChannelRules, Profile
from lpvobs.ingest.recordings import Column, ForeignRecording, as_numbers, find, nearest
from lpvobs.io.logs.ingest_record import SCHEMA
from lpvobs.io.logs.units import canonical, convert, is_broken
from lpvobs.records import Array

TURNS_MISSED = 0.1
"""Share of a polled column's changes that may stand in rows of other columns; with more, it was not polled in turn."""


@dataclass(frozen=True)
class Ingested:
    """A log that is not yet written.

    Attributes
    ----------
    channels : mapping of str to ndarray, shape (M,)
        `time` first.
    units : mapping of str to str
    record : mapping
        Plain data: what was done; stored with the log under the key `lpvobs.ingest`.
    """

    channels: Mapping[str, Array]
    units: Mapping[str, str]
    record: Mapping[str, Any]


@dataclass
class Base:
    """A time base of one source: stamps, which rows of it are used, and what was repaired."""

    time: Array
    keep: NDArray[np.bool_]
    repairs: dict[str, Any] = field(default_factory=dict)


def ingest(sources: Sequence[Path], profile: Profile) -> Ingested:
    """Return the log in foreign files of one drive.

    Parameters
    ----------
    sources : sequence of Path
        Files with different channels, consecutive parts of one recording, or both. They share one clock.
    profile : Profile

    Raises
    ------
    DataError
        If a file cannot be read, a channel is missing, ambiguous or has no usable unit, or time runs backward.
    """
    recordings = [open_recording(path, profile.source) for path in sources]
    found = _find_all(recordings, profile)
    pieces: dict[str, list[RecordedSamples]] = {name: [] for name in profile.channels}
    entries = []
    for recording in recordings:
        mine = {name: full for name, where in found.items() for path, full in where if path == recording.path}
        entry, samples = _read(recording, profile, mine)
        entries.append(entry)
        for name, piece in samples.items():
            pieces[name].append(piece)
    samples = {name: _joined(name, parts, profile) for name, parts in pieces.items() if parts}
    start = min(item.time[0] for item in samples.values())
    if profile.time.from_zero:
        samples = {name: RecordedSamples(item.time - start, item.values, item.record) for name, item in samples.items()}
    time, values = on_raster(samples, profile)
    record = {
        "schema": SCHEMA,
        "description": profile.description,
        "sources": entries,
        "time": {"from_zero": profile.time.from_zero, "start": float(start), "backward": profile.time.backward},
        "raster": {"rate": profile.raster.rate, "gap": profile.raster.gap, "samples": int(time.size)},
        "channels": {name: item.record for name, item in samples.items()},
        "missing": [name for name in profile.channels if name not in samples],
    }
    units = {"time": "s"} | {name: profile.channels[name].unit for name in values}
    return Ingested({"time": time} | values, units, record)


def _find_all(recordings: Sequence[ForeignRecording], profile: Profile) -> dict[str, list[tuple[Path, str]]]:
    """Return in which sources, and under which full name, each channel stands."""
    found: dict[str, list[tuple[Path, str]]] = {}
    for name, rules in profile.channels.items():
        found[name] = []
        for recording in recordings:
            try:
                full = find(recording.heads, rules.names)
            except ValueError as error:
                raise DataError(f"{recording.path}: channel '{name}': {error}") from None
            if full is not None:
                found[name].append((recording.path, full))
        if not found[name] and not rules.optional:
            hints = "; ".join(nearest(recording.heads, rules.names) for recording in recordings)
            raise DataError(
                f"{', '.join(str(recording.path) for recording in recordings)}: channel '{name}' is missing, expected "
                f"{' or '.join(repr(item) for item in rules.names)}; {hints}; mend the name in the profile or set optional = true"
            )
    if not any(found.values()):
        raise DataError(f"{recordings[0].path}: holds no channel of the profile; {nearest(recordings[0].heads, [])}")
    return found


def _read(
    recording: ForeignRecording, profile: Profile, wanted: Mapping[str, str]
) -> tuple[dict[str, Any], dict[str, RecordedSamples]]:
    """Return what to note about a source, and its samples of each channel."""
    from lpvobs.io.safety.unchanged import file_digest

    clocks = {name: _time_column(recording, profile, profile.channels[name]) for name in wanted}
    names = list(dict.fromkeys([*wanted.values(), *(full for full in clocks.values() if full)]))
    columns = recording.read(names)
    bases: dict[str, Base] = {}
    samples = {}
    for name, full in wanted.items():
        clock = clocks[name] or full
        if clock not in bases:
            bases[clock] = _base(recording, columns[clock], clock, bool(clocks[name]), profile)
        samples[name] = _samples(recording, full, columns[full], bases[clock], clock, name, profile)
    repairs = {clock: base.repairs for clock, base in bases.items() if base.repairs}
    entry = {
        "name": recording.path.name,
        "sha256": file_digest(recording.path),
        "notes": dict(recording.notes),
        "time_repairs": repairs,
    }
    return entry, samples


def _time_column(recording: ForeignRecording, profile: Profile, rules: ChannelRules) -> str | None:
    """Return the full name of the column that holds a channel's time, None where the format keeps it with the channel."""
    wanted = rules.time or profile.time.source
    if not wanted:
        return None
    try:
        full = find(recording.heads, [wanted])
    except ValueError as error:
        raise DataError(f"{recording.path}: time: {error}") from None
    if full is None:
        raise DataError(
            f"{recording.path}: time column '{wanted}' is missing; {nearest(recording.heads, [wanted])}; "
            f"mend source in the profile's [time]"
        )
    return full


def _base(recording: ForeignRecording, column: Column, name: str, is_clock: bool, profile: Profile) -> Base:
    """Return a time base in seconds with the rows that run forward."""
    path = recording.path
    if is_clock:
        unit = profile.time.unit or recording.heads[name].unit
        if not unit:
            raise DataError(f"{path}: time column '{name}' has no unit in the file; state unit in the profile's [time]")
        try:
            found = stamps(column.data, unit, profile.source.decimal)
        except ValueError as error:
            raise DataError(f"{path}: time column '{name}' {error}; mend unit in the profile's [time]") from None
        time, repairs = found.time, {"nights": found.nights, "unreadable": found.unreadable}
    elif column.time is not None:
        time, repairs = column.time, {}
    else:
        raise DataError(
            f"{path}: the format keeps no time with each channel; name its column: source in the profile's [time]"
        )
    finite = np.isfinite(time)
    if np.count_nonzero(finite) < 2:
        raise DataError(
            f"{path}: time '{name}' has {np.count_nonzero(finite)} readable stamps, expected at least two; check [time]"
        )
    keep = forward(time)
    wrong = int(np.count_nonzero(finite & ~keep))
    if wrong and profile.time.backward == "refuse":
        first = int(np.flatnonzero(finite & ~keep)[0])
        raise DataError(
            f"{path}: time '{name}' repeats or runs backward {wrong} times, first at {time[first]:.6g} s (row {first}); expected "
            f'strictly increasing; repair the file or set backward = "drop" in the profile\'s [time]'
        )
    if wrong > MOST_BACKWARD * time.size:
        raise DataError(
            f"{path}: time '{name}' repeats or runs backward at {wrong} of {time.size} samples, expected at most "
            f"{100 * MOST_BACKWARD:.0f} %; repair the file"
        )
    repairs |= {"backward": wrong, "empty": int(time.size - np.count_nonzero(finite)) - repairs.get("unreadable", 0)}
    return Base(time, keep, {key: count for key, count in repairs.items() if count})


def _samples(
    recording: ForeignRecording, full: str, column: Column, base: Base, clock: str, name: str, profile: Profile
) -> RecordedSamples:
    """Return one channel of one source, in the unit of the log, repaired as the profile says."""
    rules = profile.channels[name]
    path = recording.path
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
    keep = base.keep
    repairs: dict[str, Any] = {}
    if profile.source.polled:
        mine, late = _in_turn(recording, full, clock, numbers.values)
        keep = keep & mine
        repairs["out_of_turn"] = late
    raw = numbers.values[keep]
    values, unit, counts = _repaired(path, recording.heads[full].unit, raw, name, rules)
    repairs |= {"unreadable": numbers.unreadable, "example": numbers.example} | counts
    time = base.time[keep]
    record = {
        "file": path.name,
        "source": full,
        "unit_in_file": recording.heads[full].unit,
        "unit_read_as": unit,
        "unit": rules.unit,
        "meaning": rules.meaning,
        "samples": int(np.count_nonzero(np.isfinite(values))),
        "repairs": {key: count for key, count in repairs.items() if count},
    }
    return RecordedSamples(time, values, record)


def _in_turn(recording: ForeignRecording, full: str, clock: str, values: Array) -> tuple[NDArray[np.bool_], int]:
    """Return the rows in which a polled column is refreshed, and how often it changes in others.

    Row r refreshes column r modulo the number of columns besides time, in the order of the file.
    """
    turns = [name for name in recording.heads if name != clock]
    mine = np.arange(values.size) % len(turns) == turns.index(full)
    changed = np.flatnonzero((values[1:] != values[:-1]) & np.isfinite(values[:-1])) + 1
    late = int(np.count_nonzero(~mine[changed]))
    if late > 1 and late > TURNS_MISSED * changed.size:
        raise DataError(
            f"{recording.path}: '{full}' changes {late} of {changed.size} times in rows of other columns, expected one column per "
            f"row in turn; lines are missing, or leave out polled in the profile's [source]"
        )
    return mine, late


def _repaired(
    path: Path, file_unit: str, raw: Array, name: str, rules: ChannelRules
) -> tuple[Array, str, dict[str, Any]]:
    """Return values in the unit of the log, the unit that they were read in, and what was repaired."""
    unit = canonical(rules.source_unit or file_unit)
    if not unit:
        raise DataError(
            f"{path}: channel '{name}' has no unit in the file; state source_unit in the profile's [channels.{name}]"
        )
    counts: dict[str, Any] = {"empty": int(np.count_nonzero(~np.isfinite(raw)))}
    invalid = np.isin(raw, rules.invalid)
    counts["invalid"] = int(np.count_nonzero(invalid))
    try:
        values = convert(rules.scale * np.where(invalid, np.nan, raw) + rules.offset, unit, rules.unit)
    except ValueError as error:
        raise DataError(f"{path}: channel '{name}' has the {error}; mend unit or source_unit in the profile") from None
    outside = (values < rules.low) | (values > rules.high)
    counts["out_of_range"] = int(np.count_nonzero(outside))
    if (rules.scale, rules.offset) != (1.0, 0.0):
        counts["rescaled"] = f"{rules.scale:g} * recorded + {rules.offset:g} {unit}"
    if file_unit and rules.source_unit and canonical(file_unit) != unit:
        counts["unit"] = f"the file says {file_unit}, the profile {rules.source_unit}"
    elif is_broken(rules.source_unit or file_unit):
        counts["unit_spelling"] = f"{rules.source_unit or file_unit} read as {unit}"
    return np.where(outside | ~np.isfinite(values), np.nan, values), unit, counts


def _joined(name: str, parts: list[RecordedSamples], profile: Profile) -> RecordedSamples:
    """Return the parts of a channel one after the other."""
    if len(parts) == 1:
        return parts[0]
    time = np.concatenate([part.time for part in parts])
    keep = forward(time)
    wrong = int(np.count_nonzero(~keep))
    files = ", ".join(part.record["file"] for part in parts)
    if wrong and (profile.time.backward == "refuse" or wrong > MOST_BACKWARD * time.size):
        raise DataError(
            f"{files}: channel '{name}': the parts overlap in {wrong} samples, expected one after the other on one "
            f'clock; order them, or drop up to 10 % of the samples with backward = "drop" in the profile\'s [time]'
        )
    repairs: dict[str, Any] = {"overlap": wrong} if wrong else {}
    for part in parts:
        for key, value in part.record["repairs"].items():
            repairs[key] = repairs.get(key, 0) + value if isinstance(value, int) else value
    values = np.concatenate([part.values for part in parts])[keep]
    record = parts[0].record | {
        "file": files,
        "samples": int(np.count_nonzero(np.isfinite(values))),
        "repairs": repairs,
    }
    return RecordedSamples(time[keep], values, record)
