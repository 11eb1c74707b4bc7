"""What a column of an unknown recording may be: by its name, its unit, and its range; and how sure that is."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from lpvobs.engines.channels import COMMON, Recorded
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import UsageError
from lpvobs.ingest.recordings import Head
from lpvobs.ingest.words import bare, fits, meanings, normalised
from lpvobs.io.configuration.strict import read_text
from lpvobs.io.logs.units import canonical, convert, unit_of
from lpvobs.records import Array

LONGEST_NAME = 200
QUANTITY = {"K": frozenset({"temp"}), "Pa": frozenset({"pressure"})}
"""What a unit says where a name does not."""


def known_channels() -> Mapping[str, Recorded]:
    """Return the channels that recordings may hold: those that all engines share, and those of each."""
    return COMMON | {name: how for kind in ENGINES.values() for name, how in kind.recorded.items()}


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
                f"{path}: '{name}' is {found[bare(name)]} and {channel}; expected one channel; mend the table"
            )
    if not found:
        raise UsageError(
            f"{path}: names no channel; expected lines NAME;CHANNEL with one of {', '.join(known_channels())}"
        )
    return found


def guess(
    channel: str, column: str, head: Head, values: Array, own: Mapping[str, str] = MappingProxyType({})
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
    how = "means that by your own table" if said else "means that" if strong else "may mean that"
    reasons = [f"the name '{head.name}' {how}"]
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return Guess(channel, column, False, bool(head.unit), head.unit, (*reasons, "but it holds no number"))
    middle = float(np.median(finite))
    if head.unit and not _readable(head.unit):
        return Guess(channel, column, False, False, "", (*reasons, f"but nobody here knows the unit '{head.unit}'"))
    if head.unit:
        typical = _typical(known, middle, head.unit)
        if typical is None:
            return None
        reasons.append(f"unit {canonical(head.unit)}")
        reasons.append(f"median {middle:.4g}, {'as usual' if typical else 'which is unusual'}")
        return Guess(channel, column, strong and typical, True, head.unit, tuple(reasons))
    fitting = [unit for unit in known.units if _typical(known, middle, unit)]
    found = fitting[0] if len(fitting) == 1 else ""
    reasons.append(
        f"no unit in the file; the median {middle:.4g} is usual in {' or '.join(fitting) or 'no unit known for it'}"
    )
    return Guess(channel, column, strong and bool(fitting), False, found, tuple(reasons))


def _typical(known: Recorded, middle: float, unit: str) -> bool | None:
    """Return whether a median is usual in a unit, None where the unit is of another kind."""
    try:
        value = float(convert(np.array([middle]), unit, known.unit)[0])
    except ValueError:
        return None
    return known.typical[0] <= value <= known.typical[1]


def _readable(unit: str) -> bool:
    try:
        return bool(unit_of(unit)) or True
    except ValueError:
        return False


def kind_of(unit: str) -> list[str]:
    """Return the channels that have a unit of this kind."""
    return [
        name
        for name, known in known_channels().items()
        if unit and known.unit != "1" and _typical(known, 0.0, unit) is not None
    ]
