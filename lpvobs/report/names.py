"""Words that are a table beside the code: how cycles, methods and effects are called; and what the paper reports for a cycle."""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import msgspec

from lpvobs.engines.registry import ENGINES


@dataclass(frozen=True)
class Phrase:
    """Words for one parameter of an effect, or for its course, as `phrases.toml` explains them."""

    words: str
    times: float = 1.0
    null: float = 0.0


PHRASES = msgspec.toml.decode(
    files("lpvobs.report").joinpath("phrases.toml").read_bytes(), type=dict[str, dict[str, Phrase]]
)


def cycle_title(log: str) -> str:
    """Return the name of a log for people; a cycle that stands in for the ETC is called so.

    Examples
    --------
    >>> cycle_title("etc_part1")
    'ETC surrogate, part 1'
    >>> cycle_title("etc_b")
    'ETC surrogate (etc_b)'
    >>> cycle_title("road_17")
    'road_17'
    """
    known = _cycle_of(log) or ("etc" if log.startswith("etc") else log)
    title = PHRASES["cycle"].get(known, Phrase(log)).words
    return title if known == log else f"{title} ({log})"


def method_title(method: str) -> str:
    """Return what a method is for a reader who does not know its identifier."""
    return PHRASES["method"].get(method, Phrase(f"method {method}")).words


def paper_error(air_path: str, log: str) -> float | None:
    """Return the mean relative error that is printed for the engine and the cycle that a log is named after, or None."""
    printed = ENGINES[air_path].published if air_path in ENGINES else None
    return None if printed is None else printed.errors.get(_cycle_of(log) or "")


def distinct(paths: list[Path]) -> list[str]:
    """Return a name for each file: its stem, or its whole path where two stems are alike."""
    stems = [path.stem for path in paths]
    return [stem if stems.count(stem) == 1 else str(path) for stem, path in zip(stems, paths, strict=True)]


def _cycle_of(log: str) -> str | None:
    """Return the longest cycle name that the log's name is, or begins with before `_` or `-`."""
    fits = [name for name in PHRASES["cycle"] if log == name or log.startswith((f"{name}_", f"{name}-"))]
    return max(fits, key=len, default=None)
