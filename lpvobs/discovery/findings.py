"""What is said of effects and of logs.

An accepted effect is a `Finding` for people and programs and a `KnownEffect` for the model that keeps it. Of a log there are the
balances with and without the effects, levels of its day, and missing channels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from msgspec import UNSET, UnsetType

from lpvobs.discovery import outcome
from lpvobs.discovery.courses import Curve, FactorSurface
from lpvobs.discovery.forms import in_words, rms
from lpvobs.discovery.held_out import HOW, HOW_WHOLE, Losses
from lpvobs.discovery.imbalances import residual_of, scenes_with
from lpvobs.discovery.joint_choice import Accepted
from lpvobs.discovery.known_effects import NINETY, KnownEffect, spans_of
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.places import place_in_logs
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.thresholds import AFFECTED, PLACED, PROBE
from lpvobs.discovery.whiteness import structure
from lpvobs.records import Array, Log


def parameter_of(value: float, unit: str, standard_error: float) -> outcome.Parameter:
    """Return a number with its interval."""
    half = NINETY * standard_error
    return outcome.Parameter(value, unit, (value - half, value + half))


def finding_of(logs: Sequence[Log], item: Accepted) -> outcome.Finding:
    """Return an accepted effect for people and programs."""
    term = item.candidate.term
    course, curve = term.course, term.curve
    begin, end = (term.begin, term.end) if course is None else (course.begin, course.end)
    plain = "interval" if np.isfinite(end) else "step" if np.isfinite(begin) else "always"
    further = {x.name: parameter_of(x.value, x.unit, x.error) for x in item.further}
    return outcome.Finding(
        id=term.effect.id,
        parameters={term.effect.parameter: parameter_of(term.size, term.effect.unit, item.standard_error)} | further,
        onset=place_in_logs(logs, begin),
        end=place_in_logs(logs, end),
        course=plain if course is None else course.name,
        follows=UNSET
        if course is None
        else outcome.Following(course.time_constant, course.input, course.low, course.high, course.intervals),
        explained=item.share,
        p_value=item.p_value,
        indistinguishable=item.indistinguishable,
        drive=term.effect.drive if item.indistinguishable else UNSET,
        curve=_followed(curve) if isinstance(curve, Curve) else UNSET,
        surface=_over_inputs(curve, term.size) if isinstance(curve, FactorSurface) else UNSET,
        formula=in_words(term),
    )


def known_effect_of(problem: Problem, logs: Sequence[Log], item: Accepted) -> KnownEffect:
    """Return an accepted effect as the model keeps it: with rates per second."""
    term, curve = item.candidate.term, item.candidate.term.curve
    if isinstance(curve, Curve) and curve.of == "rate":
        curve = replace(curve, knots=curve.knots / problem.spacing)
    return KnownEffect(
        id=term.effect.id,
        place=term.effect.place,
        parameter=term.effect.parameter,
        unit=term.effect.unit,
        value=term.size,
        ci90=parameter_of(term.size, term.effect.unit, item.standard_error).ci90,
        spans=spans_of(term, logs),
        lasting=not np.isfinite(term.end) and (term.course is None or term.course.name != "intermittent"),
        course=None if term.course is None else term.course.shifted(float(logs[0].time[0])),
        curve=curve if isinstance(curve, Curve) else None,
        surface=curve if isinstance(curve, FactorSurface) else None,
    )


def known_finding(known_effect: KnownEffect) -> outcome.Finding:
    """Return an effect that the model had already."""
    parameter = outcome.Parameter(known_effect.value, known_effect.unit, known_effect.ci90)
    return outcome.Finding(known_effect.id, {known_effect.parameter: parameter}, None, None, None, None, ())


def outcome_on(
    log: Log,
    losses: Losses,
    verdict: str,
    effects: Sequence[tuple[outcome.Finding, KnownEffect]],
    shown: Mapping[str, Any] = MappingProxyType({"balances": (), "day_to_day": ()}),
) -> outcome.OutcomeOnLog:
    """Return what is said of one log: the pooled findings that act on it, its own error, and what `shown_by` has of it.

    Of a log that took no part nothing is shown.
    """
    start, acting = float(log.time[0]), []
    for finding, known_effect in effects:
        span = known_effect.span_on(log)
        if span.acts and known_effect.course is not None:
            acting.append(finding)
        elif span.acts:
            acting.append(replace(finding, onset=_since(start, span.begin), end=_since(start, span.end)))
    if verdict == "effect" and not acting:
        verdict = "none"
    error = outcome.error_output(losses.comparison(), HOW if "residual" in shown else HOW_WHOLE)
    return outcome.OutcomeOnLog(log=log.name, verdict=verdict, effects=tuple(acting), error=error, **shown)


def _since(start: float, edge: float) -> float | None:
    return edge - start if np.isfinite(edge) else None


def _followed(x: Curve) -> outcome.Followed:
    return outcome.Followed(x.channel, x.of, x.carrier, tuple(x.knots.tolist()), tuple(x.values.tolist()))


def _over_inputs(x: FactorSurface, amplitude: float) -> outcome.OverInputs:
    knots = tuple(x.first.tolist()), tuple(x.second.tolist())
    factor, errors = (tuple(map(tuple, rows.tolist())) for rows in (1.0 + amplitude * x.values, x.errors))
    return outcome.OverInputs(x.inputs, x.units, x.largest, knots, factor, errors)


def shown_by(after: Linear, i: int) -> dict[str, Any]:
    """Return what log i shows: structure of what is left, balances, levels of the day, what is missing."""
    own = structure(after, after.problem.of_log == i)
    return {
        "residual": outcome.ResidualOutput(own.white, tuple(own.correlated_with)),
        "balances": balance_errors(after, i),
        "day_to_day": levels_of(after.problem, after.beta, i),
        "missing": missing_of(after.problem),
    }


def balance_errors(after: Linear, i: int) -> tuple[outcome.BalanceError, ...]:
    """Return every balance of log i where the effects act, of the whole log where there is none.

    Map, unknowns and levels of the day are those of the model with the effects in both cases, so that only the effects differ.
    """
    problem, model = after.problem, after.problem.model
    before = residual_of(problem, scenes_with(problem, (), after.beta), after.beta, after.theta, after.nodes)[0]
    acting = np.zeros(problem.K, dtype=bool)
    for term in after.terms:
        acting |= term.acts(problem.clock)
    own = problem.of_log == i
    named = bool((acting & own).any())
    found = []
    for b, name in enumerate(model.balances):
        use = problem.shown[b] & (own & acting if named else own)
        if not use.any():
            continue
        lost, left = before[b, use], after.raw[0][b, use]
        healthy = None if model.healthy is None else float(model.healthy.rms[b])
        B, A, usual = rms(lost), rms(left), rms(left) if healthy is None else healthy
        moved = named and AFFECTED * usual < B and rms(lost - left) > 0.5 * usual
        recovered = (B - A) / (B - healthy) if moved and healthy is not None else None
        found.append(
            outcome.BalanceError(name, model.unit, B, A, healthy, _median(lost), _median(left), moved, recovered)
        )
    return tuple(found)


def levels_of(problem: Problem, beta: Array, i: int) -> tuple[outcome.DayLevel, ...]:
    """Return what differs on the day of log i, in units."""
    known = {effect.id for effect in problem.catalogue}
    known |= {name for name, row in zip(problem.model.balances, problem.shown, strict=True) if row.any()}
    return tuple(
        outcome.DayLevel(level.name, value, level.unit, level.deviation)
        for log, level, value in problem.on_days(beta)
        if log == i and level.name in known
    )


def missing_of(problem: Problem) -> outcome.Missing | UnsetType:
    """Return what the channels of the logs cannot show, unset where they have all."""
    model = problem.model
    channels = tuple(name for name in model.channels if name not in problem.signals.value)
    balances = tuple(name for name, row in zip(model.balances, problem.shown, strict=True) if not row.any())
    return outcome.Missing(channels, balances, _same_place(problem)) if channels else UNSET


def _same_place(problem: Problem) -> tuple[tuple[str, ...], ...]:
    """Return groups of effects that move the same balances of the logs."""
    beta = np.zeros(problem.spread.size)
    theta, nodes = np.zeros(1), (np.zeros((problem.K, 4), dtype=np.int64), np.zeros((problem.K, 4)))

    def residual(terms: Sequence[Term]) -> Array:
        return np.asarray(residual_of(problem, scenes_with(problem, terms, beta), beta, theta, nodes)[0])

    base, groups = residual(()), dict[tuple[bool, ...], list[str]]()
    for effect in problem.catalogue:
        moved = np.where(problem.shown, residual([Term(effect, effect.null + PROBE * effect.size)]) - base, 0.0)
        power = np.sqrt((moved**2).mean(1))
        if power.max() > 0.0:
            groups.setdefault(tuple((power > PLACED * power.max()).tolist()), []).append(effect.id)
    return tuple(tuple(names) for names in groups.values() if len(names) > 1)


def _median(r: Array) -> float:
    return float(1.4826 * np.median(np.abs(r)))
