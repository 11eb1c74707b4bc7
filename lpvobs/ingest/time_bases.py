"""The time bases of a source: its clock columns, or the stamps that its format keeps with each channel."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.ingest.clocks import MOST_BACKWARD, forward, stamps
from lpvobs.ingest.profiles import ChannelRules, Profile
from lpvobs.ingest.recordings import Column, ForeignRecording, find, nearest
from lpvobs.records import Array


@dataclass(frozen=True)
class TimeBase:
    """Stamps [s], shape (N,), which rows of them are used, and what was repaired."""

    time: Array
    keep: NDArray[np.bool_]
    repairs: Mapping[str, int]


def time_column(recording: ForeignRecording, profile: Profile, rules: ChannelRules) -> str | None:
    """Return the full name of the column that holds a channel's time, None where the format keeps it with the channel."""
    wanted = rules.time or profile.time.source
    if not wanted:
        return None
    full = find(recording, [wanted], "time")
    if full is None:
        raise DataError(
            f"{recording.path}: time column '{wanted}' is missing; {nearest(recording.heads, [wanted])}; "
            f"mend source in the profile's [time]"
        )
    return full


def time_base(recording: ForeignRecording, column: Column, name: str, is_clock: bool, profile: Profile) -> TimeBase:
    """Return a time base in seconds with the rows that run forward."""
    path = recording.path
    time, repairs = _seconds(recording, column, name, profile) if is_clock else (column.time, {})
    if time is None:
        raise DataError(
            f"{path}: the format keeps no time with each channel; name its column: source in the profile's [time]"
        )
    finite = np.isfinite(time)
    stamped = int(np.count_nonzero(finite))
    if stamped < 2:
        raise DataError(f"{path}: time '{name}' has {stamped} readable stamps, expected at least two; check [time]")
    keep = forward(time)
    backward = np.flatnonzero(finite & ~keep)
    if backward.size and profile.time.backward == "refuse":
        raise DataError(
            f"{path}: time '{name}' repeats or runs backward {backward.size} times, first at {time[backward[0]]:.6g} s (row "
            f'{backward[0]}); expected strictly increasing; repair the file or set backward = "drop" in the profile\'s [time]'
        )
    if backward.size > MOST_BACKWARD * time.size:
        raise DataError(
            f"{path}: time '{name}' repeats or runs backward at {backward.size} of {time.size} samples, expected at most "
            f"{100 * MOST_BACKWARD:.0f} %; repair the file"
        )
    repairs |= {"backward": backward.size, "empty": time.size - stamped - repairs.get("unreadable", 0)}
    return TimeBase(time, keep, {key: count for key, count in repairs.items() if count})


def _seconds(recording: ForeignRecording, column: Column, name: str, profile: Profile) -> tuple[Array, dict[str, int]]:
    """Return a clock column in seconds, and what in it was repaired."""
    unit = profile.time.unit or recording.heads[name].unit
    if not unit:
        raise DataError(
            f"{recording.path}: time column '{name}' has no unit in the file; state unit in the profile's [time]"
        )
    try:
        found = stamps(column.data, unit, profile.source.decimal)
    except ValueError as error:
        raise DataError(f"{recording.path}: time column '{name}' {error}; mend unit in the profile's [time]") from None
    return found.time, {"nights": found.nights, "unreadable": found.unreadable}
