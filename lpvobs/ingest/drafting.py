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
    found: repairs.Stamps
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
    sure = _sure(guesses)
    blocks = [_head(path), _source(seen), _time(seen), _raster(seen, sure)]
    blocks += [
        _channel(found, seen, sure, [item for item in guesses if item.channel == found.channel])
        for found in sorted(guesses, key=lambda item: list(known_channels()).index(item.channel))
        if _told(found, sure)
    ]
    return "\n\n".join([*blocks, _rest(seen, guesses)]) + "\n"


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
        return recordings.as_numbers(column.data, rules.decimal).values
    except ValueError:
        return np.empty(0)


def _clock(name: str, head: recordings.Head, column: recordings.Column, rules: profiles.SourceRules) -> Clock | None:
    """Return a column as time if its name says so and it runs forward nearly everywhere."""
    if not TIMES.fullmatch(words.normalised(head.name)):
        return None
    for unit in dict.fromkeys((head.unit, "s", "clock", "datetime")):
        try:
            found = repairs.stamps(column.data, unit, rules.decimal)
        except ValueError:
            continue
        time = found.time[np.isfinite(found.time)]
        if time.size > 1 and time.size > 0.9 * found.time.size and np.mean(np.diff(time) > 0) > 0.9:
            said = unit if unit in (head.unit, "clock", "datetime") else ""
            return Clock(name, said, found, f"the column is named '{head.name}', and its values increase")
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


def _head(path: Path) -> str:
    name = _comment(path.name)
    return (
        f"# Draft made from {name}. Lines without # seemed sure. Read the comments and uncomment the lines that are right.\n"
        "# docs/ingest.md explains every key.\n"
        f"schema = 1\ndescription = {_text('recordings like ' + name)}"
    )


def _source(seen: Clues) -> str:
    rules = seen.rules
    lines = ["[source]", *(f"# {reason}" for reason in seen.layout), f"format = {_text(rules.format)}"]
    usual = profiles.SourceRules(format=rules.format)
    for key in ("delimiter", "decimal", "header_row", "unit_row"):
        if getattr(rules, key) != getattr(usual, key):
            lines.append(f"{key} = {json.dumps(getattr(rules, key))}")
    return "\n".join([*lines, *(["polled = true"] if rules.polled else [])])


def _time(seen: Clues) -> str:
    if seen.rules.format == "mdf":
        return "[time]\n# every MDF channel has its own time base, so no key is needed here"
    if not seen.clocks:
        return '[time]\n# no column has a name of time and increasing values; name the time column:\n# source = ""\n# unit = "s"'
    mark = "" if len(seen.clocks) == 1 or seen.rules.format == "mat" else "# "
    lines = ["[time]"]
    for clock in seen.clocks[:1] if seen.rules.format == "mat" else seen.clocks:
        lines += [f"# {clock.reason}", f"{mark}source = {_text(clock.column)}"]
        if not clock.unit:
            lines += [
                f"# the file gives no unit of time; the usual time step is {median_step(clock.found.time):.4g} in that unit",
                '# unit = "s"',
            ]
        elif clock.unit in ("clock", "datetime"):
            lines += [f"{mark}unit = {_text(clock.unit)}", f"{mark}from_zero = true"]
    return "\n".join(lines)


def _raster(seen: Clues, sure: Mapping[str, Guess]) -> str:
    """Return the raster: as recorded where there is one time base, else the rate of the fastest channel."""
    if len(seen.clocks) == 1 and not seen.rules.polled:
        return "# All channels share one time base. Without [raster] the samples keep their times."
    steps = [seen.steps[name] for name in sure if name in seen.steps]
    if seen.rules.polled:
        steps = [median_step(seen.clocks[0].found.time) * (len(seen.recording.heads) - 1) / 2]
    elif seen.clocks:
        steps = [median_step(clock.found.time) for clock in seen.clocks if clock.unit or seen.rules.format == "mat"]
    known = [step for step in steps if step > 0]
    if not known:
        return "[raster]\n# several time bases, or none known: give the sample rate of the log in Hz\n# rate = 20.0"
    what = "twice the rate of the polling" if seen.rules.polled else "the rate of the fastest channel below"
    return f"[raster]\n# sample rate in Hz: {what}; you may choose another\nrate = {1.0 / min(known):.6g}"


def _channel(found: Guess, seen: Clues, sure: Mapping[str, Guess], rivals: Sequence[Guess]) -> str:
    """Return a channel's table: as it is if sure, as a comment if not."""
    certain = sure.get(found.column) is found
    mark = "" if certain else "# "
    lines = [f"# {'; '.join(map(_comment, found.reasons))}"]
    if certain and (others := [item.column for item in rivals if item.column != found.column]):
        lines.append(f"# these columns have names that may mean this channel, too: {', '.join(map(_comment, others))}")
    if not certain:
        lines.append("# not sure: other columns or channels fit as well, or name, unit and range do not agree")
    lines += [f"{mark}[channels.{found.channel}]", f"{mark}source = {_text(found.column)}"]
    if not found.unit_sure:
        lines.append(f"# source_unit = {_text(found.unit)}" + ("" if found.unit else "  # which?"))
    lines.append(f"{mark}unit = {_text(known_channels()[found.channel].unit)}")
    if seen.rules.format == "mat" and len(seen.clocks) > 1:
        lines += _own_clock(found, seen, mark)
    return "\n".join(lines)


def _own_clock(found: Guess, seen: Clues, mark: str) -> list[str]:
    """Return the time base of a vector: the one of its length."""
    size = seen.columns[found.column].size
    fitting = [clock.column for clock in seen.clocks if clock.found.time.size == size]
    if len(fitting) == 1:
        return [f"{mark}time = {_text(fitting[0])}  # the only time column with {size} samples, as this channel has"]
    none = "# time: no time column has as many samples as this channel"
    return [f"# time = {_text(name)}" for name in fitting] or [none]


def _rest(seen: Clues, guesses: Sequence[Guess]) -> str:
    """Return the columns that nothing was guessed of, with the channels that their unit would allow."""
    told = {found.column for found in guesses} | {clock.column for clock in seen.clocks}
    lines = ["# Columns that are not used:"]
    for name, head in list(seen.recording.heads.items())[:MOST_COLUMNS]:
        if name not in told:
            fits = ", ".join(kind_of(head.unit))
            hint = f" (its unit fits {fits})" if fits else ""
            lines.append(f"#   {_comment(head.name)} [{_comment(head.unit) or 'no unit'}]{hint}")
    return "\n".join(lines if len(lines) > 1 else ["# Every column was looked at above."])


def _text(value: str) -> str:
    """Return a TOML string."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _comment(value: str) -> str:
    """Return text that stays in a comment's line."""
    return "".join(letter if letter.isprintable() else " " for letter in value)
