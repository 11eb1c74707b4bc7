"""What becomes of the rows of a log: which can be used, and what was found in the others."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.channels import Channel
from lpvobs.errors import DataError
from lpvobs.io.logs.plausibility import refuse_odd_rate, spoiled
from lpvobs.records import Array, DefectFound, Defects

MOST_BACKWARD = 0.1
"""Share of the samples that may be dropped for their time; more is not a repair."""


@dataclass(frozen=True)
class LogPolicies:
    """What to do with defects; the configuration's `[policies]`.

    Attributes
    ----------
    gap_limit : float
        [s]; a longer step between samples splits the log into segments.
    backward_time : str
        `refuse` the log, or `drop` the samples whose time is not later than every earlier one.
    """

    gap_limit: float = 1.0
    backward_time: str = "refuse"

    def __post_init__(self) -> None:
        if not self.gap_limit > 0:
            raise ValueError("gap_limit must be positive")
        if self.backward_time not in ("refuse", "drop"):
            raise ValueError("backward_time must be 'refuse' or 'drop'")


@dataclass(frozen=True)
class UsableRows:
    """What is left of the rows of a log or of a stretch of it, and what was taken away.

    Attributes
    ----------
    rows : ndarray of int, shape (n,)
    read, dropped_rows, repeated, dropped, findings
        As in `lpvobs.records.Defects`; dropped names every channel.
    """

    rows: NDArray[np.int64]
    read: int
    dropped: Mapping[str, int]
    dropped_rows: int
    repeated: int
    findings: tuple[DefectFound, ...]


def usable_rows(
    path: Path,
    time: Array,
    values: Mapping[str, Array],
    channels: Mapping[str, Channel],
    policies: LogPolicies,
    latest: float = -math.inf,
) -> UsableRows:
    """Return the rows that are finite, possible, later than each other and than `latest`, and neither stuck nor spiked.

    Raises
    ------
    DataError
        For time that runs backward, where the policies do not drop it, and for an odd rate.
    """
    keep, dropped = _usable(time, values, channels)
    rows, repeated = _increasing(path, time, np.flatnonzero(keep), policies, latest)
    refuse_odd_rate(path, time[rows], policies.gap_limit)
    findings = []
    for finding, samples in list(spoiled(time[rows], {name: values[name][rows] for name in values}, channels)):
        findings.append(finding)
        dropped[finding.channel] += samples.size
        keep[rows[samples]] = False
    lost = int(keep.size - np.count_nonzero(keep))
    return UsableRows(rows[keep[rows]], time.size, dropped, lost, repeated, tuple(findings))


def _usable(
    time: Array, values: Mapping[str, Array], channels: Mapping[str, Channel]
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """Return which rows are finite and physically possible in every channel, and how often each channel is not."""
    keep = np.isfinite(time)
    dropped = {"time": int(np.count_nonzero(~keep))}
    for name, column in values.items():
        possible = (column >= channels[name].low) & (column <= channels[name].high)  # False for NaN
        dropped[name] = int(np.count_nonzero(~possible))
        keep &= possible
    return keep, dropped


def _increasing(
    path: Path, time: Array, rows: NDArray[np.int64], policies: LogPolicies, latest: float = float("-inf")
) -> tuple[NDArray[np.int64], int]:
    """Return the rows whose time is later than every earlier one and `latest`, and how many were removed for it."""
    kept = time[rows]
    if kept.size == 0:
        return rows, 0
    before = np.maximum.accumulate(np.concatenate(([latest], kept)))[:-1]
    later = kept > before
    wrong = int(np.count_nonzero(~later))
    if wrong and policies.backward_time == "refuse":
        first = int(np.flatnonzero(~later)[0])
        raise DataError(
            f"{path}: channel 'time' repeats or runs backward {wrong} times, first at {kept[first]:.6g} s after "
            f"{before[first]:.6g} s (row {rows[first]}); expected strictly increasing; "
            f'repair the log or set backward_time = "drop" in [policies]'
        )
    if wrong > MOST_BACKWARD * kept.size:
        raise DataError(
            f"{path}: channel 'time' repeats or runs backward at {wrong} of {kept.size} samples, expected at most "
            f"{100 * MOST_BACKWARD:.0f} %; one stamp far in the future does that: repair the log"
        )
    return rows[later], wrong


def too_few(
    path: Path, usable: int, read: int, dropped: Mapping[str, int], findings: Sequence[DefectFound] = ()
) -> DataError:
    """Return what is wrong with a log of which next to nothing is left."""
    worst = max(dropped, key=lambda name: dropped[name], default="time")
    kinds = sorted({finding.kind for finding in findings if finding.channel == worst})
    why = f" ({', '.join(kinds)})" if kinds else ""
    return DataError(
        f"{path}: {usable} of {read} samples are usable, expected at least two; "
        f"channel '{worst}' spoils the most{why}, see `lpvobs inspect`"
    )


class SlabCounts:
    """What has been found in the slabs so far."""

    def __init__(self) -> None:
        self.read, self.samples, self.dropped_rows, self.gaps, self.repeated = 0, 0, 0, 0, 0
        self.latest = float("-inf")
        self.dropped: dict[str, int] = {}
        self.found: dict[tuple[str, str], DefectFound] = {}
        self.refusals: list[DataError] = []

    def add(self, usable: UsableRows) -> None:
        """Add what a slab lost; findings of a kind and channel are counted together."""
        self.read += usable.read
        self.dropped_rows += usable.dropped_rows
        self.repeated += usable.repeated
        for name, lost in usable.dropped.items():
            self.dropped[name] = self.dropped.get(name, 0) + lost
        for item in usable.findings:
            known = self.found.get((item.kind, item.channel))
            self.found[item.kind, item.channel] = (
                item if known is None else replace(known, samples=known.samples + item.samples)
            )

    def leave_out(self, rows: int, refusal: DataError) -> None:
        """Add a slab that was refused."""
        self.read += rows
        self.dropped_rows += rows
        self.refusals.append(refusal)

    @property
    def findings(self) -> tuple[DefectFound, ...]:
        """What is stuck, saturated or spiked."""
        return tuple(self.found.values())

    def defects(self) -> Defects:
        """Return it as the record that results keep."""
        dropped = {name: lost for name, lost in self.dropped.items() if lost}
        return Defects(self.read, dropped, self.dropped_rows, self.gaps, self.repeated, self.findings)
