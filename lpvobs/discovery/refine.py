"""The entry point of the search: from logs and a nominal model to the effects that they prove, and to the refined model.

An accepted effect is a `Finding` for people and programs and a `KnownEffect` for the model that keeps it. Of a log there are the
balances with and without the effects, levels of its day, and missing channels.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from msgspec import UNSET

from lpvobs.discovery import outcome
from lpvobs.discovery.courses import Curve, FactorSurface, course_name
from lpvobs.discovery.evidence import in_place, loss_of
from lpvobs.discovery.fit import fit, refit, standard_errors
from lpvobs.discovery.forms import in_words, rms
from lpvobs.discovery.healthy_drive import HealthyDrive
from lpvobs.discovery.held_out import HOW, HOW_WHOLE, Losses, losses_on_unseen, pooled_losses
from lpvobs.discovery.imbalances import residual_of, scenes_with
from lpvobs.discovery.joint_choice import Accepted, error_of
from lpvobs.discovery.known_effects import NINETY, KnownEffect, spans_of, term_on
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.map_prior import MapPrior
from lpvobs.discovery.places import place_in_logs
from lpvobs.discovery.residual import Problem, Term, lay_out
from lpvobs.discovery.select import Selection, select
from lpvobs.discovery.thresholds import AFFECTED, MOST_NAMED, PLACED, PROBE
from lpvobs.discovery.whiteness import leftover, structure
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Log


@dataclass(frozen=True)
class Refinement:
    """A trace and the model that it leads to."""

    trace: outcome.Trace
    beta: Mapping[str, float]  # relative deviation of each uncertain constant from the configured one
    beta_deviation: Mapping[str, float]  # its standard deviation
    # every effect of the model: first those that it had, estimated again, then those that were found
    known_effects: tuple[KnownEffect, ...]
    before: Linear  # residual, regressors and weights of the model as it was, for reports
    after: Linear  # the same of the model with the effects

    @property
    def terms(self) -> tuple[Term, ...]:
        """The effects as they act on these logs."""
        return self.after.terms


def refine(
    model: ResidualModel,
    grid: Grid,
    prior: MapPrior,
    logs: Sequence[Log],
    progress: Callable[[float], None] = lambda _: None,
    known: Sequence[KnownEffect] = (),
    hold_out: Sequence[Log] = (),
    healthy: HealthyDrive | None = None,
) -> Refinement:
    """Return the model with the effects that the logs prove, which are pooled; `progress` is called with the share that is done.

    The prior is `free_map` on the logs that make the map, `nominal_map` on others. Effects that the model has already, `known`, are
    estimated again. No fit and no decision sees the logs of `hold_out`; the error before and after is computed on them, too.
    `healthy` is what the engine leaves when it is healthy: the search is for what has changed. Raises DataError if a log is too
    short, or lacks a channel that an effect of the model follows.
    """

    def lay(these: Sequence[Log], modes: Array | None = None) -> Problem:
        if healthy is None:
            return lay_out(model, grid, prior, these)
        return healthy.taken_off(lay_out(model, grid, prior, these, spacing=healthy.spacing), modes)

    problem = lay(logs)
    terms = tuple(term_on(known_effect, problem, logs) for known_effect in known)
    selection, before, after = _selected(problem, terms, lambda share: progress(0.9 * share))
    accepted = selection.accepted
    kept: tuple[KnownEffect, ...] = ()
    if known:
        errors = standard_errors(after)
        accepted = tuple(
            replace(item, candidate=in_place(after, i, item.candidate), standard_error=error, further=further)
            for i, item in enumerate(accepted, len(known))
            for error, further in [error_of(after, i, float(errors[i]))]
        )
        kept = tuple(_kept(after.terms[i], float(errors[i]), each, logs) for i, each in enumerate(known))
    found = tuple(known_effect_of(problem, logs, item) for item in accepted)
    findings = tuple(finding_of(logs, item) for item in accepted)
    judged = []
    for log in hold_out:
        unseen = lay([log], problem.modes)
        acting = [[term_on(item, unseen, [log]) for item in effects] for effects in (kept, kept + found)]
        judged.append(losses_on_unseen((before, after), acting, unseen))
    named, unexplained = list(zip(findings, found, strict=True)), selection.verdict == "unexplained"
    by_log = [
        outcome_on(log, selection.losses.part(problem.of_log == i), selection.verdict, named, shown_by(after, i))
        for i, log in enumerate(logs)
    ]
    by_log += [outcome_on(log, own, selection.verdict, named) for log, own in zip(hold_out, judged, strict=True)]
    whole = structure(after)
    left = None if whole.white and not unexplained else leftover(after, logs, whole.correlated_with)
    described = {} if left is None else left.as_json()
    ranked = ((c, c.term) for c in selection.ranking)
    result = outcome.Trace(
        verdict=selection.verdict,
        p_value=selection.p_value,
        effects=findings,
        error=outcome.error_output(selection.losses.comparison(), HOW),
        residual=outcome.ResidualOutput(whole.white, tuple(whole.correlated_with), **described),
        candidates=_leading(selection) if unexplained else UNSET,
        healthy_drives=() if healthy is None else healthy.logs,
        healthy_drives_needed=UNSET if selection.needed is None else outcome.DrivesNeeded(*selection.needed),
        known_effects=tuple(known_finding(known_effect) for known_effect in kept) or UNSET,
        error_on_held_out_logs=outcome.error_output(pooled_losses(judged).comparison(), HOW_WHOLE) if judged else UNSET,
        logs=tuple(by_log),
        ranking=tuple(outcome.Ranked(c.id, term.size, term.effect.unit, c.gain, c.unevenness) for c, term in ranked),
        left=left,
    )
    progress(1.0)
    beta, covariance = _of_engine(after, model.covariance)
    return Refinement(
        trace=result,
        beta=dict(zip(model.names, beta.tolist(), strict=True)),
        beta_deviation=dict(zip(model.names, np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist(), strict=True)),
        known_effects=kept + found,
        before=before,
        after=after,
    )


def _of_engine(linear: Linear, prior: Array) -> tuple[Array, Array]:
    """Return the engine's unknowns and their covariance, (q, q) like the prior; what nothing tells of keeps its own."""
    modes, m = linear.problem.modes, len(linear.problem.model.names)
    found, left = linear.beta[:m], linear.covariance[linear.p : linear.p + m, linear.p : linear.p + m]
    return (found, left) if modes is None else (modes @ found, prior + modes @ (left - np.eye(m)) @ modes.T)


