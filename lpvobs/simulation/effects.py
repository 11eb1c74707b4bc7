"""The effects that a simulation can be given: the catalogue by identifier, each as a frozen value, and its course over a drive.

What an effect does to the engine stands in `simulate.py`, what it does to a sensor in `readings.py`.
"""

import csv
import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from itertools import pairwise
from math import inf, isfinite, isnan
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.simulation.instruments import lagged

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
EXAMPLE = "[[60.0, 90.0], [150.0, 210.0]]"
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
        course, tau, low, high = f"course {self.name}", self.time_constant, self.low, self.high
        if "time_constant" in KEYS[self.name] and not 0.0 < tau < inf:
            raise UsageError(f"{course}: time_constant = {tau:g} s, expected a number above zero")
        if self.input and not (isfinite(low) and isfinite(high) and low != high):
            raise UsageError(f"{course}: the limits are {low:g} and {high:g}, expected two different numbers")
        if self.name == "hysteresis" and low > high:
            raise UsageError(f"{course}: low = {low:g} lies above high = {high:g}; swap them")
        if self.name == "intermittent" and not self.intervals:
            raise UsageError(f"{course}: the key 'intervals' is missing or empty; write intervals = {EXAMPLE}")
        for start, stop in self.intervals:
            check_span(course, start, stop)
        if any(after[0] < before[1] for before, after in pairwise(self.intervals)):
            raise UsageError(f"{course}: the intervals overlap or are not in order of time; sort and separate them")

    def along(self, time: Array, inputs: Mapping[str, Array]) -> "EffectCourse":
        """Return the course on a drive whose inputs, shape (M,), are known at given times [s]."""
        if not self.input:
            return self
        if (values := inputs.get(self.input)) is None:
            known = ", ".join(inputs)
            raise UsageError(f"course {self.name}: this drive has no input '{self.input}'; expected one of {known}")
        if self.name == "hysteresis":
            return replace(self, drive=(time, relay(values, self.low, self.high)))
        state = lagged(values, float(time[1] - time[0]) if time.size > 1 else 1.0, self.time_constant)
        return replace(self, drive=(time, np.clip((state - self.low) / (self.high - self.low), 0.0, 1.0)))

    def share(self, time: Array, onset: float | None, end: float | None) -> Array:
        """Return the share of the effect that is there at given times [s], shape (N,), from 0 to 1."""
        begin, at_work = onset or 0.0, span_at_work(onset, end, time)
        if self.name == "ramp" and end is not None:
            return np.clip((time - begin) / (end - begin), 0.0, 1.0)
        if self.name == "intermittent":
            return np.sum([span_at_work(*each, time) for each in self.intervals], axis=0).astype(float)
        if self.name == "saturating":
            return np.where(at_work, -np.expm1(-np.maximum(time - begin, 0.0) / self.time_constant), 0.0)
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
    """What need not be there for the whole of a drive."""

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


@dataclass(frozen=True)
class Kind:
    """An entry of the catalogue: its parameter, and what a user may mean by it."""

    place: str  # `plant`: the engine itself changes. `maf`: the air flow sensor. `sensor`: another one.
    parameter: str
    unit: str
    neutral: float  # the value that changes nothing
    low: float  # a value below is a slip of the pen or of the unit
    high: float  # as is one above
    bump: tuple[float, ...] = ()  # usual centre and width of a curve, in the unit of the component's input


def _catalogue() -> dict[str, Kind]:
    """Return what `effects.csv` beside this file lists."""
    lines = files("lpvobs.simulation").joinpath("effects.csv").read_text(encoding="utf-8").splitlines()
    found = {}
    for row in csv.DictReader(line for line in lines if not line.startswith("#")):
        neutral, low, high = (float(row[key]) for key in ("neutral", "low", "high"))
        bump = tuple(float(row[key]) for key in ("centre", "width") if row[key])
        found[row["id"]] = Kind(row["place"], row["parameter"], row["unit"], neutral, low, high, bump)
    return found


CATALOGUE = _catalogue()
OTHER_ENGINE = ("p_ic.gain", "p_ic.offset", "alpha_th.offset")
"""Identifiers of the contract that need the throttled engine's sensors."""

OUTSIDE = ("channel:NAME", "unlogged")  # how effects files call what stands in `disturbances.py`


