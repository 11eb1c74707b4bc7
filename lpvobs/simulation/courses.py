"""How much of an effect is there as a drive goes on: all of it, now and then, more and more, or after what the engine does."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import exp, expm1, isfinite
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.errors import UsageError
from lpvobs.records import Array

KEYS: Mapping[str, tuple[str, ...]] = {
    "always": (),
    "step": ("onset",),
    "interval": ("onset", "end"),
    "intermittent": ("intervals",),
    "ramp": ("onset", "end"),
    "saturating": ("onset", "time_constant"),
    "hysteresis": ("input", "low", "high"),
    "lagged": ("input", "from", "to", "time_constant"),
}
"""What each course needs; a ramp without `end` reaches the whole at the end of the drive."""
GRADED = ("ramp", "saturating", "lagged")  # courses in which a part of the effect is there


@dataclass(frozen=True)
class EffectCourse:
    """The course of an effect, by default there from onset to end; raises UsageError for one that cannot be meant."""

    name: str
    intervals: tuple[tuple[float, float], ...] = ()  # [s] of the log
    time_constant: float = 0.0  # [s]
    input: str = ""  # n_e, u_delta or what the road has, in the log's unit
    low: float = 0.0  # of the input: hysteresis ends below, lagged is nothing here
    high: float = 1.0  # of the input: hysteresis begins above, lagged is the whole here
    # (M,) [s] and the share then, where it follows an input of the drive
    drive: tuple[Array, Array] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if self.name not in KEYS:
            raise UsageError(f"course = '{self.name}', expected one of {', '.join(KEYS)}")
        if "time_constant" in KEYS[self.name] and not 0.0 < self.time_constant < float("inf"):
            raise UsageError(
                f"course {self.name}: time_constant = {self.time_constant:g} s, expected a number above zero"
            )
        if self.input and not (isfinite(self.low) and isfinite(self.high) and self.low != self.high):
            raise UsageError(
                f"course {self.name}: the limits are {self.low:g} and {self.high:g}, expected two different numbers"
            )
        if self.name == "hysteresis" and self.low > self.high:
            raise UsageError(f"course hysteresis: low = {self.low:g} lies above high = {self.high:g}; swap them")
        if self.name == "intermittent" and not self.intervals:
            raise UsageError(
                "course intermittent: the key 'intervals' is missing or empty; write intervals = [[60.0, 90.0], [150.0, 210.0]]"
            )
        for start, stop in self.intervals:
            check_span("course intermittent", start, stop)
        if any(after[0] < before[1] for before, after in pairwise(self.intervals)):
            raise UsageError(
                "course intermittent: the intervals overlap or are not in order of time; sort and separate them"
            )

    def along(self, time: Array, inputs: Mapping[str, Array]) -> "EffectCourse":
        """Return the course on a drive whose inputs, shape (M,), are known at given times [s]."""
        if not self.input:
            return self
        if self.input not in inputs:
            raise UsageError(
                f"course {self.name}: this drive has no input '{self.input}'; expected one of {', '.join(inputs)}"
            )
        values = np.asarray(inputs[self.input], dtype=float)
        if self.name == "hysteresis":
            share = relay(values, self.low, self.high)
        else:
            step = float(time[1] - time[0]) if time.size > 1 else 1.0
            state = lagged(values, step, self.time_constant)
            share = np.clip((state - self.low) / (self.high - self.low), 0.0, 1.0)
        return replace(self, drive=(time, share))

    def share(self, time: Array, onset: float | None, end: float | None) -> Array:
        """Return the share of the effect that is there at given times [s], shape (N,), from 0 to 1."""
        if self.name == "ramp" and end is not None:
            start = onset or 0.0
            return np.clip((time - start) / (end - start), 0.0, 1.0)
        if self.name == "intermittent":
            return np.sum([span_at_work(*each, time) for each in self.intervals], axis=0).astype(float)
        at_work = span_at_work(onset, end, time)
        if self.name == "saturating":
            return np.where(at_work, -np.expm1(-np.maximum(time - (onset or 0.0), 0.0) / self.time_constant), 0.0)
        if self.drive is None:
            return at_work.astype(float)
        moments, shares = self.drive
        if self.name == "hysteresis":
            found = shares[np.clip(np.searchsorted(moments, time + 1e-9, side="right") - 1, 0, shares.size - 1)]
        else:
            found = np.interp(time, moments, shares)
        return np.where(at_work, found, 0.0)


@dataclass(frozen=True, kw_only=True)
class Timed:
    """What is not there for the whole of a drive."""

    onset: float | None = None  # [s] of the log: at work in onset <= time < end
    end: float | None = None  # [s]; without them from the first to the last sample
    course: EffectCourse = EffectCourse("always")  # how much of it is there from onset to end

    def along(self, time: Array, inputs: Mapping[str, Array]) -> Self:
        """Return the same on a drive whose inputs, shape (M,), are known at given times [s]."""
        last = float(time[-1]) if self.course.name == "ramp" and self.end is None else self.end
        return replace(self, end=last, course=self.course.along(time, inputs))

    def share(self, time: Array) -> Array:
        """Return the share that is there at given times [s], shape (N,), from 0 to 1."""
        return self.course.share(time, self.onset, self.end)

    def at(self, time: Array) -> NDArray[np.bool_]:
        """Return when it is at work, shape (N,)."""
        return np.asarray(self.share(time) > 0.0)


def relay(values: Array, low: float, high: float) -> Array:
    """Return one from where values, shape (M,), rise above `high` until they fall below `low`, else zero."""
    decides = np.where((values > high) | (values < low), np.arange(values.size), 0)
    return np.where(values[np.maximum.accumulate(decides)] > high, 1.0, 0.0)


def lagged(W: Array, step: float, tau: float) -> Array:
    """Return y of tau dy/dt = W - y, shape (M,), from rest: exact for a W that runs straight between its samples."""
    left = exp(-step / tau)
    mean = tau / step * -expm1(-step / tau)
    if W.size == 0:
        return W
    return np.asarray(_lagged(W, 1.0 - mean, mean - left, left, mean * W[0]))


@njit(cache=True)
def _lagged(W: Array, now: float, past: float, left: float, held: float) -> Array:
    y = np.empty(W.size)
    for k in range(W.size):
        y[k] = now * W[k] + held
        held = past * W[k] + left * y[k]
    return y


def blended(before: Array, changed: Array, share: Array) -> Array:
    """Return values of which a share has changed, each of shape (N,); the very bits where nothing or all of it has."""
    part = before + share * (changed - before)
    return np.where(share >= 1.0, changed, np.where(share > 0.0, part, before))


def check_span(name: str, onset: float | None, end: float | None) -> None:
    """Refuse a span of time that is empty, negative or not finite."""
    for word, moment in (("onset", onset), ("end", end)):
        if moment is not None and not (isfinite(moment) and moment >= 0.0):
            raise UsageError(f"{name}: {word} = {moment:g}, expected seconds since the start of the log, zero or more")
    if end is not None and end <= (onset or 0.0):
        raise UsageError(f"{name}: end = {end:g} s is not after onset = {onset or 0.0:g} s; correct one of them")


def span_at_work(onset: float | None, end: float | None, time: Array) -> NDArray[np.bool_]:
    """Return whether each time [s] lies in onset <= time < end, shape (N,); an open side reaches to the log's."""
    after = end if end is not None else np.inf
    # a sample's time may miss the number that a person wrote by a rounding
    return np.asarray((time >= (onset or 0.0) - 1e-9) & (time < after - 1e-9))
