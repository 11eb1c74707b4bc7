"""The effects that a simulation can be given: the catalogue by identifier, and each as a frozen value.

What an effect does to the engine stands in `simulate.py`, what it does to a sensor in `readings.py`.
"""

import csv
import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from math import isfinite, isnan
from typing import Any

from lpvobs.errors import UsageError
from lpvobs.simulation.courses import GRADED, KEYS, EffectCourse, Timed, check_span


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
            raise UsageError(
                f"{self.id}: {kind.parameter} = {self.value:g} {kind.unit}, expected {kind.low:g} to {kind.high:g}; "
                f"check its unit"
            )
        check_span(self.id, self.onset, self.end)
        if self.bump and not (kind.bump and all(map(isfinite, self.bump)) and self.bump[1] > 0.0):
            raise UsageError(
                f"{self.id}: the keys centre and width are for curves only, and the width must be above zero; "
                f"correct or delete both keys"
            )
        if self.id.endswith((".lag", ".delay")) and self.course.name in GRADED:
            raise UsageError(
                f"{self.id}: this effect is either on or off and cannot grow, as course {self.course.name} would need; "
                f"choose one of the courses {', '.join(name for name in KEYS if name not in GRADED)}"
            )

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
        sensor = identifier.partition(".")[0]
        raise UsageError(
            f"{identifier}: the simulated diesel has no {sensor}; only the throttled engine has one; delete this effect"
        )
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
            raise UsageError(
                f"{self.name}: {key} is not a list of pairs of seconds; write [[60.0, 90.0], [150.0, 210.0]]"
            )
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
        low, high = ("low", "high") if course == "hysteresis" else ("from", "to")
        lasting, lower = self.optional("time_constant") or 0.0, self.optional(low) or 0.0
        upper = 1.0 if high not in self.table else self.number(high)
        follows = str(self.table.get("input", ""))
        found = EffectCourse(course, self.pairs("intervals"), lasting, follows, lower, upper)
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
