"""Conversion to the contract's units. Pint is imported only where a unit is spelled differently."""

import re
import tomllib
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np

from lpvobs.records import Array

# What a unit is made of. It comes from strangers: long powers would keep the parser busy for ever.
_READABLE = re.compile(r"[^\W\d][\w°%µ*/^ ()·.+-]{0,39}|%|°[CF]|1/\w{1,10}|1")

if TYPE_CHECKING:
    from pint import Unit, UnitRegistry

# A degree sign in every state in which it comes out of wrong decodings, sometimes several of them in a row.
_DEGREE = re.compile(r"(?:Ã‚)?Â?(?:°|º|˚|\ufffd{1,3}|ï¿½|\?|░|ø|deg(?:ree)?s?\.?|grad)\s?([CF])", re.IGNORECASE)


def canonical(unit: str) -> str:
    """Return a unit as the registry spells it; one that nobody here knows comes back as it is.

    Examples
    --------
    >>> [canonical(unit) for unit in ("Â°C", "min-1", "mg/str", "KG/H", "-", "furlong")]
    ['degC', 'rpm', 'mg/cycle', 'kg/h', '1', 'furlong']
    """
    bare = unit.strip()
    if degree := _DEGREE.fullmatch(bare):
        return "deg" + degree[1].upper()
    return _spellings().get(bare.lower(), bare)


@cache
def _spellings() -> dict[str, str]:
    """Return units by what measurement systems write for them."""
    tables = tomllib.loads(files("lpvobs.io.logs").joinpath("units.toml").read_text(encoding="utf-8"))
    return {spelling: unit for unit, spellings in tables.items() for spelling in spellings}


def is_broken(unit: str) -> bool:
    """Return whether a unit's degree sign has suffered in a wrong decoding.

    Examples
    --------
    >>> [is_broken(unit) for unit in ("Â°C", "?C", "°C", "degC", "Deg C", "kPa")]
    [True, True, False, False, False, False]
    """
    bare = unit.strip()
    whole = bare.startswith(("°", "º", "˚")) or bare.lower().startswith(("deg", "grad"))
    return not whole and _DEGREE.fullmatch(bare) is not None


def convert(values: Array, unit: str, wanted: str) -> Array:
    """Return values [unit] in the wanted unit; raises ValueError if the unit is unknown or of another dimension.

    Examples
    --------
    >>> convert(np.array([1.0, 2.0]), "kPa", "Pa")
    array([1000., 2000.])
    >>> convert(np.array([36.0]), "kg/h", "kg/s")
    array([0.01])
    """
    if wanted in (unit, canonical(unit)):
        return values
    try:
        source, target = unit_of(unit), unit_of(wanted)
        turns, wanted_turns = ("radian" in str((1 * each).to_root_units().units) for each in (source, target))
        converted = np.asarray(_registry().Quantity(values, source).to(target).magnitude, dtype=float)
    except Exception:
        raise ValueError(f"unit '{unit}' cannot be converted to '{wanted}'") from None
    if turns != wanted_turns:
        raise ValueError(
            f"unit '{unit}' cannot be converted to '{wanted}': only one of them counts turns, and 1/s or Hz may count cycles or "
            "strokes"
        )
    return converted


def unit_of(unit: str) -> "Unit":
    """Return a unit as pint knows it; raises ValueError for one that nobody knows."""
    known = re.sub(r"sqrt\((\w+)\)", r"\1^0.5", canonical(unit))
    if not _READABLE.fullmatch(known) or sum(map(str.isdigit, known)) > 2:
        raise ValueError(f"unit '{unit}' is not known")
    try:
        return _registry().Unit("dimensionless" if known == "1" else known)
    except Exception:
        raise ValueError(f"unit '{unit}' is not known") from None


@cache
def _registry() -> "UnitRegistry[float]":
    """Return a registry that counts cycles and strokes: left alone, pint reads `cycle` as 2 pi radian, an angle."""
    import pint

    registry: UnitRegistry[float] = pint.UnitRegistry(autoconvert_offset_to_baseunit=True, cache_folder=None)
    registry.define("cycle = [engine_cycle] = _ = stroke")
    registry.define("percent = 0.01 = %")
    return registry
