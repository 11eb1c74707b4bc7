"""What an effect follows that is no single number: a course over time, or a curve over a channel or the inputs of a component.

A course says how much of an effect is there at each moment, beyond from an onset to an end. It is a share from none to all: it
grows along a straight line (`ramp`) or towards a limit (`saturating`), comes and goes (`intermittent`), is there while an input has
been above one value and not yet below another (`hysteresis`), or follows the first-order state of an input (`lagged`).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Annotated

import numpy as np

from lpvobs.compiled import njit
from lpvobs.discovery.thresholds import COST
from lpvobs.engines.curves import on_surface, values_at
from lpvobs.engines.effects import Change, Effect
from lpvobs.records import Array, Item

GRADED = ("ramp", "saturating", "lagged")  # courses that are not all or nothing


@dataclass(frozen=True)
class TracedCourse:
    """One course; times are of the clock, or of its log's own axis once it is stored."""

    name: str
    begin: float = -np.inf  # [s] of a ramp, or of what saturates
    end: float = np.inf  # [s] of a ramp
    time_constant: float = 0.0  # [s] of what saturates, or lags behind its input
    input: str = ""  # a channel
    # of the input: a hysteresis ends below the first and begins above the second; of its state: nothing, and all of the effect
    low: float = 0.0
    high: float = 0.0
    intervals: tuple[tuple[float, float], ...] = ()  # [s]
    spread: float = 0.0  # of the input, or its state, on the logs that it was found on

    @property
    def ends(self) -> int:
        """The number of its instants that were sought."""
        return int(np.isfinite(self.begin)) + int(np.isfinite(self.end)) + 2 * len(self.intervals)

    @property
    def changes(self) -> int:
        """The number of parameters that were sought, the kind of course among them."""
        return self.ends + {"ramp": 1, "saturating": 2, "intermittent": 0}.get(self.name, 3)

    @property
    def in_time(self) -> bool:
        """Whether it belongs to one log, and not to what the engine does."""
        return not self.input

    def shifted(self, by: float) -> "TracedCourse":
        """Return the course on a time axis whose values are larger."""
        moved = tuple((a + by, b + by) for a, b in self.intervals)
        return replace(self, begin=self.begin + by, end=self.end + by, intervals=moved)

    def share(self, time: Array, channel: Callable[[str], Array], last: float) -> Array:
        """Return the share at times that rise, shape (n,); `last` is the end of the log."""
        if self.name == "ramp":
            begin, end = max(self.begin, float(time[0])), min(self.end, last)
            return np.clip((time - begin) / (end - begin), 0.0, 1.0)
        if self.name == "saturating":
            since = np.maximum(time - max(self.begin, float(time[0])), 0.0)
            return np.asarray(-np.expm1(-since / self.time_constant))
        if self.name == "intermittent":
            return np.asarray(np.any([(time >= a) & (time < b) for a, b in self.intervals], axis=0).astype(float))
        x = channel(self.input)
        if self.name == "hysteresis":
            return np.asarray(relay(x, self.low, self.high))
        return self.of_state(state(time, x, self.time_constant))

    def of_state(self, response: Array) -> Array:
        """Return the share of what follows a state, whose values are given."""
        return np.clip((response - self.low) / (self.high - self.low), 0.0, 1.0)


def course_name(course: TracedCourse | None, begin: float, end: float) -> str:
    """Return the name of a course, or of an effect that is all there from its begin to its end."""
    plain = "interval" if np.isfinite(end) else "step" if np.isfinite(begin) else "always"
    return plain if course is None else course.name


def on_course(effect: Effect, share: Array) -> Effect:
    """Return an effect of which a share is there, column by column; its parameter is that of the whole."""

    def in_part(apply: Change) -> Change:
        return lambda s, size: apply(s, effect.null + (size - effect.null) * share)

    inside = effect.inside
    if inside is not None:
        change = inside.change
        inside = replace(inside, change=lambda value: in_part(change(value)))
    return replace(effect, apply=in_part(effect.apply), inside=inside)


def can_be_graded(effect: Effect) -> bool:
    """Return whether an effect can be there in part: a sensor has one lag or dead time, and a drift is a course of its own."""
    return not effect.id.endswith((".lag", ".delay", ".drift"))


@njit(cache=True)
def relay(x, low, high):  # type: ignore[no-untyped-def]
    """Return one from where x rises above `high` to where it falls below `low`, shape (n,)."""
    out, on = np.zeros(x.size), False
    for k in range(x.size):
        on = x[k] > high or (on and x[k] >= low)
        out[k] = 1.0 if on else 0.0
    return out


