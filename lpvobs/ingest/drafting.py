"""A first profile for an unknown recording: what is sure as it is, what is guessed as a comment, a reason with each."""

import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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


@dataclass(frozen=True)
class Clues:
    """What was seen in a recording."""

    recording: recordings.ForeignRecording
    rules: profiles.SourceRules
    layout: list[str]
    clocks: list[Clock]
    columns: Mapping[str, Array]
    steps: Mapping[str, float]
    own: Mapping[str, str]  # the user's channels by name


def draft_profile(path: Path, names: Path | None = None) -> str:
    """Return the text of a profile for a recording, `names` being a user's own table; what is no comment is meant to be right."""
    own = {} if names is None else own_names(names)
    with np.errstate(over="ignore", invalid="ignore"):  # numbers at the end of what floats can hold
        seen = _look(path, own)
        guesses = [found for name, head in seen.recording.heads.items() for found in _guesses(name, head, seen)]
    sure, rules, heads = _sure(guesses), seen.rules, list(seen.recording.heads.items())
    used = {found.column for found in guesses} | {clock.column for clock in seen.clocks}
    order, usual = list(known_channels()), profiles.SourceRules(format=rules.format)
    layout = ("delimiter", "decimal", "header_row", "unit_row")
    return filled(
        "lpvobs.ingest",
        "profile.toml",
        {"text": _text, "comment": _comment, "json": json.dumps, "step": _step, "kinds": kind_of},
        name=path.name,
        seen=seen,
        rules=rules,
        unusual={key: value for key in layout if (value := getattr(rules, key)) != getattr(usual, key)},
        rate=_rate(seen, sure),
        guesses=guesses,
        sure=sure,
        told=[each for each in sorted(guesses, key=lambda item: order.index(item.channel)) if _told(each, sure)],
        known=known_channels(),
        unused=[head for name, head in heads[:MOST_COLUMNS] if name not in used],
    )


def _look(path: Path, own: Mapping[str, str]) -> Clues:
    kind = foreign.sniff(path)
    rules, layout = profiles.SourceRules(format=kind), ["the first bytes of the file show its format"]
    if kind == "csv":
        rules, layout = csv_layout(path)
    recording = foreign.open_recording(path, rules)
    names = _worth_reading(recording, kind, own)
    columns = recording.read(names)
    timed = [] if kind == "mdf" else names
    clocks = [found for name in timed if (found := _clock(name, recording.heads[name], columns[name], rules))]
    numbers = {name: _numbers(columns[name], rules) for name in names if name not in {clock.column for clock in clocks}}
    if kind == "csv" and len(clocks) == 1:
        turns = [name for name in recording.heads if name != clocks[0].column]
        share = polled(numbers, turns)
        if share >= IN_TURN:
            rules = replace(rules, polled=True)
            layout = [
                *layout,
                f"polled: {100 * share:.1f} % of all changes are in the one row of {len(turns)} in which the logger "
                "refreshes their column",
            ]
    steps = {name: median_step(column.time) for name, column in columns.items() if column.time is not None}
    return Clues(recording, rules, layout, clocks, numbers, steps, own)


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


def _guesses(name: str, head: recordings.Head, seen: Clues) -> list[Guess]:
    values = seen.columns.get(name)
    if values is None:
        return []
    return [found for channel in known_channels() if (found := guess(channel, name, head, values, seen.own))]


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


def _rate(seen: Clues, sure: Mapping[str, Guess]) -> float:
    """Return the rate of the log [Hz]: that of the fastest channel, twice that of the polling, zero where none is known."""
    steps = [seen.steps[name] for name in sure if name in seen.steps]
    if seen.rules.polled:
        steps = [median_step(seen.clocks[0].time) * (len(seen.recording.heads) - 1) / 2]
    elif seen.clocks:
        steps = [median_step(clock.time) for clock in seen.clocks if clock.unit or seen.rules.format == "mat"]
    return 1.0 / min((step for step in steps if step > 0), default=np.inf)


def _step(clock: Clock) -> str:
    return f"{median_step(clock.time):.4g}"


def _text(value: str) -> str:
    """Return a TOML string."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _comment(value: str) -> str:
    """Return text that stays in a comment's line."""
    return "".join(letter if letter.isprintable() else " " for letter in value)
