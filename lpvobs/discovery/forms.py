"""Formulas for what has no name: a reading, or a part of the engine, follows a product of signals. A sparse search finds them.

A form says what is off, and what that is proportional to: at most two factors beside the channel itself, each a logged channel, a
ratio of two of one unit, its rate or its first-order lag, less a reference. The product of two may have a reference of its own.
`form:W_maf ~ W_maf * (lag(T_amb, 30 s) - 298 K)` is an identifier, and all that is needed to build the form again, as is
`form:W_maf ~ W_maf * [humidity * (T_amb - 269 K) - 1083 % K]`. Its coefficient is fitted and judged like the size of any effect.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from msgspec import UNSET, UnsetType

from lpvobs.discovery import thresholds
from lpvobs.discovery.courses import state
from lpvobs.discovery.places import averaged
from lpvobs.discovery.residual import Problem, Term
from lpvobs.engines.effects import SENSOR, Effect, Signals, gain, offset
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.errors import DataError
from lpvobs.records import Array, Log

PREFIX = "form:"
CHANNEL = "channel:"
TIME = "time"
NAME = re.compile(r"[A-Za-z_][\w.]*")  # channels with other names take no part: a formula must be readable
FACTOR = re.compile(
    r"(?P<open>\()?(?:d\((?P<rate>[\w./]+)\)/dt|lag\((?P<lag>[\w./]+), (?P<tau>\S+) s\)|(?P<value>[\w./]+))"
    r"(?(open) (?P<sign>[+-]) (?P<reference>[^\s)]+)(?: [^)]+)?\))"
)
PRODUCT = re.compile(r"\[(?P<product>.+) (?P<sign>[+-]) (?P<reference>[^\s\]]+)(?: .+)?\]$")  # less a reference
Recorded = Callable[[str], Array]


@dataclass(frozen=True)
class Factor:
    """One factor: a channel, or a ratio `a/b`, its rate or its lag by `tau` [s], less a reference."""

    signal: str
    of: str = "value"  # `value`, `rate` or `lag`
    tau: float = 0.0  # s
    reference: float = 0.0

    def text(self, units: Mapping[str, str]) -> str:
        """Return it as in an identifier."""
        plain = {"rate": f"d({self.signal})/dt", "lag": f"lag({self.signal}, {self.tau:g} s)"}.get(self.of, self.signal)
        return f"({plain} {_less(self.reference, self.unit(units))})" if self.reference else plain

    def unit(self, units: Mapping[str, str]) -> str:
        """Return the unit of its values."""
        return unit_of(self.signal, units) + ("/s" if self.of == "rate" else "")

    def along(self, recorded: Recorded, time: Array) -> Array:
        """Return its values at rising times of one log [s], averaged over a second."""
        first, _, second = self.signal.partition("/")
        x = recorded(first) / recorded(second) if second else recorded(first)
        step = float(np.median(np.diff(time)))
        x = averaged(x, step)
        if self.of == "rate":
            x = np.gradient(x, time)
        elif self.of == "lag":
            x = state(time, x, self.tau)
        return np.asarray(x - self.reference)


@dataclass(frozen=True)
class Form:
    """What is off, a channel or an effect of the catalogue that changes the engine, and the factors that it is proportional to."""

    target: str
    factors: tuple[Factor, ...] = ()
    reference: float = 0.0  # of the product of all factors but the channel itself

    @cached_property
    def relative(self) -> bool:
        """Whether a reading is off by a share of itself."""
        return Factor(self.target) in self.factors[:1]

    def id(self, units: Mapping[str, str]) -> str:
        """Return the identifier."""
        texts = [factor.text(units) for factor in self.factors]
        if self.reference:
            less = _less(self.reference, self.unit_of_product(units))
            texts = [*texts[: self.relative], f"[{' * '.join(texts[self.relative :])} {less}]"]
        return f"{PREFIX}{self.target} ~ {' * '.join(texts) or '1'}"

    def unit_of_product(self, units: Mapping[str, str]) -> str:
        """Return the unit of the product of its factors, without the reading itself."""
        each = [factor.unit(units) for factor in self.factors[self.relative :]]
        return " ".join(unit for unit in each if unit != "1") or "1"

    @property
    def unknowns(self) -> int:
        """What the data must pay for: the coefficient, every factor, and every reference and lag."""
        own = self.factors[self.relative :]
        return (
            1
            + (self.reference != 0.0)
            + sum(1 + (f.reference != 0.0) + (f.of != "value") + ("/" in f.signal) for f in own)
        )

    def along(self, recorded: Recorded, time: Array) -> Array:
        """Return the product of its factors less its reference, without the reading itself, at rising times of one log, (N,)."""
        each = [f.along(recorded, time) for f in self.factors[self.relative :]]
        return np.asarray(np.prod([np.ones(time.size), *each], axis=0) - self.reference)

    def unit(self, model: ResidualModel) -> str:
        """Return the unit of its coefficient, which makes the product one of the target's unit."""
        catalogued = model.effect(self.target)
        unit = catalogued.unit if catalogued else "1" if self.relative else unit_of(self.target, model.units)
        for factor in self.factors[self.relative :]:
            each = factor.unit(model.units)
            over = each if re.fullmatch(r"\w+", each) else f"({each})"
            unit = "1" if each == unit else unit if each == "1" else f"{unit}/{over}"
        return unit

    def effect(self, model: ResidualModel, shape: Array, size: float) -> Effect:
        """Return it as an effect; `shape`, (C,), is what `along` gives at the columns of the signals, `size` a noticeable one."""
        catalogued = model.effect(self.target)
        if catalogued is not None:
            apply, null, place = catalogued.apply, catalogued.null, catalogued.place
        else:
            apply, null = (gain(self.target), 1.0) if self.relative else (offset(self.target), 0.0)
            place = "sensor" if self.target == SENSOR else self.target

        def change(s: Signals, coefficient: float) -> Signals:
            return apply(s, null + coefficient * shape)

        most = thresholds.FORM_MOST * size
        # A share stays below one anywhere: a reading that is no multiple of the truth divides by zero.
        if self.relative:
            most = thresholds.FORM_SHARE_MOST / max(float(np.abs(shape).max()), 1e-300)
        moving = ", ".join(sorted({factor.signal for factor in self.factors})) or self.target
        return Effect(
            self.id(model.units), "coefficient", self.unit(model), 0.0, size, -most, most, place, change,
            f"drives with changes of {moving} that are independent of the other channels",
            moves_point=self.target in (model.fuel, model.speed), known_as=self._known_as(model),
        )  # fmt: skip

    def _known_as(self, model: ResidualModel) -> tuple[str, ...]:
        own = self.factors[self.relative :]
        carrier = carrier_of(model, self.relative)
        return shape_of(carrier, own[0]) if carrier and len(own) == 1 and self.target == SENSOR else ()


