"""What an estimate keeps of a log, gathered while somebody goes through it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lpvobs.errors import DataError
from lpvobs.records import Array, Defects, Piece, Recording
from lpvobs.synthesis.region import Region


@dataclass(frozen=True)
class LogRun:
    """What an estimate keeps of a log."""

    name: str
    sha256: str
    samples: int
    duration: float  # [s], without gaps
    defects: Defects
    lower: Array  # (m,) range of the scheduling parameters along the log
    upper: Array  # (m,)
    share_certified: float  # share of the samples inside the region of the gain's certificate; NaN without one
    mean_flow: float = float("nan")  # [kg/s] of the sensor's readings


def nothing_between(name: str, started: float) -> DataError:
    """Return what is wrong with a log whose samples are all apart."""
    return DataError(
        f"log '{name}': every sample is followed by a gap, the first one at {started:.6g} s; expected samples closer together "
        f"than gap_limit in [policies]"
    )


class RangeSeen:
    """Samples, time and range of the scheduling parameters so far."""

    def __init__(self, parameters: int, region: Region | None, sensor: str = ""):
        self.samples, self.duration, self.inside, self.scheduled = 0, 0.0, 0, 0
        self.started, self.last = float("nan"), float("nan")
        self.lower, self.upper = np.full(parameters, np.inf), np.full(parameters, -np.inf)
        self.region, self.sensor, self.flow = region, sensor, 0.0

    def time(self, piece: Piece) -> None:
        """Take in the clock of N samples, and what the sensor read."""
        if not self.samples:
            self.started = self.last = float(piece.time[0])
        steps = np.diff(piece.time, prepend=self.last)
        steps[piece.begins] = 0.0
        self.samples, self.last = self.samples + piece.time.size, float(piece.time[-1])
        self.duration = running_sum(self.duration, steps)
        if self.sensor:
            self.flow = running_sum(self.flow, piece.channels[self.sensor])

    def see(self, parameters: Array) -> None:
        """Take in the scheduling parameters of N samples, shape (N, m)."""
        self.scheduled += parameters.shape[0]
        np.minimum(self.lower, parameters.min(axis=0), out=self.lower)
        np.maximum(self.upper, parameters.max(axis=0), out=self.upper)
        if self.region is not None:
            self.inside += int(np.count_nonzero(self.region.contains(parameters)))

    def run(self, log: Recording) -> LogRun:
        """Return what is kept of the log that has been gone through."""
        share = float("nan") if self.region is None else self.inside / self.scheduled
        flow = self.flow / self.samples if self.sensor else float("nan")
        seen = self.samples, self.duration, log.defects, self.lower, self.upper
        return LogRun(log.name, log.sha256, *seen, share, flow)


def running_sum(start: float, values: Array) -> float:
    """Return start plus the values, added one after the other, so that it does not matter how they come in pieces."""
    return float(np.add.accumulate(np.concatenate(([start], values)))[-1])


class Beginning:
    """The first seconds of a recording."""

    def __init__(self, recording: Recording, seconds: float):
        self.recording, self.seconds, self.goes_on = recording, seconds, False
        self.name, self.sha256 = recording.name, recording.sha256

    @property
    def defects(self) -> Defects:
        """What was found and done on reading."""
        return self.recording.defects

    def pieces(self) -> Iterator[Piece]:
        """Yield the samples in order."""
        until = np.inf
        for piece in self.recording.pieces():
            until = min(until, piece.time[0] + self.seconds)
            kept = int(np.searchsorted(piece.time, until))
            if kept < piece.time.size:
                self.goes_on = True
                channels = {name: column[:kept] for name, column in piece.channels.items()}
                if kept:
                    yield Piece(piece.time[:kept], channels, piece.begins[:kept])
                return
            yield piece
