"""A first profile for an unknown recording: what is sure as it is, what is guessed as a comment, a reason with each."""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from lpvobs.ingest import foreign, profiles, recordings, repairs, words
from lpvobs.ingest.guesses import Guess, csv_layout, guess, kind_of, known_channels, own_names, polled
from lpvobs.ingest.resample import median_step
from lpvobs.io.templates import filled
from lpvobs.records import Array

TIMES = re.compile(
    r"t|time|zeit|temps|timestamp|time stamp|t s|zeitstempel|elapsed( time)?|t (fast|slow)|time (fast|slow)"
)
IN_TURN = 0.95  # share of the changes in their column's turn from which a recording counts as polled
MOST_COLUMNS = 400


@dataclass(frozen=True)
class Clock:
    """A column that may be time; `unit` is empty where neither file nor content says it."""

    column: str
    unit: str
    time: Array  # [s], NaN where it has none
    reason: str


def draft_profile(path: Path, names: Path | None = None) -> str:
    """Return the text of a profile for a recording, `names` being a user's own table; what is no comment is meant to be right."""
    own = {} if names is None else own_names(names)
    rules, layout = profiles.SourceRules(format=foreign.sniff(path)), ["the first bytes of the file show its format"]
    if rules.format == "csv":
        rules, layout = csv_layout(path)
    recording = foreign.open_recording(path, rules)
    heads, known = recording.heads, known_channels()
    with np.errstate(over="ignore", invalid="ignore"):  # numbers at the end of what floats can hold
        columns = recording.read(_worth_reading(recording, rules.format, own))
        timed = {} if rules.format == "mdf" else columns
        clocks = [clock for name, column in timed.items() if (clock := _clock(name, heads[name], column, rules))]
        used = {clock.column for clock in clocks}
        numbers = {name: _numbers(column, rules) for name, column in columns.items() if name not in used}
        if rules.format == "csv" and len(clocks) == 1:
            turns = [name for name in heads if name not in used]
            share = polled(numbers, turns)
            if share >= IN_TURN:
                rules = replace(rules, polled=True)
                layout += [
                    f"polled: {100 * share:.1f} % of all changes are in the one row of {len(turns)} in which the logger "
                    "refreshes their column",
                ]
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
    usual = profiles.SourceRules()
    return filled(
        "lpvobs.ingest",
        "profile.toml",
        {"text": _text, "comment": _comment, "json": json.dumps, "step": median_step, "kinds": kind_of},
        name=path.name,
        rules=rules,
        layout=layout,
        unusual={
            key: value
            for key in ("delimiter", "decimal", "header_row", "unit_row")
            if (value := getattr(rules, key)) != getattr(usual, key)
        },
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
        if TIMES.fullmatch(words.normalised(head.name))
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
    if not TIMES.fullmatch(words.normalised(head.name)):
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
