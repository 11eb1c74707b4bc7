"""The frozen log record: what every other room reads. No files here."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

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


@dataclass(frozen=True)
class DefectFound:
    """Samples of a channel that are numbers, but no readings.

    Attributes
    ----------
    kind : str
        `stuck`, `saturated` or `spike`.
    first : float
        [s], time of the first of them.
    policy : str
        What was done: `drop`.
    """

    kind: str
    channel: str
    samples: int
    first: float
    policy: str


@dataclass(frozen=True)
class Defects:
    """What the reader found in a log and what the policies did about it.

    Attributes
    ----------
    samples_read : int
        Rows in the file.
    dropped : Mapping[str, int]
        Rows dropped because this channel was not finite or not possible there (a row may count for several channels).
    dropped_rows : int
        Rows dropped altogether.
    gaps : int
        Places where the time step exceeds the limit; each splits the log.
    repeated : int
        Rows removed because their time repeats or runs backward (only on request; otherwise the log is refused).
    findings : tuple of DefectFound
        Stuck, saturated and spiked samples, which were dropped as well.
    """

    samples_read: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    dropped_rows: int = 0
    gaps: int = 0
    repeated: int = 0
    findings: tuple[DefectFound, ...] = ()


@dataclass(frozen=True)
class Piece:
    """Consecutive samples of a recorded drive.

    Attributes
    ----------
    time : ndarray, shape (n,)
        [s], strictly increasing, later than any earlier piece.
    channels : Mapping[str, ndarray of shape (n,)]
        As in `Log`.
    begins : ndarray of bool, shape (n,)
        True where a segment begins; the first piece begins with one.
    """

    time: Array
    channels: Mapping[str, Array]
    begins: NDArray[np.bool_]


class Recording(Protocol):
    """A drive that can be gone through once from beginning to end, in memory or piece by piece.

    How it is cut into pieces changes no bit of what is computed from it.
    """

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
    """One recorded drive, in SI units (map axes in the units of the engine's record), without reference channels.

    Attributes
    ----------
    name : str
        Stem of the file, the name of the log in results.
    sha256 : str
        Of the file's bytes.
    time : ndarray, shape (N,)
        [s], strictly increasing.
    channels : Mapping[str, ndarray of shape (N,)]
        The channels that the engine's air path needs, finite everywhere.
    auxiliary : Mapping[str, ndarray of shape (N,)]
        All other numeric channels, as they are: NaN where the file has none. No estimator reads them.
    segments : tuple of (start, stop)
        Half-open ranges of samples without a gap; no state is carried from one to the next.
    rows : ndarray of int, shape (N,)
        Row of the file behind each sample, so that references can be laid beside it.
    defects : Defects
        What was found and done on reading.
    """

    name: str
    sha256: str
    time: Array
    channels: Mapping[str, Array]
    auxiliary: Mapping[str, Array]
    segments: tuple[tuple[int, int], ...]
    rows: NDArray[np.int64]
    defects: Defects

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

    def each_segment(self) -> Iterator[slice]:
        """Yield the segments as slices."""
        for start, stop in self.segments:
            yield slice(start, stop)
