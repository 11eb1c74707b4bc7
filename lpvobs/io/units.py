"""Conversion to the contract's units. Pint is imported only where a unit is spelled differently."""

import re
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from lpvobs.records import Array

# What a unit is made of. It comes from strangers: long powers would keep the parser busy for ever.
_READABLE = re.compile(r"[^\W\d][\w°%µ*/^ ()·.+-]{0,39}|%|°[CF]|1/\w{1,10}|1")

if TYPE_CHECKING:
    from pint import Unit, UnitRegistry

# What measurement systems write, and pint reads as something else or not at all.
_FIELD_SPELLINGS = {"1/min": "rpm", "min^-1": "rpm", "U/min": "rpm", "mg/hub": "mg/cycle", "mg/Hub": "mg/cycle"}


def convert(values: Array, unit: str, wanted: str) -> Array:
    """Return values [unit] in the wanted unit.

    Raises
    ------
    ValueError
        If the unit is unknown or of another dimension.

    Examples
    --------
    >>> convert(np.array([1.0, 2.0]), "kPa", "Pa")
    array([1000., 2000.])
    >>> convert(np.array([36.0]), "kg/h", "kg/s")
    array([0.01])
    """
    if unit == wanted:
        return values
    if not _READABLE.fullmatch(unit) or sum(map(str.isdigit, unit)) > 2:
        raise ValueError(f"unit '{unit}' cannot be converted to '{wanted}'")
    registry = _registry()
    try:
        source, target = registry.Unit(_FIELD_SPELLINGS.get(unit, unit)), registry.Unit(wanted)
        if _is_angular(source) != _is_angular(target):
            raise ValueError("1/s or Hz may count cycles, strokes or turns")
        return np.asarray(registry.Quantity(values, source).to(target).magnitude, dtype=float)
    except Exception:
        raise ValueError(f"unit '{unit}' cannot be converted to '{wanted}'") from None


def _is_angular(unit: "Unit") -> bool:
    return "radian" in str((1 * unit).to_root_units().units)


@cache
def _registry() -> "UnitRegistry[float]":
    """Return a registry that reads the field's own units.

    A cycle (of a cylinder) and a stroke are counted, not turned: left alone, pint reads `cycle` as 2 pi radian and `mg/cycle`
    as an amount per angle.
    """
    import pint

    registry: UnitRegistry[float] = pint.UnitRegistry(autoconvert_offset_to_baseunit=True, cache_folder=None)
    registry.define("cycle = [engine_cycle] = _ = stroke")
    registry.define("percent = 0.01 = %")
    return registry
