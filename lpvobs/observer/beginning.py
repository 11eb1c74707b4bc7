"""The beginning of a log, which shows where its engine is linearised."""

from collections.abc import Iterator

import numpy as np

from lpvobs.records import Defects, Piece, Recording


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
