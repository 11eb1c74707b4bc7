"""Channels of a log: what a working sensor reads, how recordings of other programs call them, and those that all engines share."""

import math
from collections.abc import Collection
from dataclasses import dataclass


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
    strong: str  # regular expression for names in lower-case words that mean this channel alone
    weak: str = r"(?!)"  # the same for names that may mean it


PRESSURE, TEMPERATURE, SPEED, SHARE = ("Pa", "hPa", "kPa", "bar"), ("K", "degC"), ("rpm", "rad/s"), ("%", "1")
"""Units that recordings write a quantity in."""

COMMON: dict[str, Recorded] = {
    "n_e": Recorded(
        "rpm",
        (500, 5000),
        SPEED,
        r"n e|ne|n eng|n mot|nmot|engine (speed|rpm)|motordrehzahl",
        r"n|rpm|drehzahl|speed|eng speed",
    ),
    "p_im": Recorded(
        "Pa",
        (2e4, 4e5),
        PRESSURE,
        r"p im|intake manifold (absolute )?press(ure)?|manifold absolute pressure|map|saugrohrdruck",
        r"p ?(2|22|int|man|boost).*|boost pressure|ladedruck",
    ),
    "p_amb": Recorded(
        "Pa",
        (5.5e4, 1.1e5),
        PRESSURE,
        r"p amb|(ambient|barometric|atmospheric) press(ure)?|umgebungsdruck|baro",
        r"p ?(0|atm|env).*",
    ),
    "T_amb": Recorded(
        "K",
        (220, 330),
        TEMPERATURE,
        r"t amb|(ambient|outside) (air )?temp(erature)?|umgebungstemperatur",
        r"t ?(0|1|env).*",
    ),
    "W_maf": Recorded(
        "kg/s",
        (5e-4, 0.5),
        ("kg/s", "g/s", "kg/h"),
        r"w maf|maf|(mass air|air mass) ?flow|air flow rate( from mass flow sensor)?|luftmasse(nstrom)?|hfm",
        r".*\b(maf|air ?flow|airmass|luft)\b.*",
    ),
}
"""Channels of every engine."""