@dataclass(frozen=True)
class CatalogueEffect(Timed):
    """One entry of the catalogue at work.

    Raises UsageError for an identifier, value or span of time that cannot be meant.

    Examples
    --------
    >>> CatalogueEffect("maf.lag", 0.08, onset=300.0).kind.parameter
    'tau'
    """

    id: str  # identifier of the catalogue
    value: float  # of its parameter, in the catalogue's unit
    bump: tuple[float, ...] = ()  # centre and width of a curve, in the unit of its input; the usual ones unless given

    def __post_init__(self) -> None:
        kind = kind_of(self.id)
        if not kind.low <= self.value <= kind.high:
            said = f"{self.id}: {kind.parameter} = {self.value:g} {kind.unit}"
            raise UsageError(f"{said}, expected {kind.low:g} to {kind.high:g}; check its unit")
        check_span(self.id, self.onset, self.end)
        if self.bump and not (kind.bump and all(map(isfinite, self.bump)) and self.bump[1] > 0.0):
            raise UsageError(
                f"{self.id}: keys centre and width are for curves only, and the width must be above zero; correct or delete both"
            )
        if self.id.endswith((".lag", ".delay")) and self.course.name in GRADED:
            others = ", ".join(name for name in KEYS if name not in GRADED)
            said = f"{self.id}: this effect is either on or off, and cannot grow as course {self.course.name} needs"
            raise UsageError(f"{said}; choose one of the courses {others}")

    @property
    def kind(self) -> Kind:
        """The entry of the catalogue."""
        return CATALOGUE[self.id]

    @property
    def acts(self) -> bool:
        """Whether the value changes anything."""
        return self.value != self.kind.neutral


def kind_of(identifier: str) -> Kind:
    """Return the catalogue's entry, or say what is wrong with the identifier."""
    if identifier in CATALOGUE:
        return CATALOGUE[identifier]
    if identifier in OTHER_ENGINE:
        lacks = f"the simulated diesel has no {identifier.partition('.')[0]}"
        raise UsageError(f"{identifier}: {lacks}; only the throttled engine has one; delete this effect")
    known = (*CATALOGUE, *OUTSIDE)
    near = difflib.get_close_matches(identifier, known, n=1, cutoff=0.4)
    hint = f"did you mean '{near[0]}'?" if near else f"expected one of {', '.join(known)}"
    raise UsageError(f"{identifier}: unknown effect; {hint}")


@dataclass(frozen=True)
class Entry:
    """A table of an effects file, read strictly: raises UsageError for a key that is missing, unknown, or cannot be meant."""

    name: str  # how messages call it
    table: Mapping[str, Any]

    def refuse_others(self, *known: str) -> None:
        """Refuse the first key that does not belong to this effect."""
        for key in self.table:
            if key not in known:
                raise UsageError(f"{self.name}: unknown key '{key}'; expected {', '.join(known)}")

    def number(self, key: str) -> float:
        """Return a number that has to be there."""
        value = self.optional(key)
        if value is None:
            raise UsageError(f"{self.name}: parameter '{key}' is missing; give it a number")
        return value

    def optional(self, key: str) -> float | None:
        """Return a number, or None where the table does not have the key."""
        value = self.table.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or isnan(value):
            raise UsageError(f"{self.name}: {key} = {value!r}, expected a number")
        return float(value)

    def text(self, key: str) -> str:
        """Return a text that has to be there."""
        value = self.table.get(key)
        if not isinstance(value, str):
            raise UsageError(f"{self.name}: key '{key}' is missing or its value is not a text in quotes")
        return value

    def pairs(self, key: str) -> tuple[tuple[float, float], ...]:
        """Return a list of pairs of seconds, an empty one where the table does not have the key."""
        rows = self.table.get(key, [])
        pairs = rows if isinstance(rows, list) else [rows]
        if not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
            raise UsageError(f"{self.name}: {key} is not a list of pairs of seconds; write {EXAMPLE}")
        spans = [Entry(self.name, {"start": start, "stop": stop}) for start, stop in pairs]
        return tuple((span.number("start"), span.number("stop")) for span in spans)

    def course_keys(self) -> tuple[str, ...]:
        """Return the keys that the table may have for its course."""
        return ("course", "onset", "end", *KEYS.get(str(self.table.get("course")), ()))

    def timed(self) -> dict[str, Any]:
        """Return the fields of `Timed`, the course by default that of what is always there."""
        onset, end, course = self.optional("onset"), self.optional("end"), self.table.get("course", "always")
        if course not in KEYS:
            raise UsageError(f"{self.name}: course = {course!r}, expected one of {', '.join(KEYS)}")
        for key in KEYS[course]:
            if key not in self.table and (course, key) != ("ramp", "end"):
                raise UsageError(f"{self.name}: course {course} needs the key '{key}'; add it")
        lasting, follows = self.optional("time_constant") or 0.0, str(self.table.get("input", ""))
        low, high = (self.number(key) for key in KEYS[course][1:3]) if "input" in KEYS[course] else (0.0, 1.0)
        found = EffectCourse(course, self.pairs("intervals"), lasting, follows, low, high)
        return {"onset": onset, "end": end, "course": found}


def effect_of(table: Mapping[str, Any]) -> CatalogueEffect:
    """Return the effect of one `[[effect]]` table; raises UsageError for what is missing, unknown, or cannot be meant."""
    if not isinstance(table.get("id"), str):
        raise UsageError("key 'id' is missing or its value is not a text; write, for example, id = \"maf.lag\"")
    kind = kind_of(table["id"])
    usual = dict(zip(("centre", "width"), kind.bump, strict=False))
    entry = Entry(table["id"], {**usual, **table})
    entry.refuse_others("id", kind.parameter, *usual, *entry.course_keys())
    bump = tuple(entry.number(key) for key in usual)
    return CatalogueEffect(entry.name, entry.number(kind.parameter), bump, **entry.timed())