def _selected(
    problem: Problem, known: tuple[Term, ...], progress: Callable[[float], None]
) -> tuple[Selection, Linear, Linear]:
    """Return what was found, and the model before and after, both with the effects that were there already.

    Known effects are estimated first and held while others are sought. The search then has less power only against effects that
    resemble them. In the end all are estimated together, from all data.
    """
    if not known:
        selection = select(problem, progress)
        return selection, selection.before, selection.after
    base = fit(problem, known)
    selection = select(_holding(problem, base.terms), lambda share: progress(0.1 + 0.8 * share))
    after = fit(problem.with_all(), [*base.terms, *selection.after.terms], passes=2, start=base)
    before = refit(after, after.terms[: len(known)]) if selection.accepted else after
    return selection, before, after


def _leading(selection: Selection) -> tuple[outcome.Leading, ...]:
    """Return the candidates that come nearest, with what each alone would explain of the residual's power above noise."""
    power = float(loss_of(selection.before).sum())
    return tuple(
        outcome.Leading(
            id=c.id,
            parameters={c.term.effect.parameter: parameter_of(c.term.size, c.term.effect.unit, c.standard_error)},
            explained=min(c.gain / max(power, c.gain, 1e-300), 1.0),
            course=course_name(c.term.course, c.term.begin, c.term.end),
            formula=in_words(c.term),
        )
        for c in selection.leading[:MOST_NAMED]
        if c.gain > 0.0
    )


def _holding(problem: Problem, terms: Sequence[Term]) -> Problem:
    """Return the problem with effects held at their sizes, for any width of the windows."""
    return replace(problem, held=(*problem.held, *terms), wider=lambda: _holding(problem.wider(), terms))


