"""Numbers that remember with what they are compared, for one run that records; nothing of the package knows them.

A threshold T enters expressions such as `gain > T * log(n)` or `score - T < 0`. A watched number carries, beside its value v, the
slope d = T dv/dT, through sums, products, quotients and roots. A comparison of v with b then turns when T is multiplied by

    f = 1 + (b - v) / d,

exactly where v is affine in T. What is recorded of T is how many decisions it took, how many of them a factor between a half and
two would turn, and the smallest change of T up and down that would turn one. Where a number leaves this arithmetic (it sizes an
array, it becomes a plain float), it counts as a setting: it decides in ways that nobody sees.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from numbers import Rational
from typing import Any

import numpy as np
from numba import types
from numba.extending import typeof_impl
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

Array = NDArray[np.float64]
NEAR = 2.0
"""Factor on a threshold that is still near."""
COMPARISONS = (np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal)
LIMITS = (np.maximum, np.minimum, np.fmax, np.fmin)


@dataclass
class Record:
    """What was seen of one threshold."""

    decisions: int = 0
    near: int = 0
    raised: float = np.inf  # smallest factor above one that turns a decision
    lowered: float = np.inf  # smallest divisor above one that turns a decision
    settings: int = 0

    @property
    def nearest(self) -> float:
        """Smallest change either way that turns a decision, two as good as a half."""
        return min(self.raised, self.lowered)


@dataclass
class Recorder:
    """What was seen, by threshold."""

    seen: dict[str, Record] = field(default_factory=dict)

    def of(self, name: str) -> Record:
        """Return the record of a threshold."""
        return self.seen.setdefault(name, Record())

    def decided(self, a: "Dual", b: "Dual") -> None:
        """Note a comparison of two numbers or arrays, either of which may hang on thresholds."""
        for name in a.slopes | b.slopes:
            slope = np.subtract(a.slopes.get(name, 0.0), b.slopes.get(name, 0.0))
            with np.errstate(all="ignore"):
                factor = np.ravel(1.0 + (np.asarray(b.value, float) - a.value) / slope)
                factor = factor[np.isfinite(factor)]
            record = self.of(name)
            record.decisions += factor.size
            record.near += int(((factor >= 1.0 / NEAR) & (factor <= NEAR)).sum())
            record.raised = min(record.raised, float(factor[factor >= 1.0].min(initial=np.inf)))
            below = factor[(factor > 0.0) & (factor <= 1.0)]
            record.lowered = min(record.lowered, float(1.0 / below.max(initial=1e-300)))

    def escaped(self, names: Mapping[str, Any]) -> None:
        """Note that a threshold went where its decisions are not seen."""
        for name in names:
            self.of(name).settings += 1


RECORDER = Recorder()


@dataclass(frozen=True)
class Dual:
    """A value, and by threshold what a relative change of it changes; arrays of one shape, or numbers."""

    value: Any
    slopes: dict[str, Any]

    @classmethod
    def of(cls, x: Any) -> "Dual":
        """Return a plain or watched number or array as a dual."""
        if isinstance(x, Watched):
            return x.dual
        if isinstance(x, Limits):
            return cls(x.view(np.ndarray), x.slopes)
        return cls(x, {})

    def scaled(self, by: Any) -> dict[str, Any]:
        """Return the slopes times a factor."""
        return {name: slope * by for name, slope in self.slopes.items()}


def _sum(a: dict[str, Any], b: dict[str, Any]) -> dict[str, Any]:
    return {name: a.get(name, 0.0) + b.get(name, 0.0) for name in a | b}


RULES: dict[Any, Callable[..., dict[str, Any]]] = {
    np.add: lambda a, b: _sum(a.slopes, b.slopes),
    np.subtract: lambda a, b: _sum(a.slopes, b.scaled(-1.0)),
    np.multiply: lambda a, b: _sum(a.scaled(b.value), b.scaled(a.value)),
    np.true_divide: lambda a, b: _sum(a.scaled(1.0 / b.value), b.scaled(-a.value / b.value**2)),
    np.negative: lambda a: a.scaled(-1.0),
    np.positive: lambda a: a.slopes,
    np.absolute: lambda a: a.scaled(np.sign(a.value)),
    np.sqrt: lambda a: a.scaled(0.5 / np.sqrt(a.value)),
    np.square: lambda a: a.scaled(2.0 * a.value),
}
"""Slopes of a result, from those of its arguments."""


def combined(ufunc: Any, method: str, inputs: tuple[Any, ...], options: dict[str, Any]) -> Any:
    """Return what NumPy says of plain values, noting decisions and carrying slopes on."""
    duals = [Dual.of(x) for x in inputs]
    if options.get("out"):
        into = tuple(x.view(np.ndarray) if isinstance(x, Limits) else x for x in options.pop("out"))
        options |= {} if isinstance(into[0], Watched) else {"out": into}  # a number in place is a new number
    plain = getattr(ufunc, method)(*(dual.value for dual in duals), **options)
    names = {name: 1 for dual in duals for name in dual.slopes}
    if not names:
        return plain
    if method == "__call__" and ufunc in COMPARISONS + LIMITS:
        RECORDER.decided(*duals)
        return plain
    if method == "__call__" and ufunc.__name__ == "clip":
        for bound in duals[1:]:
            RECORDER.decided(duals[0], bound)
        return plain
    if method != "__call__" or ufunc not in RULES or options.get("out"):
        RECORDER.escaped(names)
        return plain
    with np.errstate(all="ignore"):
        slopes = RULES[ufunc](*duals)
    if np.ndim(plain) == 0:
        return number(plain, slopes)
    return Limits.made(plain, {name: np.broadcast_to(slope, plain.shape) for name, slope in slopes.items()})


class Watched(NDArrayOperatorsMixin):
    """A number that hangs on thresholds."""

    def __init__(self, dual: Dual) -> None:
        self.dual = dual

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Compute with values, see `combined`."""
        return combined(ufunc, method, inputs, options)

    def _plain(self) -> Any:
        RECORDER.escaped(self.dual.slopes)
        return self.dual.value

    def __float__(self) -> float:
        """Return the value: what becomes of it is not seen."""
        return float(self._plain())

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """Return the value as an array of no dimension."""
        return np.asarray(self._plain(), dtype)

    def __bool__(self) -> bool:
        """Return whether the value is not zero."""
        return bool(self.dual.value)

    def __hash__(self) -> int:
        """Return the hash of the value."""
        return hash(self.dual.value)

    def __format__(self, spec: str) -> str:
        """Return the value for people."""
        return format(self.dual.value, spec)

    def item(self) -> Any:
        """Return the value as plain Python has it, as NumPy's own numbers do."""
        return self._plain()

    def __int__(self) -> int:
        """Return the value as a whole number."""
        return int(self._plain())

    def __round__(self, digits: int | None = None) -> Any:
        """Return the value, rounded."""
        return round(self._plain(), digits)

    @property
    def numerator(self) -> int:
        """Numerator of the value: exact arithmetic takes it."""
        return int(float(self).as_integer_ratio()[0])

    @property
    def denominator(self) -> int:
        """Denominator of the value."""
        return int(float(self).as_integer_ratio()[1])


