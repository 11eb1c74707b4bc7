"""A first profile for an unknown recording: what is sure as it is, what is guessed as a comment, a reason with each.

Guessed is how a CSV file is laid out, whether it was polled, and what a column is by name, unit and range.
"""

import csv
import io
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from types import MappingProxyType

import numpy as np

from lpvobs.engines import channels, registry
from lpvobs.errors import DataError, UsageError
from lpvobs.ingest import formats, profiles, recordings, repairs
from lpvobs.ingest.resample import median_step
from lpvobs.ingest.words import bare, fits, meanings, normalised
from lpvobs.io.configuration.strict import read_text
from lpvobs.io.logs.units import canonical, convert, unit_of
from lpvobs.io.templates import filled
from lpvobs.records import Array

TIMES = re.compile(
    r"t|time|zeit|temps|timestamp|time stamp|t s|zeitstempel|elapsed( time)?|t (fast|slow)|time (fast|slow)"
)
IN_TURN = 0.95  # share of the changes in their column's turn from which a recording counts as polled
MOST_COLUMNS = 400

LONGEST_NAME = 200
QUANTITY = {"K": frozenset({"temp"}), "Pa": frozenset({"pressure"})}  # what a unit says where a name does not


@dataclass(frozen=True)
class Clock:
    """A column that may be time; `unit` is empty where neither file nor content says it."""

    column: str
    unit: str
    time: Array  # [s], NaN where it has none
    reason: str


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


def draft_profile(path: Path, names: Path | None = None) -> str:
    """Return the text of a profile for a recording, `names` being a user's own table; what is no comment is meant to be right."""
    own = {} if names is None else own_names(names)
    rules, layout = profiles.SourceRules(format=formats.sniff(path)), ["the first bytes of the file show its format"]
    if rules.format == "csv":
        rules, layout = csv_layout(path)
    recording = formats.open_recording(path, rules)
    heads, known = recording.heads, known_channels()
    with np.errstate(over="ignore", invalid="ignore"):  # numbers at the end of what floats can hold
        columns = recording.read(_worth_reading(recording, rules.format, own))
        timed = {} if rules.format == "mdf" else columns
        clocks = [clock for name, column in timed.items() if (clock := _clock(name, heads[name], column, rules))]
        used = {clock.column for clock in clocks}
        numbers = {name: _numbers(column, rules) for name, column in columns.items() if name not in used}
        if rules.format == "csv" and len(clocks) == 1:
            turns = [name for name in heads if name not in used]
            if (share := repairs.polled(numbers, turns)) >= IN_TURN:
                rules = replace(rules, polled=True)
                row = f"the one row of {len(turns)} in which the logger refreshes their column"
                layout.append(f"polled: {100 * share:.1f} % of all changes are in {row}")
        places = product((name for name in heads if name in numbers), known)
        guesses = [found for name, to in places if (found := guess(to, name, heads[name], numbers[name], own))]
    sure, order = _sure(guesses), list(known)
    used |= {found.column for found in guesses}
    if rules.polled:
        steps = [median_step(clocks[0].time) * (len(heads) - 1) / 2]  # twice as fast as the polling
    elif clocks:
        steps = [median_step(clock.time) for clock in clocks if clock.unit or rules.format == "mat"]
    else:
        steps = [median_step(time) for name in sure if (time := columns[name].time) is not None]
    return filled(
        "lpvobs.ingest",
        "profile.toml",
        {"text": _text, "comment": _comment, "json": json.dumps, "step": median_step, "kinds": kind_of},
        name=path.name,
        rules=rules,
        layout=layout,
        usual=profiles.SourceRules(),
        clocks=clocks,
        rate=1.0 / min((step for step in steps if step > 0), default=np.inf),
        columns=numbers,
        guesses=guesses,
        sure=sure,
        told=[each for each in sorted(guesses, key=lambda item: order.index(item.channel)) if _told(each, sure)],
        known=known,
        unused=[head for name, head in list(heads.items())[:MOST_COLUMNS] if name not in used],
    )


def _worth_reading(recording: recordings.ForeignRecording, kind: str, own: Mapping[str, str]) -> list[str]:
    """Return the columns to read: all of a small table, of a large one those that a name speaks for."""
    names = list(recording.heads)
    if kind != "mdf" and len(names) <= MOST_COLUMNS:
        return names
    nothing = np.array([np.nan])
    speaks = [
        name
        for name, head in recording.heads.items()
        if TIMES.fullmatch(normalised(head.name))
        or any(guess(channel, name, head, nothing, own) for channel in known_channels())
    ]
    return speaks[:MOST_COLUMNS]


def _numbers(column: recordings.Column, rules: profiles.SourceRules) -> Array:
    try:
        return recordings.as_numbers(column.data, rules.decimal)[0]
    except ValueError:
        return np.empty(0)


def _clock(name: str, head: recordings.Head, column: recordings.Column, rules: profiles.SourceRules) -> Clock | None:
    """Return a column as time if its name says so and it runs forward nearly everywhere."""
    if not TIMES.fullmatch(normalised(head.name)):
        return None
    for unit in dict.fromkeys((head.unit, "s", "clock", "datetime")):
        try:
            stamps, _ = repairs.stamps(column.data, unit, rules.decimal)
        except ValueError:
            continue
        time = stamps[np.isfinite(stamps)]
        if time.size > 1 and time.size > 0.9 * stamps.size and np.mean(np.diff(time) > 0) > 0.9:
            said = unit if unit in (head.unit, "clock", "datetime") else ""
            return Clock(name, said, stamps, f"the column is named '{head.name}', and its values increase")
    return None


def _sure(guesses: Sequence[Guess]) -> dict[str, Guess]:
    """Return by column the guesses without a rival: one column for the channel, one channel for the column."""
    certain = [found for found in guesses if found.sure]
    channels, columns = Counter(found.channel for found in certain), Counter(found.column for found in certain)
    alone = (found for found in certain if channels[found.channel] == columns[found.column] == 1)
    return {found.column: found for found in alone}


def _told(found: Guess, sure: Mapping[str, Guess]) -> bool:
    """Return whether a guess is worth telling: its column is not surely another channel, nor its channel another column."""
    by_channel = {item.channel: item for item in sure.values()}
    return sure.get(found.column, found) is found and by_channel.get(found.channel, found) is found


def _text(value: str) -> str:
    """Return a TOML string."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _comment(value: str) -> str:
    """Return text that stays in a comment's line."""
    return "".join(letter if letter.isprintable() else " " for letter in value)


def known_channels() -> Mapping[str, channels.Recorded]:
    """Return the channels that recordings may hold: those that all engines share, and those of each."""
    own = {name: how for kind in registry.ENGINES.values() for name, how in kind.recorded().items()}
    return {**channels.recorded(""), **own}


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
    how = "means this channel in your own table" if said else f"{'means' if strong else 'may mean'} this channel"
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
    others = {name: known for name, known in known_channels().items() if unit and known.unit != "1"}
    return [name for name, known in others.items() if _typical(known, 0.0, unit) is not None]


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
