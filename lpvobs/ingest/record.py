"""What `ingest` did to make a log: stored with the log as JSON, and read back by `inspect`."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from lpvobs.io.arrow import pa, pq

SCHEMA = "lpvobs/ingest/1"
KEY = "lpvobs.ingest"


@dataclass(frozen=True)
class SourceDone:
    """A file: what had to be mended to read it, and how many stamps of each time column were repaired."""

    name: str
    sha256: str
    notes: Mapping[str, str]
    time_repairs: Mapping[str, Mapping[str, int]]


@dataclass(frozen=True)
class TimeDone:
    """Where the log starts in the time of the sources [s], and what was done with stamps that run backward."""

    from_zero: bool
    start: float
    backward: str


@dataclass(frozen=True)
class RasterDone:
    """Rate of the log [Hz], 0 for as recorded; the gap [s] in which it has no samples; their number."""

    rate: float
    gap: float
    samples: int


@dataclass(frozen=True)
class ChannelDone:
    """A channel as it was recorded, and by which rule it came to the raster.

    `source` is its full name in the file, `samples` and `rate` [Hz] are those recorded, `limit` [s] is how long one was held or a
    pair bridged, `bridged` and `without_value` are samples of the log.
    """

    file: str
    source: str
    unit_in_file: str
    unit_read_as: str
    unit: str
    meaning: str
    samples: int
    repairs: Mapping[str, int | str]  # what was repaired: in how many samples, or how
    rate: float | None = None
    rule: str = ""
    rule_from: str = ""
    limit: float = 0.0
    bridged: int = 0
    without_value: int = 0


@dataclass(frozen=True)
class ProfileDone:
    """The profile that it was done by."""

    name: str
    sha256: str
    text: str = ""


@dataclass(frozen=True)
class IngestRecord:
    """What was done to make a log; `missing` are the optional channels that no source has."""

    schema: str
    description: str
    sources: list[SourceDone]
    time: TimeDone
    raster: RasterDone
    channels: Mapping[str, ChannelDone]
    missing: list[str]
    profile: ProfileDone


@dataclass(frozen=True)
class IngestOutput(IngestRecord):
    """What was done to make a log of a recording."""

    log: str


def stored_record(path: Path) -> dict[str, Any] | None:
    """Return what `ingest` did to make a log as plain data, None for a log that it did not make; files come from strangers."""
    try:
        record = json.loads((pq.read_schema(path).metadata or {}).get(KEY.encode(), b"null"))
        found = msgspec.convert(record, IngestRecord)
    except (pa.ArrowException, OSError, ValueError, RecursionError, msgspec.ValidationError):
        return None
    return msgspec.to_builtins(found) if found.schema == SCHEMA else None