def carrier_of(model: ResidualModel, relative: bool) -> Effect | None:
    """Return the effect by which the reading is off by a share of itself, or by a constant; None where none is listed."""
    parameter = "factor" if relative else "offset"
    return next((e for e in model.catalogue if e.place == "sensor" and e.parameter == parameter), None)


def shape_of(carrier: Effect, factor: Factor) -> tuple[str, str]:
    """Return the names of what healthy drives tell of an effect whose size follows a factor: itself, and that shape beside it."""
    tau = min(thresholds.FORM_LAGS, key=lambda tau: abs(np.log(tau / factor.tau))) if factor.of == "lag" else 0.0
    return carrier.id, f"{carrier.id} ~ {replace(factor, tau=tau, reference=0.0).text({})}"


def unit_of(signal: str, units: Mapping[str, str]) -> str:
    """Return the unit of a channel, a ratio or the time; a channel without unit is its own."""
    return "1" if "/" in signal else "s" if signal == TIME else units.get(signal, "") or signal


def in_words(term: Term) -> str | UnsetType:
    """Return a form as a person reads it, `W_maf too high by 0.0021 1/K * W_maf * (T_coolant - 355 K)`, nothing for others."""
    if not term.effect.id.startswith(PREFIX):
        return UNSET
    target, _, product = term.effect.id.removeprefix(PREFIX).partition(" ~ ")
    size = f"{abs(term.size):.3g}" + ("" if term.effect.unit == "1" else f" {term.effect.unit}")
    return f"{target} too {'high' if term.size > 0 else 'low'} by {size}" + ("" if product == "1" else f" * {product}")