@njit(cache=True)
def state(time, x, tau):  # type: ignore[no-untyped-def]
    """Return the first-order response to x, which is at rest in the beginning, shape (n,)."""
    out = np.empty(x.size)
    out[0] = x[0]
    for k in range(1, x.size):
        out[k] = x[k] + (out[k - 1] - x[k]) * np.exp(-(time[k] - time[k - 1]) / tau)
    return out


def in_time(begins: Array, least: int, time_constants: Array) -> Iterator[TracedCourse]:
    """Yield ramps and what saturates, from each of some moments [s]; `least` of them lie before an end."""
    for i, begin in enumerate(begins[:-least]):
        first = -np.inf if i == 0 else float(begin)
        yield TracedCourse("ramp", begin=first)
        yield from (TracedCourse("ramp", begin=first, end=float(end)) for end in begins[i + least :: 4 * least])
        yield from (TracedCourse("saturating", begin=first, time_constant=float(tau)) for tau in time_constants)


def hystereses(inputs: Mapping[str, Array], levels: tuple[float, ...]) -> Iterator[TracedCourse]:
    """Yield a hysteresis between any two levels of every input, which are quantiles."""
    for name, x in inputs.items():
        values = np.quantile(x, levels)
        spread = float(values[-1] - values[0])
        for i, low in enumerate(values):
            yield from (
                TracedCourse("hysteresis", input=name, low=float(low), high=float(high), spread=spread)
                for high in values[i:]
            )


def lags(name: str, response: Array, tau: float) -> Iterator[TracedCourse]:
    """Yield courses that follow the state of an input, rising from some of its values on, and falling."""
    low, high = float(response.min()), float(response.max())
    if high > low:
        for begin in np.linspace(low, high, 4, endpoint=False):
            yield TracedCourse("lagged", time_constant=tau, input=name, low=float(begin), high=high, spread=high - low)
        yield TracedCourse("lagged", time_constant=tau, input=name, low=high, high=low, spread=high - low)


def near(course: TracedCourse, step: float) -> Iterator[TracedCourse]:
    """Yield courses around one that follows an input: its values moved by parts of the input's spread, and its time constant."""
    parts = np.array((-2.0, -1.0, 0.0, 1.0, 2.0)) * step
    times = 2.0**parts if course.time_constant else (1.0,)
    for a, b, c in product(parts, parts, times):
        low, high = course.low + a * course.spread, course.high + b * course.spread
        if low <= high or course.high < course.low:
            yield replace(course, low=float(low), high=float(high), time_constant=float(c * course.time_constant))


@dataclass(frozen=True)
class Curve:
    """A dependence on a channel, straight between knots.

    It is of the channel's `value` or `rate`; `carrier` is the effect whose size follows it. The deviation is zero on the
    average of the logs; for a switch and a frozen map it is zero where the switch is off.
    """

    channel: str
    of: str
    carrier: str
    knots: Annotated[Array, Item("1", "value of the channel in the log's unit, or its rate per second", name="knot")]
    values: Annotated[Array, Item("1", "change of the carrier effect's size at amplitude one", ("knot",), "deviation")]

    @property
    def cost(self) -> float:
        """What its coefficients must gain."""
        return COST * (self.knots.size - 1)


@dataclass(frozen=True)
class FactorSurface:
    """A factor on a component over two of its inputs, between nodes."""

    inputs: tuple[str, str]
    units: tuple[str, str]
    first: Annotated[Array, Item("SI", "first input, in the first unit of `units`", name="first")]
    second: Annotated[Array, Item("SI", "second input, in the second unit of `units`", name="second")]
    values: Annotated[
        Array, Item("1", "factor of the component minus one, at amplitude one", ("first", "second"), "deviation")
    ]
    errors: Annotated[Array, Item("1", "standard error of the factor", ("first", "second"), "standard_error")]
    largest: tuple[float, float]  # where on the logs it is largest, and one at amplitude one
    amplitude: float  # the factor less one there, when it was found
    cost: float  # what its coefficients must gain
    single: bool  # whether it follows its first input alone

    @cached_property
    def error(self) -> float:
        """Standard error of the factor where it is largest."""
        there = (np.array([x]) for x in self.largest)
        return float(values_at(on_surface(self.first, self.second, *there), self.errors)[0])


Shape = Curve | FactorSurface
