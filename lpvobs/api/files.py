"""Names of files, and claims on them while they are written."""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

from lpvobs.errors import UsageError

File: TypeAlias = str | os.PathLike[str]
Progress: TypeAlias = Callable[[float], None]
LONGEST_NAME = 255
"""[bytes], of a file in its folder."""


def as_path(file: File) -> Path:
    """Return a name as a path; raises UsageError if no file can have it."""
    path = Path(file)
    if "\0" in str(path) or any(len(os.fsencode(part)) > LONGEST_NAME for part in path.parts):
        raise UsageError(
            f"{str(path)!r}: no file can have this name; expected at most {LONGEST_NAME} bytes, none of them 0"
        )
    return path


def as_paths(files: File | Iterable[File]) -> list[Path]:
    """Return one or several files as a list."""
    return [as_path(files)] if isinstance(files, (str, os.PathLike)) else [as_path(file) for file in files]


def some(files: File | Iterable[File], kind: str) -> list[Path]:
    """Return files of which at least one is needed."""
    paths = as_paths(files)
    if not paths:
        raise UsageError(f"no {kind}; name at least one")
    return paths


@contextmanager
def writing(out: Path, read: Iterable[Path]) -> Iterator[Path]:
    """Yield the file to write, which nobody else writes meanwhile; raise UsageError if it is one of those that are read."""
    from lpvobs.io.safety.atomic import is_same

    for path in read:
        if is_same(out, path):
            raise UsageError(f"{out}: is also an input and would be lost; name another file to write")
    with _claimed(out):
        yield out


@contextmanager
def changing(result: Path) -> Iterator[Path]:
    """Yield a result that nobody else writes meanwhile; what is no file is refused by whoever reads it."""
    if not result.is_file():
        yield result
        return
    with _claimed(result):
        yield result


@contextmanager
def _claimed(path: Path) -> Iterator[None]:
    from lpvobs.io.safety.atomic import claim, release

    claim(path)
    try:
        yield
    finally:
        release(path)


def silent(fraction: float) -> None:
    """Show no progress."""