def _kept(term: Term, error: float, known_effect: KnownEffect, logs: Sequence[Log]) -> KnownEffect:
    """Return an effect that the model had, estimated again, with the logs that it is now estimated on."""
    parameter = parameter_of(term.size, term.effect.unit, error)
    known = {(span.log, span.sha256) for span in known_effect.spans}
    new = tuple(known_effect.span_on(log) for log in logs if (log.name, log.sha256) not in known)
    return replace(known_effect, value=parameter.value, ci90=parameter.ci90, spans=known_effect.spans + new)


def parameter_of(value: float, unit: str, standard_error: float) -> outcome.Parameter:
    """Return a number with its interval."""
    half = NINETY * standard_error
    return outcome.Parameter(value, unit, (value - half, value + half))


def finding_of(logs: Sequence[Log], item: Accepted) -> outcome.Finding:
    """Return an accepted effect for people and programs."""
    term = item.candidate.term
    course, curve = term.course, term.curve
    begin, end = (term.begin, term.end) if course is None else (course.begin, course.end)
    further = {name: parameter_of(*number) for name, number in item.further.items()}
    return outcome.Finding(
        id=term.effect.id,
        parameters={term.effect.parameter: parameter_of(term.size, term.effect.unit, item.standard_error)} | further,
        onset=place_in_logs(logs, begin),
        end=place_in_logs(logs, end),
        course=course_name(course, begin, end),
        follows=UNSET
        if course is None
        else outcome.Following(course.time_constant, course.input, course.low, course.high, course.intervals),
        explained=item.share,
        p_value=item.p_value,
        indistinguishable=item.indistinguishable,
        drive=term.effect.drive if item.indistinguishable else UNSET,
        curve=outcome.Followed(
            curve.channel, curve.of, curve.carrier, tuple(curve.knots.tolist()), tuple(curve.values.tolist())
        )
        if isinstance(curve, Curve)
        else UNSET,
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
        inside=0.0 if term.effect.inside is None else term.effect.inside.value,
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
    shown: Mapping[str, Any] | None = None,
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
            onset, end = (edge - start if np.isfinite(edge) else None for edge in (span.begin, span.end))
            acting.append(replace(finding, onset=onset, end=end))
    if verdict == "effect" and not acting:
        verdict = "none"
    error = outcome.error_output(losses.comparison(), HOW if shown else HOW_WHOLE)
    told = shown or {"balances": (), "day_to_day": ()}
    return outcome.OutcomeOnLog(log=log.name, verdict=verdict, effects=tuple(acting), error=error, **told)


def _over_inputs(x: FactorSurface, amplitude: float) -> outcome.OverInputs:
    knots = tuple(x.first.tolist()), tuple(x.second.tolist())
    factor, errors = (tuple(map(tuple, rows.tolist())) for rows in (1.0 + amplitude * x.values, x.errors))
    return outcome.OverInputs(x.inputs, x.units, x.largest, knots, factor, errors)


def shown_by(after: Linear, i: int) -> dict[str, Any]:
    """Return what log i shows: structure of what is left, balances, levels of its day in units, what channels cannot show."""
    problem, model = after.problem, after.problem.model
    own = structure(after, problem.of_log == i)
    drawn = {name for name, row in zip(model.balances, problem.shown, strict=True) if row.any()}
    known = drawn | {effect.id for effect in problem.catalogue}
    levels = tuple(
        outcome.DayLevel(level.name, value, level.unit, level.deviation)
        for log, level, value in problem.on_days(after.beta)
        if log == i and level.name in known
    )
    lacking = tuple(name for name in model.channels if name not in problem.signals.value)
    lost = tuple(name for name in model.balances if name not in drawn)
    return {
        "residual": outcome.ResidualOutput(own.white, tuple(own.correlated_with)),
        "balances": balance_errors(after, i),
        "day_to_day": levels,
        "missing": outcome.Missing(lacking, lost, _same_place(problem)) if lacking else UNSET,
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
        medians = _median(lost), _median(left)
        found.append(outcome.BalanceError(name, model.unit, B, A, healthy, *medians, moved, recovered))
    return tuple(found)


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
