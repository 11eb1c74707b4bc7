"""Channels that a profile computes from others: a small arithmetic on numbers whose kind of unit is checked. No code is run.

A name stands for the number of a channel in the unit that the profile gives it, of an earlier computed one, or of a constant; the
result is a number in the unit stated. Kinds must agree: what is added has one unit, what comes out has the kind of that unit.
Cycles, strokes and turns are counts, so mg/cycle times rpm is mg per time; how many make one is a number in the formula.
"""

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvobs.io.logs.units import unit_of
from lpvobs.records import Array

if TYPE_CHECKING:
    from pint import Unit

LONGEST = 300
EXPECTED = "names, numbers, + - * / and brackets"
OPERATIONS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


@dataclass(frozen=True)
class Computed:
    """One channel of the profile's `[computed]`."""

    formula: str  # + - * / ( ) on names of channels and constants, and numbers
    unit: str  # of the result, in the log
    # by name: a number and its unit, such as "12.5 mg/cycle/ms"
    constants: Mapping[str, str] = field(default_factory=dict)
    meaning: str = ""  # for people

    def constant(self, name: str) -> tuple[float, str]:
        """Return the number and the unit of a constant; raises ValueError where it has none."""
        number, _, unit = self.constants[name].partition(" ")
        return float(number), unit.strip() or "1"

    def checked(self, units: Mapping[str, str]) -> None:
        """Raise ValueError unless the formula can be computed from channels with these units and gives the unit stated."""
        known = dict(units) | {name: self.constant(name)[1] for name in self.constants}
        found = _kind(_tree(self.formula), {name: unit_of(unit) for name, unit in known.items()})
        if found is not None and _counted(found) != _counted(unit_of(self.unit)):
            raise ValueError(
                f"formula '{self.formula}' has the unit {found:~}, expected a unit that converts to {self.unit}; "
                "correct the formula or the unit"
            )

    def values(self, channels: Mapping[str, Array]) -> Array:
        """Return the result at the samples of the channels; not finite is NaN."""
        known = dict(channels) | {name: self.constant(name)[0] for name in self.constants}
        with np.errstate(all="ignore"):
            found = np.asarray(_value(_tree(self.formula), known), dtype=float)
        size = next(iter(channels.values())).size
        return np.where(np.isfinite(found), found, np.nan) * np.ones(size)


def _tree(formula: str) -> ast.expr:
    if (letters := len(formula)) > LONGEST:
        raise ValueError(
            f"the formula has {letters} letters, expected at most {LONGEST}; split it into several computed channels"
        )
    try:
        return ast.parse(formula.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"'{formula}' is not an arithmetic formula; expected {EXPECTED}") from None


def _value(node: ast.expr, known: Mapping[str, Any]) -> Any:
    match node:
        case ast.Constant(value=float() | int() as number):
            return float(number)
        case ast.Name(id=name):
            return known[name]
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_value(inner, known)
        case ast.BinOp(left=left, op=op, right=right):
            return OPERATIONS[type(op)](_value(left, known), _value(right, known))
    raise ValueError(f"'{ast.unparse(node)}' is not arithmetic")


def _kind(node: ast.expr, known: Mapping[str, "Unit"]) -> "Unit | None":
    """Return the unit of a part of a formula, None for a plain number; raises ValueError where units do not fit."""
    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=float() | int()):
            return None
        case ast.Name(id=name) if name in known:
            return known[name]
        case ast.Name(id=name):
            raise ValueError(f"'{name}' is neither a channel nor a constant; known names: {', '.join(known)}")
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return _kind(inner, known)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            one, other = _kind(left, known), _kind(right, known)
            if one is not None and other is not None and (1.0 * one).to_root_units() != (1.0 * other).to_root_units():
                raise ValueError(
                    f"'{ast.unparse(node)}' adds the units {one:~} and {other:~}; give both terms the same unit in the profile"
                )
            return other if one is None else one
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
            one, other = (unit_of("1") if kind is None else kind for kind in (_kind(left, known), _kind(right, known)))
            found: Unit = OPERATIONS[type(op)](one, other)
            return found
    raise ValueError(f"'{ast.unparse(node)}' is not allowed; expected {EXPECTED}")


def _counted(unit: "Unit") -> dict[str, object]:
    return {name: power for name, power in unit.dimensionality.items() if name != "[engine_cycle]"}
