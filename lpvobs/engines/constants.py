"""Constants of an engine: what one can be, and their records as compiled functions read them, named tuples of floats and arrays."""

from collections import namedtuple
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

USUAL_UNITS: dict[str, tuple[tuple[str, float], ...]] = {
    "m^3": (("litres", 1e-3), ("cm^3", 1e-6)),
    "m^2": (("mm^2", 1e-6), ("cm^2", 1e-4)),
    "m": (("mm", 1e-3), ("cm", 1e-2)),
    "kg/s": (("g/s", 1e-3), ("kg/h", 1.0 / 3600.0)),
    "J/(kg K)": (("kJ/(kg K)", 1e3),),
    "kg m^2": (("kg mm^2", 1e-6), ("kg cm^2", 1e-4)),
    "Pa": (("kPa", 1e3), ("hPa", 1e2), ("bar", 1e5)),
    "1": (("%", 1e-2),),
}
"""In which other units people state a quantity, the likeliest first, and what one of them is in ours."""
MOST_POWERS = 6


@dataclass(frozen=True)
class Within:
    """The annotation of a constant: no engine of this kind has it outside.

    The bounds are wide: from the smallest engine of one cylinder to one of 200 litres. They catch a unit or a slip, not a constant
    that is off; how far the balances agree tells of that.

    Examples
    --------
    >>> Within(1e-4, 0.2, "m^3", "displacement").complaint(1.9)
    '1.9 m^3 is not a plausible displacement, expected 0.0001 to 0.2; did you mean 0.0019 (1.9 litres)?'
    """

    low: float  # [unit]
    high: float  # [unit]
    unit: str
    what: str  # the quantity, for people

    def complaint(self, value: float) -> str | None:
        """Return what is wrong with a value, and what was probably meant; None for a possible one."""
        if self._holds(value):
            return None
        unit = "" if self.unit == "1" else f" {self.unit}"
        meant = " or ".join(self._meant(value))
        hint = f"did you mean {meant}?" if meant else "correct that key"
        return f"{value:g}{unit} is not a plausible {self.what}, expected {self.low:g} to {self.high:g}; {hint}"

    def _meant(self, value: float) -> list[str]:
        """Return the value in the other usual units that make it possible; if none does, by the nearest power of ten."""
        units = USUAL_UNITS.get(self.unit, ())
        in_units = [f"{value * factor:.6g} ({value:g} {unit})" for unit, factor in units if self._holds(value * factor)]
        powers = [10.0**power for size in range(1, MOST_POWERS + 1) for power in (-size, size)]
        return in_units or [f"{value * power:.6g}" for power in powers if self._holds(value * power)][:1]

    def _holds(self, value: float) -> bool:
        return self.low <= value <= self.high  # False for NaN


Flat = TypeVar("Flat")
Record = TypeVar("Record")


def names_of(*records: type, without: tuple[str, ...] = ()) -> list[str]:
    """Return the names of the fields of some records."""
    return [item.name for record in records for item in fields(record) if item.name not in without]


def flat_type(names: Iterable[str]) -> Any:
    """Return a class of named tuples."""
    # A compiled function that numba has stored knows the places of the fields, not their names: whoever changes the order
    # changes their number or the name of the class, too.
    return namedtuple("Flat", names)


def flat(kind: type[Flat], *records: Any, **derived: Any) -> Flat:
    """Return a named tuple of the records' fields of the same names, and of derived ones."""
    # Rows become arrays, numbers floats, and what is not there is zero.
    known = {name: getattr(record, name) for record in records for name in names_of(type(record))} | derived
    return kind(*(_flat(known[name]) for name in kind._fields))  # type: ignore[attr-defined]


def _flat(value: Any) -> Any:
    return np.array(value, dtype=float) if isinstance(value, tuple) else float(value or 0.0)


def scaled(record: Record, constants: Mapping[str, float]) -> Record:
    """Return an engine with some of its constants multiplied by one plus their relative deviation, wherever they stand.

    Examples
    --------
    >>> from lpvobs.engines.components.intake import Egr
    >>> scaled(Egr(1.0, 0.0, 2.0, 0.65, 0.6), {"c_egr2": 0.5}).c_egr2
    3.0
    """
    changed: dict[str, Any] = {}
    for item in fields(record):  # type: ignore[arg-type]
        value = getattr(record, item.name)
        if is_dataclass(value):
            changed[item.name] = scaled(value, constants)
        elif item.name in constants:
            changed[item.name] = value * (1.0 + constants[item.name])
    return replace(record, **changed)  # type: ignore[type-var]
