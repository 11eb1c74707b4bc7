"""What to do with the defects of a log, and the account of what was found."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.channels import Channel
from lpvobs.errors import DataError
from lpvobs.records import DefectFound, Defects


@dataclass(frozen=True)
class ChannelLimits:
    """Where a working sensor of one engine reads, in the channel's unit; None leaves what holds for the kind of engine.

    Attributes
    ----------
    low, high : float
        A sample outside is a defect.
    typical : tuple of float
        Range in which the median of a whole log lies.
    """

    low: float | None = None
    high: float | None = None
    typical: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for low, high in ((self.low, self.high), self.typical or (None, None)):
            if low is not None and high is not None and not low < high:
                raise ValueError(f"a lower limit of {low:g} must be below the upper one, {high:g}")


@dataclass(frozen=True)
class LogPolicies:
    """What to do with defects; the configuration's `[policies]`.

    Attributes
    ----------
    gap_limit : float
        [s]; a longer step between samples splits the log into segments.
    backward_time : str
        `refuse` the log, or `drop` the samples whose time is not later than every earlier one.
    limits : mapping of str to ChannelLimits
        Of channels of which the configured engine's sensors read elsewhere than those of most of its kind.
    """

    gap_limit: float = 1.0
    backward_time: str = "refuse"
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

    def too_few(self, path: Path) -> DataError:
        """Return what is wrong with a log of which next to nothing is left."""
        worst = max(self.dropped, key=lambda name: self.dropped[name], default="time")
        kinds = sorted({finding.kind for finding in self.findings if finding.channel == worst})
        why = f" ({', '.join(kinds)})" if kinds else ""
        return DataError(
            f"{path}: {self.samples} of {self.read} samples are usable, expected at least two; "
            f"channel '{worst}' spoils the most{why}, see `lpvobs inspect`"
        )
