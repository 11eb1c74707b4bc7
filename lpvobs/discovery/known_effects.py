"""Effects that a model has already: what they are, where they act on each log, and how they enter the search on other logs.

An effect that was still there at the end of the last log it was found on belongs to the engine from then on: on a log that took no
part it acts from the first sample to the last. An effect that ended acts on its own log only. Logs that made the nominal map do not
have it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.courses import GRADED, Curve, FactorSurface, TracedCourse, on_course
from lpvobs.discovery.curves import along_channel, driven_by, rate_of
from lpvobs.discovery.forms import CHANNEL, PREFIX, Form, along_log, channel_on, parsed
from lpvobs.discovery.places import starts
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.thresholds import MOST_LEVELS, SPACING, WIDEST
from lpvobs.engines.effects import Effect
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.errors import DataError
from lpvobs.records import Array, Item, Log

NINETY = 1.645
OWN_TIME = "on the time axis of the log"


@dataclass(frozen=True)
class Span:
    """Where an effect acts on one log.

    Infinite where it acts from the first or to the last sample; begin = end = inf where it does not act at all.
    """

    log: Annotated[str, Item("1", "log on which the effect was estimated or is absent")]
    sha256: Annotated[str, Item("1", "SHA-256 of the log")]
    begin: Annotated[
        float, Item("s", f"start of the effect {OWN_TIME}; -inf: first sample; inf: never", name="onset", gaps=True)
    ]
    end: Annotated[float, Item("s", f"end of the effect {OWN_TIME}; inf: last sample", gaps=True)]

    @property
    def acts(self) -> bool:
        """Whether any of the log is under the effect."""
        return self.begin < self.end

    def covers(self, time: Array) -> NDArray[np.bool_]:
        """Return which times of the log are under the effect, shape (n,)."""
        return np.asarray((time >= self.begin) & (time < self.end))


@dataclass(frozen=True)
class KnownEffect:
    """One effect of a model.

    There is a span for every log that it was estimated on or is known to be absent from. It lasts if it was there at the end of the
    last log. The surface is a component's curve. The curve, of a channel, says how the size of the carrier depends on it, at
    amplitude one, with rates per second.
    """

    id: str
    place: str
    parameter: str
    unit: str
    value: Annotated[float, Item("1", "value of the effect's parameter")]
    ci90: Annotated[tuple[float, float], Item("1", "90 % interval of the value", ("quantile",), gaps=True)]
    spans: Annotated[tuple[Span, ...], Item(axes=("log",))]
    lasting: Annotated[bool, Item("1", "whether the effect acts on all of every other log")]
    curve: Annotated[Curve | None, Item()]
    surface: Annotated[FactorSurface | None, Item()] = None
    course: Annotated[TracedCourse | None, Item()] = None  # times on the time axis of the log of its first span
    inside: Annotated[
        float, Item("1", "value of the constant inside the effect, in its unit; zero where there is none")
    ] = 0.0

    @property
    def standard_deviation(self) -> float:
        """Half the interval over its quantile, in the parameter's unit."""
        return (self.ci90[1] - self.ci90[0]) / (2.0 * NINETY)

    def span_on(self, log: Log) -> Span:
        """Return where it acts on a log, whether the log took part or not."""
        for span in self.spans:
            if span.sha256 == log.sha256 and span.log == log.name:
                return span
        return Span(log.name, log.sha256, -np.inf if self.lasting else np.inf, np.inf)

    def took_part(self, logs: Sequence[Log]) -> bool:
        """Whether it was estimated on any of the logs."""
        return any(span.acts and any(span.sha256 == log.sha256 for log in logs) for span in self.spans)


def spans_of(term: Term, logs: Sequence[Log]) -> tuple[Span, ...]:
    """Return where an interval of the common clock lies on each log."""
    found = []
    for log, start in zip(logs, starts(logs), strict=True):
        first, last = float(log.time[0]), float(log.time[-1])
        begin, end = (first + edge - start for edge in (term.begin, term.end))
        acts = begin <= last and end > first
        ends = (begin if begin > first else -np.inf, end if end <= last else np.inf) if acts else (np.inf, np.inf)
        found.append(Span(log.name, log.sha256, *ends))
    return tuple(found)


def term_on(known_effect: KnownEffect, problem: Problem, logs: Sequence[Log]) -> Term:
    """Return the effect as a term of the logs' problem.

    On new logs its prior is the stored value with its interval. On logs that it was estimated on, it is estimated anew without.
    Raises DataError if the model's effect is none that this version knows, or a log lacks the channel that it follows.
    """
    time = own_time(problem, logs)
    parts = [(log, time[problem.of_log == i]) for i, log in enumerate(logs)]
    effect, on = effect_along(known_effect, problem.model, parts, problem.over_columns)
    if not known_effect.took_part(logs):
        spread = max(known_effect.standard_deviation, 1e-9 * effect.size)
        effect = replace(effect, null=known_effect.value, size=spread / WIDEST, straight=False)
    return Term(effect, known_effect.value, only=None if on.all() else on, course=known_effect.course)


