"""Records of the configuration as compiled functions read them: named tuples of floats and arrays."""

from typing import Any, NamedTuple, TypeVar

import numpy as np

Flat = TypeVar("Flat", bound=NamedTuple)


def flat(kind: type[Flat], *records: Any, **derived: Any) -> Flat:
    """Return a named tuple of the records' fields of the same names, and of derived ones: rows as arrays, numbers as floats."""
    known = {name: value for record in records for name, value in vars(record).items()} | derived
    return kind(*(_flat(known[name]) for name in kind._fields))


def _flat(value: Any) -> Any:
    return np.array(value, dtype=float) if isinstance(value, tuple) else float(value)
