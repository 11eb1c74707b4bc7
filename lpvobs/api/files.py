"""Names of files, claims on them while they are written, and the logs among them that can be used."""

import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from lpvobs.errors import DataError, UsageError
from lpvobs.io.logs.finding import find_logs
from lpvobs.io.logs.parquet import log_digest
from lpvobs.io.safety.atomic import claimed, replacing

File: TypeAlias = str | os.PathLike[str]
Files: TypeAlias = File | Iterable[File]
Progress: TypeAlias = Callable[[float], None]
LONGEST_NAME = 255  # [bytes] Longest name of a file in its folder


def as_path(file: File) -> Path:
    """Return a name as a path; raises UsageError if no file can have it."""
    path = Path(file)
    if "\0" in str(path) or any(len(os.fsencode(part)) > LONGEST_NAME for part in path.parts):
        raise UsageError(
            f"{str(path)!r}: this is no valid file name; expected at most {LONGEST_NAME} bytes and no zero byte"
        )
    return path


def as_paths(files: Files) -> list[Path]:
    """Return one or several files as a list."""
    return [as_path(files)] if isinstance(files, (str, os.PathLike)) else [as_path(file) for file in files]


def some(files: Files, kind: str) -> list[Path]:
    """Return files of which at least one is needed."""
    paths = as_paths(files)
    if not paths:
        raise UsageError(f"no {kind} given; name at least one")
    return paths


def some_logs(logs: Files) -> list[Path]:
    """Return the logs that names, patterns and folders mean, of which at least one is needed."""
    return find_logs(some(logs, "log"))


def refuse_copies(paths: Sequence[Path]) -> None:
    """Raise for two logs of the same bytes, which would count twice; only files of the same size are looked into."""
    by_size: dict[int, list[Path]] = {}
    for path in paths:
        with suppress(OSError):
            by_size.setdefault(path.stat().st_size, []).append(path)
    for same in by_size.values():
        seen: dict[str, Path] = {}
        for path in [path for path in same if len(same) > 1 and path.is_file()]:
            with suppress(OSError):  # whoever reads it tells why it cannot be
                if (digest := log_digest(path)) in seen:
                    raise UsageError(
                        f"{path}: same content as {seen[digest]}; this drive would count twice, so leave one file out"
                    )
                seen[digest] = path


def expect_one_of(option: str, value: str, known: Collection[str]) -> None:
    """Raise UsageError for a value that an option does not have."""
    if value not in known:
        raise UsageError(f"{option} {value}: expected one of {', '.join(known)}")


@contextmanager
def writing(out: File, read: Iterable[File | None]) -> Iterator[Path]:
    """Yield the file to write, which nobody else writes meanwhile; raise UsageError if it is one of those that are read."""
    path = as_path(out)
    for file in (as_path(each) for each in read if each is not None):
        with suppress(OSError, ValueError):  # what is not there is no file
            if path.samefile(file):  # by whatever links
                raise UsageError(
                    f"{path}: this file is also an input and would be overwritten; name another file to write"
                )
    with claimed(path):
        yield path


def write_text(out: File, text: str, read: Iterable[File | None] = (), encoding: str = "utf-8") -> None:
    """Write a text file as a whole, `?` for what the encoding does not have; raises as `writing` does."""
    with writing(out, read) as target, replacing(target) as temporary:
        temporary.write_text(text, encoding=encoding, errors="replace", newline="")


@contextmanager
def updating(result: File) -> Iterator[Path]:
    """Yield a result that nobody else writes meanwhile; what is no file is refused by whoever reads it."""
    path = as_path(result)
    with claimed(path) if path.is_file() else nullcontext():
        yield path


def shown(progress: Progress | None) -> Progress:
    """Return where progress goes: to the caller's function, else to a bar where a notebook runs, which goes when all is done."""
    notebook: Any = sys.modules.get("IPython")
    if progress or notebook is None or getattr(notebook.get_ipython(), "kernel", None) is None:
        return progress or (lambda _: None)
    html, last = notebook.display.HTML, -1
    handle = notebook.display.display(html(""), display_id=True)

    def show(fraction: float) -> None:
        nonlocal last
        before, last = last, round(100.0 * fraction)
        if last != before:  # each is a message to the browser
            bar = f"<progress max='100' value='{last}'></progress> {last} %"
            handle.update(html(bar if last < 100 else ""))

    return show


def within(progress: Progress, begin: float, end: float) -> Progress:
    """Return progress of a part of the work, which goes from `begin` to `end` of the whole."""
    return lambda done: progress(begin + (end - begin) * done)


Found = TypeVar("Found")


def usable(
    paths: Sequence[Path], read: Callable[[Path], Found], one: bool = True
) -> tuple[dict[Path, Found], tuple[str, ...]]:
    """Return what is read of the logs that can be used, and why the others cannot.

    Raises DataError if there are logs, none can be used, and at least one has to be.
    """
    logs: dict[Path, Found] = {}
    refused: list[str] = []
    for path in paths:
        try:
            logs[path] = read(path)
        except DataError as error:
            refused.append(str(error))
    if one and paths and not logs:
        raise DataError("; ".join(refused))
    return logs, tuple(refused)