Rational.register(Watched)


class Count(Watched):
    """A whole number that hangs on thresholds: it also counts, and points into arrays."""

    def __index__(self) -> int:
        """Return the value."""
        return int(self._plain())


class Limits(np.ndarray[Any, Any]):
    """An array that hangs on thresholds; a part or a view of it no longer does."""

    slopes: dict[str, Any]

    @classmethod
    def made(cls, values: Array, slopes: dict[str, Any]) -> "Limits":
        """Return values with their slopes."""
        out = values.view(cls)
        out.slopes = slopes
        return out

    def __array_finalize__(self, _: object) -> None:
        """Forget the slopes, which have the shape of another array."""
        self.slopes = {}

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Compute with values, see `combined`."""
        return combined(ufunc, method, inputs, options)


@typeof_impl.register(Watched)
def _compiled_number(_: Watched, __: object) -> types.Float:
    """Compiled functions take the value: what becomes of it there is not seen."""
    return types.float64


@typeof_impl.register(Count)
def _compiled_count(_: Count, __: object) -> types.Integer:
    return types.int64


@typeof_impl.register(Limits)
def _compiled_array(array: Limits, context: object) -> types.Array:
    return typeof_impl(array.view(np.ndarray), context)


def number(value: Any, slopes: dict[str, Any]) -> Watched:
    """Return a number with its slopes."""
    kind = Count if isinstance(value, (int, np.integer)) else Watched
    return kind(Dual(value, slopes))


def watched(name: str, value: float | int) -> Watched:
    """Return a threshold that is recorded under its name."""
    return number(value, {name: float(value)})