def course_on(known_effect: KnownEffect, log: Log, time: Array) -> Array:
    """Return the share of an effect at times of a log, shape (n,); on other logs than its own it has grown, or is over."""
    course, own = known_effect.course, known_effect.spans[0]
    if course is None or (course.in_time and (own.log, own.sha256) != (log.name, log.sha256)):
        return np.full(time.size, float(course is None or course.name in GRADED))
    followed = partial(channel_on, log, effect=known_effect.id)
    return course.share(time, lambda name: np.interp(time, log.time, followed(name)), float(log.time[-1]))


def own_time(problem: Problem, logs: Sequence[Log]) -> Array:
    """Return the time of every place on its log's own axis [s], shape (K,)."""
    return np.asarray(problem.time + np.array([log.time[0] for log in logs])[problem.of_log])


def from_off(known_effect: KnownEffect) -> KnownEffect:
    """Return an effect that follows a switch as nothing where the switch is off; others as they are."""
    # The average of a curve over its logs belongs to the map that is estimated beside it. The curve's zero is therefore a
    # choice, and the map has to be estimated with the same choice. Nobody expects an effect from a switch that is off.
    curve = known_effect.curve
    if curve is None or curve.of != "value" or curve.knots.size > MOST_LEVELS:
        return known_effect
    return replace(known_effect, curve=replace(curve, values=curve.values - curve.values[0]))


def catalogued(name: str, model: ResidualModel) -> Effect:
    """Return an effect of the catalogue by its identifier."""
    found = model.effect(name)
    if found is None:
        known = ", ".join(effect.id for effect in model.catalogue)
        raise DataError(
            f"the refined model contains the effect '{name}', which this engine's catalogue lacks; expected one of {known}; run "
            f"`lpvobs refine` again"
        )
    return found


def effect_along(
    known_effect: KnownEffect,
    model: ResidualModel,
    parts: Sequence[tuple[Log, Array]],
    over_columns: Callable[[Array], Array] = lambda values: values,
) -> tuple[Effect, NDArray[np.bool_]]:
    """Return an effect as it acts at times of some logs, one log after the other, and where it acts; a log may be without it.

    `over_columns` lays values at those times out for every column of the signals.
    """
    course = known_effect.course

    def along(each: Callable[[Log, Array], Array]) -> Array:
        return np.concatenate([each(log, time) for log, time in parts])

    effect = _effect(
        known_effect, model, lambda curve: over_columns(along(lambda log, time: channel_at(log, curve, time)))
    )
    on = np.concatenate([known_effect.span_on(log).covers(time) for log, time in parts])
    if course is None:
        return effect, on
    share = along(lambda log, time: course_on(known_effect, log, time))
    return (on_course(effect, over_columns(share)) if course.name in GRADED else effect), on & (share > 0.0)


def _effect(known_effect: KnownEffect, model: ResidualModel, followed: Callable[[Curve | Form], Array]) -> Effect:
    curve, component = known_effect.curve, model.curve(known_effect.id)
    if component is not None and known_effect.surface is not None:
        return driven_by(component, known_effect.surface)
    if known_effect.id.startswith(PREFIX):
        form = parsed(known_effect.id)
        return form.effect(model, followed(form), abs(known_effect.value))
    if curve is None:
        effect = catalogued(known_effect.id, model)
        return effect if effect.inside is None else effect.having(known_effect.inside)
    carrier = catalogued(curve.carrier, model)
    return along_channel(curve, carrier, np.interp(followed(curve), curve.knots, curve.values))


def channel_at(log: Log, curve: Curve | Form, time: Array) -> Array:
    """Return what a curve or a form follows at given times of a log; raises DataError where the log does not have it."""
    if isinstance(curve, Form):
        return along_log(curve, log, time)
    if not np.isfinite(log.auxiliary.get(curve.channel, 0.0)).any():  # the channel is there, and nothing is known of it
        return np.zeros(time.size)
    recorded = channel_on(log, curve.channel, f"{CHANNEL}{curve.channel}")
    if curve.of == "value":
        return np.asarray(np.interp(time, log.time, recorded))
    grid = np.arange(log.time[0], log.time[-1] + SPACING, SPACING)
    return np.asarray(np.interp(time, grid, rate_of(np.interp(grid, log.time, recorded), SPACING) / SPACING))
