"""What every verb shares: errors as one line and an exit code, messages on stderr, one JSON object on stdout."""

import errno
import functools
import json
import os
import resource
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import typer

from lpvobs.cli.signals import Stopped, ignore_signals, received
from lpvobs.errors import DataError, LpvobsError, UsageError

DISK_FAILURES = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
"""What a full or broken disk says, wherever it hits: also where compiled code is kept for the next time."""
REFUSALS = (errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES, errno.EPERM, errno.EMFILE, errno.ENFILE, errno.ENOTDIR)
"""What the system says of a name, a right, or too many open files: nothing that the program has done wrong."""
REMEDIES = dict.fromkeys(DISK_FAILURES, "make room on the disk or make it writable")
REMEDIES |= dict.fromkeys(REFUSALS, "correct the file name or its permissions")

LEAST_ADDRESSES = 2**30
"""[bytes]; with 0.8 of it short verbs still work, with 0.6 the compiler of the kernels ends the process."""


def guarded(verb: Callable[..., None]) -> Callable[..., None]:
    """Return the verb with failures turned into one line on stderr and the contract's exit code."""

    @functools.wraps(verb)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            _expect_surroundings()
            os.environ.pop("MPLBACKEND", None)  # figures are drawn into files, which needs none
            verb(*args, **kwargs)
        except typer.Exit:
            raise
        except (Stopped, Exception) as error:
            if (signal := received()) is not None:
                ignore_signals()  # one line, not a second one when it is repeated
            message, code = _told(signal or error)  # a signal comes first, whatever has come of it on the way
            say("lpvobs: " + " ".join(message.split()))
            raise typer.Exit(code) from None

    return run


def _expect_surroundings() -> None:
    """Raise where the environment would end a library as it is loaded.

    DataError for so few addresses that compiled libraries abort, or look for some for ever; UsageError for a date that NumPy
    cannot read.
    """
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "0")
    if not epoch.isdecimal():
        raise UsageError(
            f"environment variable SOURCE_DATE_EPOCH={epoch}: expected whole seconds since 1970; correct or unset the variable"
        )
    granted, _ = resource.getrlimit(resource.RLIMIT_AS)
    if granted != resource.RLIM_INFINITY and granted < LEAST_ADDRESSES:
        raise DataError(
            f"the limit on memory (ulimit -v) is {granted >> 20} MiB; expected {LEAST_ADDRESSES >> 20} MiB or more; raise the limit"
        )


def _told(error: BaseException) -> tuple[str, int]:
    """Return what to say of a failure, and the exit code; raise again what nobody foresaw if LPVOBS_DEBUG is set."""
    if isinstance(error, (Stopped, LpvobsError)):
        return str(error), error.exit_code
    if isinstance(error, OSError) and (remedy := REMEDIES.get(error.errno or 0)):
        what = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
        return f"{what}; no file was changed; {remedy}, then run again", DataError.exit_code
    if os.environ.get("LPVOBS_DEBUG"):
        raise error
    fault = f"a fault of the program ({type(error).__name__}: {error})"
    return f"{fault}; run again with LPVOBS_DEBUG=1 to see where in the code, and report the fault", 4


def chosen_config(given: Path | None) -> Path:
    """Return the configuration to use: the one given, or that of the folder; raises UsageError where there is neither."""
    found = given or folder_config()
    if found is None:
        raise UsageError(
            "no configuration found; give one with --config TOML, or store it as lpvobs.toml in this folder or a folder above"
        )
    return found


def folder_config() -> Path | None:
    """Return the `lpvobs.toml` of the working folder, or the nearest one above it that may be looked into, and say so."""
    with suppress(OSError):  # somebody has removed the working folder
        here = Path.cwd()
        for folder in (here, *here.parents):
            with suppress(OSError):
                if (found := folder / "lpvobs.toml").is_file():
                    say(f"configuration: {found}")
                    return found
    return None


def say(message: str) -> None:
    """Print a message for a person to stderr, after what stdout has been given: both may end in one file."""
    sys.stdout.flush()
    print("\n".join(visible(line) for line in message.split("\n")), file=sys.stderr)


def visible(text: str) -> str:
    """Return text that a terminal shows and does not obey: names of files and channels may hold anything."""
    return "".join(sign if sign.isprintable() else "\ufffd" for sign in text)


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else value.tolist()


def print_json(verb: str, content: Any) -> None:
    """Print a record or table as the verb's one JSON object; numbers that are not finite become null."""
    from msgspec import to_builtins

    plain = json.dumps(to_builtins(content, enc_hook=_plain))
    found = json.loads(plain, parse_constant=lambda _: None)
    print(json.dumps({"schema": f"lpvobs/{verb}/1"} | found, indent=2))


def table(header: Sequence[str], rows: Sequence[Sequence[str]], labels: int = 1, left: int = 1) -> str:
    """Return rows as text in columns; the first one, or `left` of them, are left-aligned, the others right-aligned.

    On a terminal that is too narrow, the columns go on below, behind the first `labels` columns, which name the row. Elsewhere
    a row stays a line, for the programs that read it.

    Examples
    --------
    >>> print(table(["log", "samples"], [["a", "12"], ["bb", "3"]]))
    log  samples
    a         12
    bb         3
    """
    lines = [[visible(cell) for cell in line] for line in (header, *rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(header))]
    most = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    return "\n\n".join(
        "\n".join(
            "  ".join(line[c].rjust(widths[c]) if c >= left else line[c].ljust(widths[c]) for c in block).rstrip()
            for line in lines
        )
        for block in folded(widths, labels, most)
    )


def folded(widths: Sequence[int], labels: int, most: int | None) -> list[list[int]]:
    """Return the columns of each part of a table, none wider than `most` where one column beside the labels fits.

    Examples
    --------
    >>> folded([4, 6, 6, 6], 1, 20)
    [[0, 1, 2], [0, 3]]
    >>> folded([4, 6, 6, 6], 1, None)
    [[0, 1, 2, 3]]
    """
    named = list(range(labels))
    blocks = [named]
    for column in range(labels, len(widths)):
        block = [*blocks[-1], column]
        wide = most is not None and sum(widths[c] for c in block) + 2 * (len(block) - 1) > most
        if wide and len(block) > labels + 1:
            blocks.append([*named, column])
        else:
            blocks[-1] = block
    return blocks


@contextmanager
def progress(label: str) -> Iterator[Callable[[float], None]]:
    """Yield a function that takes the fraction done; shows a bar on stderr if that is a terminal, else nothing."""
    if not sys.stderr.isatty():
        yield lambda fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    share = TextColumn("{task.percentage:>3.0f} %")
    columns = TextColumn("{task.description}"), BarColumn(), share, TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)


def leave(refused: Sequence[str]) -> None:
    """Name the logs that were left out; end with the contract's code if there are any."""
    for message in refused:
        say(f"lpvobs: log left out: {message}")
    if refused:
        raise typer.Exit(DataError.exit_code)
