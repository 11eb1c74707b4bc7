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
    # names that mean this channel alone, as phrases `a b, c` of the words of `ingest/words.toml` in any order
    means: str = ""
    may: str = ""  # the same for names that hold these words, and none of those behind a `-`, and may mean it
    strong: str = r"(?!)"  # regular expression for whole names in lower-case words that mean this channel alone
    weak: str = r"(?!)"  # the same for names that may mean it


PRESSURE, TEMPERATURE, SPEED, SHARE = ("Pa", "hPa", "kPa", "bar"), ("K", "degC"), ("rpm", "rad/s"), ("%", "1")
"""Units that recordings write a quantity in."""

COMMON: dict[str, Recorded] = {
    "n_e": Recorded(
        "rpm",
        (500, 5000),
        SPEED,
        "engine speed, revs, engine revs, motor revs",
        "speed -turbo -turbine -boost -compressor, revs -turbo -turbine -boost -compressor",
        r"n ?e|n ?mot w|drehzahl|dzm nmit",
        r"n|n ?\d+|vel motor",
    ),
    "p_im": Recorded(
        "Pa",
        (2e4, 4e5),
        PRESSURE,
        "intake manifold pressure, manifold pressure, boost pressure actual, boost pressure absolute, "
        "intake valve before pressure",
        "intake pressure -turbine -compressor, manifold pressure -exhaust, boost -speed -temp -position -flow -mass -revs, "
        "turbo pressure -exhaust -before -after, intercooler pressure",
        r"p ?im|p lade|ps w|ldm p llin",
        r"ep ?im|p ?[ls]|p ?(2|22|2s|int|man).*|bpscd.*|pvdkd?s( w)?|put( .*)?",
    ),
    "p_amb": Recorded(
        "Pa",
        (5.5e4, 1.1e5),
        PRESSURE,
        "ambient pressure",
        "ambient pressure",
        r"p ?a(mb|tm)|pu( w)?|abs baro pres(s(ure)?)?",
        r"p ?(0|1)( .*)?|p(a|u)( .*)?|bpscd.*|apscd.*|(anm|ldm) ?adf|luftdruck|air press(ure)?",
    ),
    "T_amb": Recorded(
        "K",
        (220, 330),
        TEMPERATURE,
        "ambient temp",
        "ambient temp, air temp -boost -exhaust -manifold -intercooler, air mass flow temp",
        r"t ?amb|tha|tumg( w)?",
        r"t ?(0|1)( .*)?|t(a|u)( .*)?|t at maf|anm ?utf",
    ),
    "W_maf": Recorded(
        "kg/s",
        (5e-4, 0.5),
        ("kg/s", "g/s", "kg/h"),
        "air mass flow, air flow, intake mass flow, intake air flow",
        "air flow -exhaust -egr -fuel, mass flow -exhaust -egr -fuel, air mass -exhaust -egr -fuel, intake flow",
        r"w ?maf|ga|fa mass|ml( hfm)?( w)?|mshfm( w)?",
        r".*\b(maf|luft)\b.*|(m|q|g|gn|w|wl|qm|qml|dml?) ?(a|l|air|luft|maf|dot)?|d?m ?(dot )?(air|l|luft)( .*)?",
    ),
}
"""Channels of every engine."""
