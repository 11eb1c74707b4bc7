"""Accepted effects as records: `Finding` for people and programs, `KnownEffect` for the model that keeps them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import UNSET

from lpvobs.discovery.accepted import Accepted
from lpvobs.discovery.forms import in_words
from lpvobs.discovery.held_out import Comparison
from lpvobs.discovery.known_effects import NINETY, KnownEffect, spans_of, stored_curve
from lpvobs.discovery.outcome import Finding, Followed, Following, LogPart, OverInputs, Parameter
from lpvobs.discovery.places import place_in_logs
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.shapes import Curve, FactorSurface
from lpvobs.records import Log


def parameter_of(term: Term, standard_error: float) -> Parameter:
    """Return an effect's size with its interval."""
    half = NINETY * standard_error
    return Parameter(term.size, term.effect.unit, (term.size - half, term.size + half))


def finding_of(problem: Problem, logs: Sequence[Log], item: Accepted) -> Finding:
    """Return an accepted effect for people and programs."""
    term = item.candidate.term
    course = term.course
    begin, end = (term.begin, term.end) if course is None else (course.begin, course.end)
    return Finding(
        id=term.effect.id,
        parameters={term.effect.parameter: parameter_of(term, item.standard_error)}
        | {
            x.name: Parameter(x.value, x.unit, (x.value - NINETY * x.error, x.value + NINETY * x.error))
            for x in item.further
        },
        onset=place_in_logs(logs, begin),
        end=place_in_logs(logs, end),
        course=plain_course(begin, end) if course is None else course.name,
        follows=UNSET
        if course is None
        else Following(course.time_constant, course.input, course.low, course.high, course.intervals),
        explained=item.share,
        p_value=item.p_value,
        indistinguishable=item.indistinguishable,
        drive=term.effect.drive if item.indistinguishable else UNSET,
        curve=_followed(term.curve) if isinstance(term.curve, Curve) else UNSET,
        surface=_over_inputs(term.curve, term.size) if isinstance(term.curve, FactorSurface) else UNSET,
        formula=in_words(term),
    )


def plain_course(begin: float, end: float) -> str:
    """Return the contract's name of what begins and ends once at most."""
    return "interval" if np.isfinite(end) else "step" if np.isfinite(begin) else "always"


def known_effect_of(problem: Problem, logs: Sequence[Log], item: Accepted) -> KnownEffect:
    """Return an accepted effect as the model keeps it."""
    term = item.candidate.term
    parameter = parameter_of(term, item.standard_error)
    return KnownEffect(
        id=term.effect.id,
        place=term.effect.place,
        parameter=term.effect.parameter,
        unit=term.effect.unit,
        value=parameter.value,
        ci90=parameter.ci90,
        spans=spans_of(term, logs),
        lasting=not np.isfinite(term.end) and (term.course is None or term.course.name != "intermittent"),
        course=None if term.course is None else term.course.shifted(float(logs[0].time[0])),
        curve=stored_curve(term.curve, problem) if isinstance(term.curve, Curve) else None,
        surface=term.curve if isinstance(term.curve, FactorSurface) else None,
    )


def known_finding(known_effect: KnownEffect) -> Finding:
    """Return an effect that the model had already."""
    parameter = Parameter(known_effect.value, known_effect.unit, known_effect.ci90)
    return Finding(known_effect.id, {known_effect.parameter: parameter}, None, None, None, None, ())


def log_part(
    log: Log,
    comparison: Comparison,
    *,
    verdict: str,
    findings: Sequence[Finding],
    found: Sequence[KnownEffect],
    **more: Any,
) -> LogPart:
    """Return what is said of one log: the pooled findings that act on it, its own error, and `more` as `LogPart` has it."""
    start, acting = float(log.time[0]), []
    for finding, known_effect in zip(findings, found, strict=True):
        span = known_effect.span_on(log)
        if span.acts:
            if known_effect.course is not None:
                acting.append(finding)
                continue
            acting.append(replace(finding, onset=_since(start, span.begin), end=_since(start, span.end)))
    if verdict == "effect" and not acting:
        verdict = "none"
    return LogPart(log.name, verdict, tuple(acting), comparison, **more)


def _since(start: float, edge: float) -> float | None:
    return edge - start if np.isfinite(edge) else None


def _followed(curve: Curve) -> Followed:
    return Followed(curve.channel, curve.of, curve.carrier, tuple(curve.knots.tolist()), tuple(curve.values.tolist()))


def _over_inputs(surface: FactorSurface, amplitude: float) -> OverInputs:
    knots = tuple(surface.first.tolist()), tuple(surface.second.tolist())
    factor = tuple(tuple(row) for row in (1.0 + amplitude * surface.values).tolist())
    errors = tuple(tuple(row) for row in surface.errors.tolist())
    return OverInputs(surface.inputs, surface.units, surface.largest, knots, factor, errors)
