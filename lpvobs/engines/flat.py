"""Records of the configuration as compiled functions read them: named tuples of floats and arrays."""

from collections import namedtuple
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

Flat = TypeVar("Flat")
Record = TypeVar("Record")


def names_of(*records: type, without: tuple[str, ...] = ()) -> list[str]:
    """Return the names of the fields of some records."""
    return [item.name for record in records for item in fields(record) if item.name not in without]


def flat_type(names: Iterable[str]) -> Any:
    """Return a class of named tuples.

    A compiled function that numba has stored knows the places of the fields, not their names: whoever changes the order changes
    their number or the name of the class, too.
    """
    return namedtuple("Flat", names)


def flat(kind: type[Flat], *records: Any, **derived: Any) -> Flat:
    """Return a named tuple of the records' fields of the same names, and of derived ones.

    Rows become arrays, numbers floats, and what is not there is zero.
    """
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
