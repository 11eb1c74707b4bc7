"""Whether a file is still the one that was looked at: its digest, and what changes when somebody writes to it."""

import hashlib
from pathlib import Path

from lpvobs.errors import DataError


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def state_of(path: Path) -> tuple[int, ...]:
    """Return what changes when somebody writes to a file."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return (found.st_ino, found.st_size, found.st_mtime_ns)


def refuse_changed(path: Path, before: tuple[int, ...]) -> None:
    """Raise DataError if somebody has written to a file since its state was `before`."""
    if state_of(path) != before:
        raise DataError(
            f"{path}: changed while it was read; expected a finished file; wait for the recorder and try again"
        )
