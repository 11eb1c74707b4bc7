"""Time columns as seconds: units of time, times of day as text, dates, nights that pass, stamps that run backward."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lpvobs.ingest.recordings import as_numbers
from lpvobs.io.logs.units import convert
from lpvobs.records import Array

if TYPE_CHECKING:
    import pyarrow as pa

DAY = 86400.0
SLAB = 1 << 16
MOST_BACKWARD = 0.1
"""Share of the stamps that may be dropped for running backward; more is not a repair."""


@dataclass(frozen=True)
class Stamps:
    """A time base.

    Attributes
    ----------
    time : ndarray, shape (N,)
        [s], NaN where the file has no time.
    unreadable : int
        Entries that are no time.
    nights : int
        Midnights that the time of day has passed.
    """

    time: Array
    unreadable: int = 0
    nights: int = 0


def stamps(data: "pa.Array | pa.ChunkedArray", unit: str, decimal: str = ".") -> Stamps:
    """Return a time column as seconds.

    Raises ValueError if the unit is none of time, or the column holds something else.

    Parameters
    ----------
    unit : str
        A unit of time, `clock` for h:mm:ss.sss, or `datetime` for ISO 8601 text or Arrow time stamps.
    decimal : str
        Of text.
    """
    import pyarrow as pa

    if unit in ("clock", "datetime"):
        if pa.types.is_integer(data.type) or pa.types.is_floating(data.type):
            raise ValueError(f"holds {data.type}, expected text or time stamps as its unit '{unit}' says")
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
