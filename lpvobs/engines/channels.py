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
    # regular expression for the short names of control units, as they are written: a part, `_`, a letter of the quantity,
    # and what is meant of it. Names of wanted, limited or controlled values are none.
    codes: str = r"(?!)"


PRESSURE, TEMPERATURE, SPEED, SHARE = ("Pa", "hPa", "kPa", "bar"), ("K", "degC"), ("rpm", "rad/s"), ("%", "1")
"""Units that recordings write a quantity in."""

COMMON: dict[str, Recorded] = {
    "n_e": Recorded(
        "rpm",
        (500, 5000),
        SPEED,
        r"n e|ne|n eng|r.gime moteur|n mot|nmot( w)?|eng(ine)? (speed|rpm)|motordrehzahl|rpm|drehzahl|"
        r"(engine )?revs|dzm nmit",
        r"n|speed|.*régime.*|engine.*(speed|rpm).*|.*motordrehzahl.*",
        r"(Epm|Eng|CoEng|EngSpd|EngN|CrS)\w*_n(Eng|Avrg|EngAvrg|Act)?\w*",
    ),
    "p_im": Recorded(
        "Pa",
        (2e4, 4e5),
        PRESSURE,
        r"p im|pim|p (intake )?manifold|p lade|(eng(ine)? )?(intake|"
        r"inlet) mani(fold)? ?1? ?(abs(olute)? )?press(ure)?( a)?|map|ps w|ldm p llin|"
        r"manifold (absolute )?press(ure)?|pression (de )?suralimentation( mesurée)?|(charge|"
        r"boost) press(ure)? (actual|absolute)|(saugrohr|ladeluft)druck( (ist|absolut|abs))*|ladedruck (ist|absolut)",
        r"p ?(2|22|int|man|boost).*|bpscd.*|.*pression.*(admission|suralim).*|.*(boost|charge).*press.*|"
        r".*ladedruck.*|.*manifold.*press.*|pvdkd?s( w)?|map .*",
        r"Air_p(IntkV|IntkMnf|IntMnf|CACDs)\w*|(PIntk|IntMnf|IntkMnf|IntkP|BstP|BoostP|PBst|ChrgP)\w*_p\w*|"
        r"PCR(CD)?_p(Act|Flt)\w*",
    ),
    "p_amb": Recorded(
        "Pa",
        (5.5e4, 1.1e5),
        PRESSURE,
        r"p ?amb|p ?atm(ospheric)?|p (baro|umg)|pression atmosph.rique|(abs(olute)? )?(ambient|baro(metric)?|"
        r"atmospheric) pres(s(ure)?)?( from vehicle)?|"
        r"(umgebungs|luft|atmosphären|atmosphaeren)druck|baro|pu( w)?",
        r"p ?(0|atm|env).*|bpscd.*|apscd.*|.*baro.*|.*(ambient|atmos).*pres.*|.*(umgebung|atmosph).*druck.*",
        r"Env(P|Prs)?\w*_p\w*",
    ),
    "T_amb": Recorded(
        "K",
        (220, 330),
        TEMPERATURE,
        r"t ?amb|t umg|tha|aat|temp.rature (air )?(ext.rieure|ambiante)|(ambient|outside) (air )?temp(erature)?|"
        r"(umgebungs|aussen|außen)(luft)?temp(eratur)?|tumg( w)?",
        r"t ?(0|1|env).*|.*(ambient|outside).*temp.*|.*(umgebung|au(ss|ß)en).*temp.*|t at maf|.*\bafs\b.*temp.*",
        r"Env(T|Tmp)?\w*_t(?!i)\w*|EATS(CD)?_t(?!i)\w*|Air_tEnv\w*",
    ),
    "W_maf": Recorded(
        "kg/s",
        (5e-4, 0.5),
        ("kg/s", "g/s", "kg/h"),
        r"w ?maf|lmm|ga|fa mass|d.bit massique d air|fresh air (mass )?flow|maf( air)?( flow)?( rate)?|"
        r"(mass air|(inlet |intake )?air mass) ?flow( rate| sensor)?|hfm|"
        r"ml( hfm)?( w)?|mshfm( w)?|"
        r"air flow rate( from mass (air )?flow sensor)?|(eng(ine)? )?(inlet|intake) air mass flow( rate)?|"
        r"luftmassen?(strom|durchsatz|fluss)?( ist)?|luftmassenmesser",
        r".*\b(maf|air ?flow|airmass|luft)\b.*|.*luftmasse.*|.*air mass.*",
        r"(AFS|AFSCD|HFM|MAF|Hfm)\w*_dm\w*",
    ),
}
"""Channels of every engine."""
