"""Channels of a log: what a working sensor reads, how recordings of other programs call them, and those that all engines share."""

import math
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files


@dataclass(frozen=True)
class Channel:
    """A channel that the engine's air path needs."""

    unit: str  # the unit of the contract; readers convert to it
    low: float  # what a working sensor can read at all; a sample outside is a defect
    high: float
    # range in which the median of a whole log lies; outside, the unit or the sign is wrong
    typical: tuple[float, float]
    meaning: str  # for people
    # [s], longest time that a working sensor may stand exactly still while the engine moves; infinite for what may rest
    # for a whole log, such as a valve or the weather
    still: float = math.inf
    # a channel that this one does not fall below by more than so much, in a healthy engine
    above: tuple[str, float] | None = None
    reaches: float = -math.inf  # what some sample of every log reaches
    follows: tuple[str, ...] = ()  # channels of which a connected sensor follows at least one while they move
    # other channels of which a log without this one needs one; none for what any log may lack, None for what none may.
    # A channel that is lacking reads NaN
    one_of: tuple[str, ...] | None = None

    def may_lack(self, there: Collection[str]) -> bool:
        """Return whether a log with these other channels can do without this one."""
        return self.one_of is not None and (not self.one_of or any(other in there for other in self.one_of))


AMBIENT: dict[str, Channel] = {
    "p_amb": Channel("Pa", 5e4, 1.2e5, (5.5e4, 1.1e5), "ambient pressure"),
    "T_amb": Channel("K", 200.0, 350.0, (220.0, 330.0), "ambient temperature"),
}
"""The surroundings, which every engine draws its air from."""


@dataclass(frozen=True)
class Recorded:
    """How recordings of other programs hold a channel."""

    unit: str  # in the log
    # [unit], where the median of a drive lies; narrower than `Channel.typical`, because it has to tell units apart
    typical: tuple[float, float]
    units: tuple[str, ...]  # what recordings write it in, where they do not say
    # names that mean this channel alone, as phrases `a b, c` of the words of `ingest/words.toml` in any order
    means: str = ""
    may: str = ""  # the same for names that hold these words, and none of those behind a `-`, and may mean it
    strong: str = r"(?!)"  # regular expression for whole names in lower-case words that mean this channel alone
    weak: str = r"(?!)"  # the same for names that may mean it


@cache
def recorded(*folders: str) -> Mapping[str, Recorded]:
    """Return how recordings hold the channels that `recorded.toml` lists in folders of `lpvobs.engines`; `` is that itself."""
    tables = [
        files("lpvobs.engines").joinpath(folder, "recorded.toml").read_text(encoding="utf-8") for folder in folders
    ]
    found = {name: how for table in tables for name, how in tomllib.loads(table).items()}
    lists = ("typical", "units")
    return {name: Recorded(**how | {key: tuple(how[key]) for key in lists}) for name, how in found.items()}
