"""What a column of an unknown recording may be: by its name, its unit, and its range; and how sure that is."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lpvobs.ingest.recordings import Head
from lpvobs.io.logs.units import canonical, convert
from lpvobs.records import Array


@dataclass(frozen=True)
class Known:
    """A channel that recordings may hold.

    Attributes
    ----------
    unit : str
        In the log.
    typical : tuple of float
        [unit], where the median of a drive lies.
    units : tuple of str
        What recordings write it in, where they do not say.
    strong, weak : str
        Regular expressions for normalised names: those that mean this channel alone, and those that may.
    """

    unit: str
    typical: tuple[float, float]
    units: tuple[str, ...]
    strong: str
    weak: str = r"(?!)"


LONGEST_NAME = 200
_PRESSURE, _TEMPERATURE = ("Pa", "hPa", "kPa", "bar"), ("K", "degC")
_SPEED, _SHARE = ("rpm", "rad/s"), ("%", "1")

KNOWN: Mapping[str, Known] = {
    "n_e": Known(
        "rpm",
        (500, 5000),
        _SPEED,
        r"n e|ne|n eng|n mot|nmot|engine (speed|rpm)|motordrehzahl",
        r"n|rpm|drehzahl|speed|eng speed",
    ),
    "u_delta": Known(
        "mg/cycle",
        (1, 120),
        ("mg/cycle",),
        r"u delta|einspritzmenge|inj(ection|ected)? (qnt|quantity)|fuel (qnt|quantity)( .*)?",
        r".*(fuel|inj).*",
    ),
    "m_f": Known(
        "1",
        (1e-6, 1e3),
        ("1",),
        r"m f|fuel (mass )?per stroke",
        r"injected fuel mass|fuel mass",
    ),
    "u_egr": Known(
        "%",
        (-5, 105),
        _SHARE,
        r"u egr|(egr|agr) (valve )?(pos|position|opening)",
        r".*\b(egr|agr)\b.*",
    ),
    "u_vgt": Known(
        "%", (-5, 105), _SHARE, r"u vgt|(vgt|vtg|vnt) (pos|position|opening)", r".*\b(vgt|vtg|vnt|vane)\b.*"
    ),
    "alpha_th": Known(
        "%",
        (0, 100),
        _SHARE,
        r"alpha th|(absolute )?throttle (valve )?(pos|position|opening)|drosselklappe",
        r".*\b(throttle|tps|alpha)\b.*",
    ),
    "u_wg": Known(
        "1",
        (-0.05, 1.05),
        _SHARE,
        r"u wg|waste ?gate (pos|position|opening)",
        r".*waste ?gate.*",
    ),
    "p_im": Known(
        "Pa",
        (2e4, 4e5),
        _PRESSURE,
        r"p im|intake manifold (absolute )?press(ure)?|manifold absolute pressure|map|saugrohrdruck",
        r"p ?(2|22|int|man|boost).*|boost pressure|ladedruck",
    ),
    "p_ic": Known(
        "Pa",
        (6e4, 4e5),
        _PRESSURE,
        r"p ic|intercooler press(ure)?|press(ure)? before throttle",
        r"boost pressure|ladedruck|charge pressure",
    ),
    "p_em": Known(
        "Pa",
        (6e4, 6e5),
        _PRESSURE,
        r"p em|exhaust manifold (absolute )?press(ure)?",
        r"p ?(3|31|exh).*|.*exhaust.*press.*",
    ),
    "p_amb": Known(
        "Pa",
        (5.5e4, 1.1e5),
        _PRESSURE,
        r"p amb|(ambient|barometric|atmospheric) press(ure)?|umgebungsdruck|baro",
        r"p ?(0|atm|env).*",
    ),
    "T_im": Known(
        "K",
        (230, 420),
        _TEMPERATURE,
        r"t im|intake manifold (air )?temp(erature)?",
        r"t ?(2|22|int).*|iat|intake air temp(erature)?",
    ),
    "T_ic": Known(
        "K",
        (230, 420),
        _TEMPERATURE,
        r"t ic|intercooler temp(erature)?",
        r"intake air temp(erature)?|iat|charge air temp(erature)?",
    ),
    "T_em": Known(
        "K",
        (300, 1300),
        _TEMPERATURE,
        r"t em|exhaust manifold temp(erature)?",
        r"t ?(3|31|exh).*|egt|.*exhaust.*temp.*",
    ),
    "T_amb": Known(
        "K",
        (220, 330),
        _TEMPERATURE,
        r"t amb|(ambient|outside) (air )?temp(erature)?|umgebungstemperatur",
        r"t ?(0|1|env).*",
    ),
    "omega_t": Known(
        "rad/s",
        (300, 3e4),
        _SPEED,
        r"omega t|turb(o|ine) speed|n (turb|tc)",
        r".*(turbo|turbine|charger).*(speed|rpm).*",
    ),
    "W_maf": Known(
        "kg/s",
        (5e-4, 0.5),
        ("kg/s", "g/s", "kg/h"),
        r"w maf|maf|(mass air|air mass) ?flow|air flow rate( from mass flow sensor)?|luftmasse(nstrom)?|hfm",
        r".*\b(maf|air ?flow|airmass|luft)\b.*",
    ),
}


@dataclass(frozen=True)
class Guess:
    """Why a column may be a channel.

    Attributes
    ----------
    channel, column : str
        The column by its full name.
    sure : bool
        Its name means this channel alone, and neither unit nor range contradict.
    unit_sure : bool
        The file says the unit.
    unit : str
        As the file says it; else the one of its kind in which the median is typical; empty where none or several are.
    reasons : tuple of str
    """

    channel: str
    column: str
    sure: bool
    unit_sure: bool
    unit: str
    reasons: tuple[str, ...]


def normalised(name: str) -> str:
    """Return a name in lower-case words.

    Examples
    --------
    >>> normalised("EngineSpeed_filt"), normalised("meas.p_im"), normalised("W_maf")
    ('engine speed filt', 'p im', 'w maf')
    """
    last = name.rsplit(".", 1)[-1].rsplit(":", 1)[-1]
    split = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", last)
    return " ".join(re.sub(r"[^0-9a-zäöü]+", " ", split.lower()).split())


def guess(channel: str, column: str, head: Head, values: Array) -> Guess | None:
    """Return why a column may be a channel, None where its name does not say so or its unit is of another kind.

    Parameters
    ----------
    channel : str
        One of KNOWN.
    column : str
    head : Head
    values : ndarray, shape (N,)
        As recorded, NaN where there is none.
    """
    known, name = KNOWN[channel], normalised(head.name)[:LONGEST_NAME]
    strong = re.fullmatch(known.strong, name) is not None
    if not strong and not re.fullmatch(known.weak, name):
        return None
    reasons = [f"the name '{head.name}' {'means' if strong else 'may mean'} that"]
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return Guess(channel, column, False, bool(head.unit), head.unit, (*reasons, "but it holds no number"))
    middle = float(np.median(finite))
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


def _typical(known: Known, middle: float, unit: str) -> bool | None:
    """Return whether a median is usual in a unit, None where the unit is of another kind."""
    try:
        value = float(convert(np.array([middle]), unit, known.unit)[0])
    except ValueError:
        return None
    return known.typical[0] <= value <= known.typical[1]


def kind_of(unit: str) -> list[str]:
    """Return the channels that have a unit of this kind."""
    return [
        name for name, known in KNOWN.items() if unit and known.unit != "1" and _typical(known, 0.0, unit) is not None
    ]