def rms(values: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def rounded(value: float, within: float = 0.0) -> str:
    """Return a number with four digits, or as many that it moves by `within` at most; seventeen tell any two numbers apart."""
    texts = (f"{value:.{digits}g}" for digits in range(4, 18))
    return next(text for text in texts if abs(float(text) - value) <= within)


def _less(reference: float, unit: str) -> str:
    """Return the end of what is less a reference, in an identifier."""
    return f"{'-' if reference > 0 else '+'} {rounded(abs(reference))}" + ("" if unit == "1" else f" {unit}")


def _reference(found: re.Match[str]) -> float:
    return float(found["reference"] or 0.0) * (-1.0 if found["sign"] == "+" else 1.0)


def parsed(id_: str) -> Form:
    """Return the form of an identifier."""
    target, _, product = id_.removeprefix(PREFIX).partition(" ~ ")
    whole, factors = PRODUCT.search(product), []
    for found in FACTOR.finditer("" if product == "1" else PRODUCT.sub(r"\g<product>", product)):
        of = next(name for name in ("rate", "lag", "value") if found[name])
        factors.append(Factor(found[of], of, float(found["tau"] or 0.0), _reference(found)))
    return Form(target, tuple(factors), _reference(whole) if whole else 0.0)


def follows_a_rate(id_: str) -> bool:
    """Return whether an identifier is that of a form with the rate of a channel."""
    return id_.startswith(PREFIX) and any(factor.of == "rate" for factor in parsed(id_).factors)


def cause_of(id_: str) -> tuple[str, frozenset[str]]:
    """Return what the form of an identifier says is off, and the signals that this follows."""
    form = parsed(id_)
    return form.target, frozenset(factor.signal for factor in form.factors[form.relative :])


def share_a_signal(ids: Sequence[str]) -> bool:
    """Return whether there is a channel that all forms of one target among some identifiers follow, if they follow any.

    Curves over a channel are those of the sensor. The time is no channel: a form that follows nothing else has no known cause.
    """
    followed = {SENSOR: [{id_.removeprefix(CHANNEL)} for id_ in ids if id_.startswith(CHANNEL)]}
    for target, signals in (cause_of(id_) for id_ in ids if id_.startswith(PREFIX)):
        if signals:
            followed.setdefault(target, []).append({name for each in signals for name in each.split("/")} - {TIME})
    return all(set.intersection(*each) for each in followed.values() if each)


def follows_the_time(id_: str) -> bool:
    """Return whether an effect is a form that follows the time, which is no cause."""
    return id_.startswith(PREFIX) and TIME in cause_of(id_)[1]


def without_variants(ids: Sequence[str]) -> list[str]:
    """Return identifiers without forms of one target that follow the signals of an earlier one, or those of any other and more."""
    of = [cause_of(id_) if id_.startswith(PREFIX) else None for id_ in ids]

    def is_variant(i: int, target: str, signals: frozenset[str]) -> bool:
        others = [(j, each[1]) for j, each in enumerate(of) if each is not None and each[0] == target]
        return any((each and each < signals) or (each == signals and j < i) for j, each in others)

    return [id_ for i, id_ in enumerate(ids) if (own := of[i]) is None or not is_variant(i, *own)]


def along_problem(form: Form, problem: Problem) -> Array:
    """Return the product of the factors at the places of a problem, shape (K,)."""
    found = np.empty(problem.K)
    for i in np.unique(problem.of_log):
        on = problem.of_log == i
        found[on] = form.along(lambda name: recorded_at(problem, name)[on], problem.time[on])  # noqa: B023 used at once
    return found


def recorded_at(problem: Problem, name: str) -> Array:
    """Return a channel of any kind, or the time, at the places of a problem, shape (K,)."""
    if name == TIME:
        return problem.time
    if name in problem.auxiliary:
        return problem.auxiliary[name]
    return problem.mean(problem.signals[name])


def along_log(form: Form, log: Log, time: Array) -> Array:
    """Return the product of the factors at given times of a log; raises DataError where the log lacks a channel."""
    along = form.along(lambda name: channel_on(log, name, form.id({})), log.time)
    return np.asarray(np.interp(time, log.time, along))


def channel_on(log: Log, name: str, effect: str) -> Array:
    """Return what an effect follows, a channel of any kind or the time, along a log; raises DataError where the log lacks it."""
    values = {TIME: log.time - log.time[0], **log.auxiliary, **log.channels}.get(name, np.empty(0))
    known = np.isfinite(values)
    if not known.any():
        raise DataError(
            f"{log.name}: channel '{name}' is missing, but the refined model's effect '{effect}' depends on it; record this "
            "channel, or give the result that `lpvobs refine` started from"
        )
    return np.asarray(np.interp(log.time, log.time[known], values[known]))
