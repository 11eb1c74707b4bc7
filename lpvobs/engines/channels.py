"""Channels of a log: what working sensors read and how they are late, how recordings call them, and how they may be mixed up."""

import math
import tomllib
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array


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


AMBIENT = ("p_amb", "T_amb")
"""The surroundings, which every engine draws its air from."""


@cache
def channels(*folders: str) -> Mapping[str, Channel]:
    """Return the channels that the last of some folders of `lpvobs.engines` lists; what it leaves out, those before it say."""
    *usual, own = _tables("channels.toml", "", *folders)
    return {name: Channel(**{k: x for table in (*usual, own) for k, x in table.get(name, {}).items()}) for name in own}


def _tables(file: str, *folders: str) -> list[dict[str, Any]]:
    """Return the TOML files of a name in folders of `lpvobs.engines`, lists as tuples; `` is that itself."""
    texts = [files("lpvobs.engines").joinpath(folder, file).read_text(encoding="utf-8") for folder in folders]
    return [{name: {k: _tuple(x) for k, x in how.items()} for name, how in tomllib.loads(t).items()} for t in texts]


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


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
    return {name: Recorded(**how) for table in _tables("recorded.toml", *folders) for name, how in table.items()}


SLOWEST = 60.0  # [s] A sensor that takes longer shows nothing of a drive cycle
Pulsation = Callable[[Mapping[str, Array], float], Array]
"""Returns reading over truth of a sensor in a flow that pulsates, shape (N,), from channels and a coefficient."""


@dataclass(frozen=True)
class Sensor:
    """How an intact sensor and the recording distort a reading; zero leaves the reading as it is."""

    tau: float = 0.0  # [s] of its first-order response
    delay: float = 0.0  # [s] dead time, of the bus for example
    filter: float = 0.0  # [s] over which the control unit takes a running mean
    raster: float = 0.0  # [s] between two readings; each is held until the next
    quantisation: float = 0.0  # smallest step of a reading, in the channel's unit
    pulsation: float = 0.0  # what an air flow sensor reads too much by where the flow pulsates, as in `maf.backflow`

    def __post_init__(self) -> None:
        for item in fields(self):
            most = 1.0 if item.name == "pulsation" else float("inf") if item.name == "quantisation" else SLOWEST
            if not 0.0 <= getattr(self, item.name) <= most:
                raise ValueError(f"sensor setting {item.name} must lie between 0 and {most:g}")

    @property
    def late(self) -> float:
        """How late a sample is behind the sensor [s]; on average by half of what it is the mean of, or held for."""
        return self.delay + 0.5 * (self.filter + self.raster)


Channels = dict[str, Array]
Columns = Mapping[str, Array]


@dataclass(frozen=True)
class Exchanged:
    """A mistake without which the balances agree: two channels bear each other's names."""

    one: str
    other: str

    @property
    def says(self) -> str:
        """The mistake in words."""
        return f"{self.one} and {self.other} exchanged"

    def mended(self, channels: Channels) -> Channels:
        """Return the channels put right."""
        return {**channels, self.one: channels[self.other], self.other: channels[self.one]}


@dataclass(frozen=True)
class Below:
    """What no healthy engine does for more than a share of the time, whatever its constants: a channel is below another."""

    one: str
    other: str
    most: float  # share of the time
    slack: float = 0.0  # [unit], what it may be below
    unit: str = ""

    @property
    def says(self) -> str:
        """The fault in words."""
        far = f"more than {self.slack:g} {self.unit} " if self.slack else ""
        return f"{self.one} is {far}below {self.other}"

    def broken(self, channels: Channels) -> NDArray[np.bool_]:
        """Return where a log does it."""
        return np.asarray(channels[self.one] < channels[self.other] - self.slack)


@dataclass(frozen=True)
class Suspects:
    """What the logs of a kind of engine are tried for."""

    checks: tuple[Below, ...] = ()
    mix_ups: tuple[Exchanged, ...] = ()
