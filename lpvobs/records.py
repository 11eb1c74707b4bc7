"""The frozen log record: what every other room reads. No files here."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Item:
    """What a field of a record is, also for whoever reads it in a file: unit, meaning, and the axes of an array by name.

    `name` is what it is called in files where that is not the field's name; `gaps` says that values may be NaN or infinite;
    `meanings` are of small integers, and no other value is taken; `stored` is the type in files where it is not the field's,
    such as `f4` for drawings.
    """

    unit: str = "1"
    meaning: str = ""
    axes: tuple[str, ...] = ()
    name: str = ""
    gaps: bool = False
    meanings: Mapping[int, str] = field(default_factory=dict)
    stored: str = ""


class Additive:
    """Makes a record of sums, whose fields add up one by one."""

    def __add__(self, other: Self) -> Self:
        """Return the sums of both."""
        record: Any = self
        return type(self)(*(getattr(self, own.name) + getattr(other, own.name) for own in fields(record)))


@dataclass(frozen=True)
class DefectFound:
    """Samples of a channel that are numbers, but no readings."""

    kind: str  # `stuck`, `saturated` or `spike`
    channel: str
    samples: int
    first: float  # [s], time of the first of them
    policy: str  # what was done: `drop`


@dataclass(frozen=True)
class Defects:
    """What the reader found in a log and what the policies did about it."""

    samples_read: int  # rows in the file
    # rows dropped because this channel was not finite or not possible there (a row may count for several channels)
    dropped: Mapping[str, int] = field(default_factory=dict)
    dropped_rows: int = 0  # rows dropped altogether
    gaps: int = 0  # places where the time step exceeds the limit; each splits the log
    # rows removed because their time repeats or runs backward (only on request; otherwise the log is refused)
    repeated: int = 0
    findings: tuple[DefectFound, ...] = ()  # stuck, saturated and spiked samples, which were dropped as well


@dataclass(frozen=True)
class Piece:
    """Consecutive samples of a recorded drive."""

    time: Array  # (n,) [s], strictly increasing, later than any earlier piece
    channels: Mapping[str, Array]  # (n,) as in `Log`
    begins: NDArray[np.bool_]  # (n,) true where a segment begins; the first piece begins with one

    def first(self, n: int) -> "Piece":
        """Return the first n samples."""
        return Piece(self.time[:n], {name: column[:n] for name, column in self.channels.items()}, self.begins[:n])


class Recording(Protocol):
    """A drive to be gone through from beginning to end; how it is cut into pieces changes no bit of what comes of it."""

    @property
    def name(self) -> str:
        """Name of the log in results."""

    @property
    def sha256(self) -> str:
        """Digest of the file's bytes."""

    @property
    def defects(self) -> Defects:
        """What was found and done on reading; known once all pieces have been read."""

    def pieces(self) -> Iterator[Piece]:
        """Yield the samples in order."""


@dataclass(frozen=True)
class Log:
    """One recorded drive, in SI units (map axes in the units of the engine's record), without reference channels."""

    name: str  # stem of the file, the name of the log in results
    sha256: str  # of the file's bytes
    time: Array  # (N,) [s], strictly increasing
    channels: Mapping[str, Array]  # (N,) the channels that the engine's air path needs, finite everywhere
    # (N,) all other numeric channels as they are, NaN where the file has none; no estimator reads them
    auxiliary: Mapping[str, Array]
    # half-open ranges of samples without a gap; no state is carried from one to the next
    segments: tuple[tuple[int, int], ...]
    rows: NDArray[np.int64]  # (N,) row of the file behind each sample, so that references can be laid beside it
    defects: Defects  # what was found and done on reading
    units: Mapping[str, str] = field(default_factory=dict)  # of the auxiliary channels, where the file says them

    def __getitem__(self, channel: str) -> Array:
        """Return one needed channel, shape (N,)."""
        return self.channels[channel]

    def __len__(self) -> int:
        """Return the number of samples."""
        return self.time.size

    def pieces(self) -> Iterator[Piece]:
        """Yield the whole log as one piece."""
        begins = np.zeros(len(self), dtype=bool)
        begins[[start for start, _ in self.segments]] = True
        yield Piece(self.time, self.channels, begins)


def gathered(recording: Recording, pieces: Iterable[Piece] | None = None) -> Log:
    """Return a recording, or these pieces of it, as one log of the channels that an air path needs; rows are those it yields."""
    pieces = list(recording.pieces() if pieces is None else pieces)
    time = np.concatenate([piece.time for piece in pieces])
    starts = np.flatnonzero(np.concatenate([piece.begins for piece in pieces])).tolist()
    return Log(
        name=recording.name,
        sha256=recording.sha256,
        time=time,
        channels={name: np.concatenate([piece.channels[name] for piece in pieces]) for name in pieces[0].channels},
        auxiliary={},
        segments=tuple(zip(starts, [*starts[1:], time.size], strict=True)),
        rows=np.arange(time.size),
        defects=recording.defects,
    )
