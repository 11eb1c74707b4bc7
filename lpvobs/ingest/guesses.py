"""What an unknown recording may be: how a CSV file is laid out, whether it was polled, what a column is by name, unit and range."""

import csv
import io
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from lpvobs.engines import channels, registry
from lpvobs.errors import DataError, UsageError
from lpvobs.ingest import profiles, recordings
from lpvobs.ingest.words import bare, fits, meanings, normalised
from lpvobs.io.configuration.strict import read_text
from lpvobs.io.logs.units import canonical, convert, unit_of
from lpvobs.records import Array

LONGEST_NAME = 200
QUANTITY = {"K": frozenset({"temp"}), "Pa": frozenset({"pressure"})}  # what a unit says where a name does not


def known_channels() -> Mapping[str, channels.Recorded]:
    """Return the channels that recordings may hold: those that all engines share, and those of each."""
    own = {name: how for kind in registry.ENGINES.values() for name, how in kind.recorded().items()}
    return {**channels.recorded(""), **own}


@dataclass(frozen=True)
class Guess:
    """Why a column may be a channel."""

    channel: str
    column: str  # by its full name
    sure: bool  # its name means this channel alone, and neither unit nor range contradict
    unit_sure: bool  # the file says the unit
    # as the file says it; else the one of its kind in which the median is typical; empty where none or several are
    unit: str
    reasons: tuple[str, ...]


def own_names(path: Path) -> dict[str, str]:
    """Return a user's own channels by name: lines `NAME;CHANNEL` in either order, of a CSV table or of an INCA `.lab` file.

    Headings in brackets, comments and what names no channel are passed over. Raises UsageError for a file without any, or a name
    that stands for two channels.
    """
    found: dict[str, str] = {}
    for line in read_text(path).lstrip("\ufeff").splitlines():
        cells = [cell.strip().strip('"') for cell in re.split(r"[;,\t]", line)]
        channel = next((cell for cell in cells if cell in known_channels()), None)
        name = next((cell for cell in cells if cell and cell != channel), None)
        if channel is None or name is None or line.startswith(("[", "#", "*")):
            continue
        if found.setdefault(bare(name), channel) != channel:
            raise UsageError(
                f"{path}: the name '{name}' stands for {found[bare(name)]} and for {channel}; expected one channel for "
                "each name; correct the table"
            )
    if not found:
        raise UsageError(
            f"{path}: names no channel; expected lines NAME;CHANNEL, with CHANNEL one of {', '.join(known_channels())}"
        )
    return found


def guess(
    channel: str, column: str, head: recordings.Head, values: Array, own: Mapping[str, str] = MappingProxyType({})
) -> Guess | None:
    """Return why a column may be a channel, None where its name does not say so or its unit is of another kind.

    The channel is one of `known_channels`; values, shape (N,), are as recorded, NaN where there is none. What `own_names` says of
    a name comes first.
    """
    known, name = known_channels()[channel], normalised(head.name[:LONGEST_NAME])
    words, said = meanings(head.name[:LONGEST_NAME]), own.get(bare(head.name))
    meant = "wanted" not in words[-1] and any(fits(known.means, part, True) for part in words)
    named = re.fullmatch(known.strong, name) is not None or meant
    told = QUANTITY.get(known.unit, frozenset()) if head.unit else frozenset()
    held = any("elsewhere" not in part and fits(known.may, part | told, False) for part in words)
    may = re.fullmatch(known.weak, name) is not None or held
    strong = said == channel if said else named and channel not in own.values()
    if not strong and (said or not (named or may)):
        return None
    how = (
        "means this channel in your own table" if said else "means this channel" if strong else "may mean this channel"
    )
    reasons = [f"the name '{head.name}' {how}"]
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return Guess(channel, column, False, bool(head.unit), head.unit, (*reasons, "but the column has no numbers"))
    middle = float(np.median(finite))
    if not head.unit:
        fitting = [unit for unit in known.units if _typical(known, middle, unit)]
        usual = " or ".join(fitting) or "none of the known units"
        reasons.append(f"no unit in the file; the median {middle:.4g} is usual in {usual}")
        found = fitting[0] if len(fitting) == 1 else ""
        return Guess(channel, column, strong and bool(fitting), False, found, tuple(reasons))
    try:
        unit_of(head.unit)
    except ValueError:
        return Guess(channel, column, False, False, "", (*reasons, f"but lpvobs does not know the unit '{head.unit}'"))
    typical = _typical(known, middle, head.unit)
    if typical is None:
        return None
    reasons += [f"unit {canonical(head.unit)}", f"median {middle:.4g}, {'as usual' if typical else 'which is unusual'}"]
    return Guess(channel, column, strong and typical, True, head.unit, tuple(reasons))


