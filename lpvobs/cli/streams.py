"""stdout and stderr of a program that nobody watches: closed, on a full disk, or with a reader that has left."""

import io
import os
import sys
from typing import TextIO

STDOUT, STDERR = 1, 2


class Outlet(io.TextIOWrapper):
    """A stream that never fails: what cannot be written is dropped, so that the verb still ends what it has begun.

    It writes to an open descriptor, in the place of the stream `before`. `lost` says why something was dropped; it is None also
    where the reader has left, as `head` does: it wants no more.
    """

    def __init__(self, handle: int, before: TextIO | None):
        os.set_blocking(handle, True)  # a reader that lets nobody wait would get pieces
        super().__init__(
            io.BufferedWriter(io.FileIO(handle, "w", closefd=False)),
            encoding=getattr(before, "encoding", None) or "utf-8",
            errors="backslashreplace",
            line_buffering=handle == STDERR or os.isatty(handle),
        )
        self.lost: OSError | None = None

    def write(self, text: str, /) -> int:
        """Return the number of letters taken: all."""
        try:
            super().write(text)
        except OSError as error:
            self._drop(error)
        return len(text)

    def flush(self) -> None:
        """Write what waits, or drop it."""
        try:
            super().flush()
        except OSError as error:
            self._drop(error)

    def _drop(self, error: OSError) -> None:
        """Turn the descriptor to where all that waits and follows can go."""
        if not isinstance(error, BrokenPipeError):
            self.lost = error
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)
        super().flush()


def take_streams() -> Outlet:
    """Let `print` never fail, with any letter and into any stream; return where stdout goes."""
    opened = os.open(os.devnull, os.O_RDWR)
    while opened <= STDERR:  # a closed descriptor would be given to the next file, and messages written into that
        opened = os.dup(opened)
    os.close(opened)
    for before in (sys.stdout, sys.stderr):
        if before is not None:
            before.flush()
    out = Outlet(STDOUT, sys.stdout)
    sys.stdout, sys.stderr = out, Outlet(STDERR, sys.stderr)
    return out
