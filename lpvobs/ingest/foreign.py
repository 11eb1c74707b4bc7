"""Foreign recordings, of whatever format, to a log: names, units, stamps and raster, with every repair counted."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpvobs.errors import DataError
from lpvobs.ingest import profiles, resample
from lpvobs.ingest.formats import open_recording
from lpvobs.ingest.record import SCHEMA, ChannelDone, IngestRecord, ProfileDone, RasterDone, TimeDone
from lpvobs.ingest.recordings import ForeignRecording, find, nearest
from lpvobs.ingest.repairs import MOST_BACKWARD, RecordedSamples, Source, forward
from lpvobs.records import Array

NAMELESS = ProfileDone("", "")


@dataclass(frozen=True)
class Ingested:
    """A log that is not yet written."""

    channels: Mapping[str, Array]  # (M,) `time` first
    units: Mapping[str, str]
    record: Mapping[str, Any]  # an `IngestRecord` as plain data; stored with the log


@np.errstate(over="ignore", invalid="ignore")  # what overflows is no value
def ingest(sources: Sequence[Path], profile: profiles.Profile, by: ProfileDone = NAMELESS) -> Ingested:
    """Return the log in foreign files of one drive and one clock: different channels, consecutive parts, or both.

    Raises DataError if a file cannot be read, a channel is missing, ambiguous or has no usable unit, or time runs backward.
    """
    opened = [open_recording(path, profile.source) for path in sources]
    read = [Source(each, profile, names) for each, names in zip(opened, _find_all(opened, profile), strict=True)]
    parts = {name: [source.samples[name] for source in read if name in source.samples] for name in profile.channels}
    samples = {name: _joined(name, each, profile) for name, each in parts.items() if each}
    start = float(min(item.time[0] for item in samples.values()))
    if profile.time.from_zero:
        samples = {name: replace(item, time=item.time - start) for name, item in samples.items()}
    time, values, channels = resample.on_raster(samples, profile)
    units = {"time": "s"} | {name: profile.channels[name].unit for name in values}
    for name, item in profile.computed.items():
        absent = (other for other in profile.channels if other not in values)
        if lacking := [other for other in absent if re.search(rf"\b{re.escape(other)}\b", item.formula)]:
            raise DataError(
                f"computed channel '{name}' needs '{lacking[0]}', which no source has; leave the computed channel out, "
                "or add the source"
            )
        values[name], units[name] = item.values(values), (unit := item.unit)
        count = int(np.count_nonzero(np.isfinite(values[name])))
        said = f"{name} = {item.formula}" + "".join(f", {key} = {text}" for key, text in item.constants.items())
        channels[name] = ChannelDone("", said, unit, unit, unit, item.meaning, count, {}, rule="computed")
    record = IngestRecord(
        schema=SCHEMA,
        description=profile.description,
        sources=[source.done for source in read],
        time=TimeDone(profile.time.from_zero, start, profile.time.backward),
        raster=RasterDone(profile.raster.rate, profile.raster.gap, time.size),
        channels=channels,
        missing=[name for name in profile.channels if name not in samples],
        profile=by,
    )
    return Ingested({"time": time} | values, units, asdict(record))


def _find_all(sources: Sequence[ForeignRecording], profile: profiles.Profile) -> list[dict[str, str]]:
    """Return for each source under which full names it has which channels; raises for a column that two are read from."""
    found: list[dict[str, str]] = [{} for _ in sources]
    for name, rules in profile.channels.items():
        for recording, names in zip(sources, found, strict=True):
            if (full := find(recording, rules.names, f"channel '{name}'")) is not None:
                names[name] = full
        if not rules.optional and not any(name in names for names in found):
            hints = "; ".join(nearest(recording.heads, rules.names) for recording in sources)
            raise DataError(
                f"{', '.join(str(recording.path) for recording in sources)}: channel '{name}' is missing, expected a column "
                f"{' or '.join(repr(item) for item in rules.names)}; {hints}; correct the name in the profile or set "
                "optional = true"
            )
    for recording, names in zip(sources, found, strict=True):
        by_column: dict[str, str] = {}
        for name, full in names.items():
            if (other := by_column.setdefault(full, name)) != name:
                raise DataError(
                    f"{recording.path}: column '{full}' is used twice, for channel '{other}' and for '{name}', expected once; "
                    "take one channel out of the profile, or compute it from the other one in [computed]"
                )
    if not any(found):
        raise DataError(
            f"{sources[0].path}: has no channel of the profile; {nearest(sources[0].heads, [])}; correct the names in the profile"
        )
    return found


def _joined(name: str, parts: Sequence[RecordedSamples], profile: profiles.Profile) -> RecordedSamples:
    if len(parts) == 1:
        return parts[0]
    time = np.concatenate([part.time for part in parts])
    keep = forward(time)
    wrong = int(np.count_nonzero(~keep))
    files = ", ".join(part.done.file for part in parts)
    if wrong and (profile.time.backward == "refuse" or wrong > MOST_BACKWARD * time.size):
        raise DataError(
            f"{files}: channel '{name}': the parts overlap in {wrong} samples; name the parts in order of time, "
            f'or drop up to 10 % of the samples with backward = "drop" in the profile\'s [time]'
        )
    repairs: dict[str, Any] = {"overlap": wrong} if wrong else {}
    for part in parts:
        for key, value in part.done.repairs.items():
            repairs[key] = repairs.get(key, 0) + value if isinstance(value, int) else value
    values = np.concatenate([part.values for part in parts])[keep]
    count = int(np.count_nonzero(np.isfinite(values)))
    return RecordedSamples(time[keep], values, replace(parts[0].done, file=files, samples=count, repairs=repairs))
