"""Logs that are worked on together: a bad one is left out and named, the others go on."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lpvobs.errors import DataError
from lpvobs.records import Log

if TYPE_CHECKING:  # `estimate` reads logs, too, and does without the room of discovery
    from lpvobs.discovery.outcome import Trace

LogAt = tuple[Path, Log]


@dataclass(frozen=True)
class Traced:
    """What came of `trace` or `refine`."""

    found: "Trace"
    map_frozen: bool  # whether the map stood; otherwise it was estimated together with the effects
    refused: tuple[str, ...]  # why logs were left out, one line each


def usable(paths: Sequence[Path], read: Callable[[Path], Log]) -> tuple[tuple[LogAt, ...], tuple[str, ...]]:
    """Return the logs that can be used with their paths, and why the others cannot.

    Raises DataError if there are logs, and none can be used.
    """
    logs: list[LogAt] = []
    refused: list[str] = []
    for path in paths:
        try:
            logs.append((path, read(path)))
        except DataError as error:
            refused.append(str(error))
    if paths and not logs:
        raise DataError("; ".join(refused))
    return tuple(logs), tuple(refused)


def contents(logs: Iterable[LogAt]) -> tuple[Log, ...]:
    """Return logs without their paths."""
    return tuple(log for _, log in logs)
