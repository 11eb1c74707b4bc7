"""Records of the configuration as compiled functions read them: named tuples of floats and arrays."""

from collections import namedtuple
from collections.abc import Iterable
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

Flat = TypeVar("Flat")


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
