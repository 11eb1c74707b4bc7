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


NOTHING = np.empty(0)


class RangeSeen:
    """Samples, time and range of the scheduling parameters so far."""

    def __init__(self, parameters: int, region: Region | None):
        self.samples, self.duration, self.flow, self.inside, self.started = 0, 0.0, 0.0, 0, float("nan")
        self.lower, self.upper = np.full(parameters, np.inf), np.full(parameters, -np.inf)
        self.region = region

    def see(self, parameters: Array, time: Array = NOTHING, steps: Array = NOTHING, reading: Array = NOTHING) -> None:
        """Take in N samples: scheduling parameters, shape (N, m), and where they count clock, steps [s] and readings [kg/s]."""
        if not self.samples and time.size:
            self.started = float(time[0])
        self.samples += len(parameters)
        self.duration, self.flow = running_sum(self.duration, steps), running_sum(self.flow, reading)
        np.minimum(self.lower, parameters.min(axis=0), out=self.lower)
        np.maximum(self.upper, parameters.max(axis=0), out=self.upper)
        if self.region is not None:
            self.inside += int(np.count_nonzero(self.region.contains(parameters)))

    def run(self, log: Recording) -> LogRun:
        """Return what is kept of the log that has been gone through."""
        share = float("nan") if self.region is None else self.inside / self.samples
        seen = self.samples, self.duration, log.defects, self.lower, self.upper
        return LogRun(log.name, log.sha256, *seen, share, self.flow / self.samples)


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
                if kept:
                    yield piece.first(kept)
                return
            yield piece