def _typical(known: channels.Recorded, middle: float, unit: str) -> bool | None:
    """Return whether a median is usual in a unit, None where the unit is of another kind."""
    try:
        value = float(convert(np.array([middle]), unit, known.unit)[0])
    except ValueError:
        return None
    return known.typical[0] <= value <= known.typical[1]


def kind_of(unit: str) -> list[str]:
    """Return the channels that have a unit of this kind."""
    return [
        name
        for name, known in known_channels().items()
        if unit and known.unit != "1" and _typical(known, 0.0, unit) is not None
    ]


DELIMITERS = (";", "\t", ",", "|")
LOOKED_AT = 40
LINE = 1 << 16
_NUMBER = re.compile(r"[+-]?[\d.,]*\d[\d.,]*([eE][+-]?\d+)?")
_CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?")


def csv_layout(path: Path) -> tuple[profiles.SourceRules, list[str]]:
    """Return how a CSV file is laid out, and the reason of each guess; raises DataError if its first lines are no table."""
    with recordings.opened(path) as raw, io.TextIOWrapper(raw, encoding="utf-8", errors="replace") as stream:
        lines = [stream.readline(LINE) for _ in range(LOOKED_AT)]
    lines = [line.rstrip("\r\n").lstrip("\ufeff") for line in lines if line]
    if sum(bool(line.strip()) for line in lines) < 2 or any("\0" in line for line in lines):
        raise DataError(f"{path}: not a CSV table of names and numbers; name a text file")
    # the delimiter for which most speaks: columns times lines that agree on their number
    widths = {sign: Counter(len(_fields(line, sign)) for line in lines) for sign in DELIMITERS}
    every = ((sign, width, (width - 1) * often) for sign, counts in widths.items() for width, often in counts.items())
    delimiter, width, _ = max(every, key=lambda item: item[2])
    if width < 2:
        raise DataError(
            f"{path}: the first lines are not a table with comma, semicolon, | or tab between the columns; describe the "
            "file in [source] of a profile"
        )
    rows = [_fields(line, delimiter) for line in lines]
    header = next(number for number, row in enumerate(rows) if len(row) == width)
    body = [row for row in rows[header + 1 :] if any(row)]
    values = [[word for word in row if _NUMBER.fullmatch(word) or _CLOCK.fullmatch(word)] for row in body]
    units = bool(body) and len(body[0]) == width and not values[0] and bool(values[-1])
    numbers = "".join(word for row in body for word in row if _NUMBER.fullmatch(word))
    decimal = "," if delimiter != "," and "," in numbers and "." not in numbers else "."
    rules = profiles.SourceRules(
        format="csv", delimiter=delimiter, decimal=decimal, header_row=header + 1, unit_row=header + 2 if units else 0
    )
    reasons = [f"{width} columns in {sum(len(row) == width for row in rows)} of the first {len(rows)} lines"]
    if units:
        reasons.append(f"line {header + 2} has no numbers, but later lines have numbers: it has the units")
    if decimal == ",":
        reasons.append("numbers have a decimal comma, and none has a point")
    return rules, reasons


def _fields(line: str, delimiter: str) -> list[str]:
    return [word.strip() for word in next(csv.reader([line], delimiter=delimiter), [])]


def refreshed(values: Array, turn: int, turns: int) -> tuple[int, int]:
    """Return how often a column changes out of its turn, and how often in all; row r is the turn of column r modulo `turns`."""
    changed = np.flatnonzero((values[1:] != values[:-1]) & np.isfinite(values[:-1])) + 1
    return int(np.count_nonzero(changed % turns != turn)), changed.size


def polled(columns: Mapping[str, Array], turns: list[str]) -> float:
    """Return which share of all changes falls into the turn of its column, NaN for under three columns or a hundred changes."""
    # By chance it would be one in the number of columns. `turns` are all columns besides time, in the order of the file.
    counts = [refreshed(values, turns.index(name), len(turns)) for name, values in columns.items()]
    late, every = (sum(count[end] for count in counts) for end in (0, 1))
    return 1.0 - late / every if len(turns) >= 3 and every >= 100 else float("nan")
