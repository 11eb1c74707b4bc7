"""The entry point of the search: from logs and a nominal model to the effects that they prove, and to the refined model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import UNSET

from lpvobs.discovery.evidence import in_place, loss_of
from lpvobs.discovery.findings import finding_of, known_effect_of, known_finding, outcome_on, parameter_of, shown_by
from lpvobs.discovery.fit import fit, refit
from lpvobs.discovery.forms import in_words
from lpvobs.discovery.healthy_drive import HealthyDrive, unmoved
from lpvobs.discovery.held_out import HOW, HOW_WHOLE, losses_on_unseen, pooled_losses
from lpvobs.discovery.intervals import standard_errors
from lpvobs.discovery.known_effects import KnownEffect, term_on
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.outcome import Leading, Ranked, ResidualOutput, Trace, error_output
from lpvobs.discovery.residual import MapPrior, Problem, Term, lay_out
from lpvobs.discovery.select import Selection, select
from lpvobs.discovery.thresholds import MOST_NAMED
from lpvobs.discovery.whiteness import leftover, structure
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.maps.grid import Grid
from lpvobs.records import Log


@dataclass(frozen=True)
class Refinement:
    """A trace and the model that it leads to."""

    trace: Trace
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
    widths = dict(zip(model.names, model.spread.tolist(), strict=True))
    if healthy is not None:
        model, prior = healthy.unchanged(model), unmoved(prior)

    def lay(these: Sequence[Log]) -> Problem:
        if healthy is None:
            return lay_out(model, grid, prior, these)
        return healthy.taken_off(lay_out(model, grid, prior, these, spacing=healthy.spacing))

    problem = lay(logs)
    terms = tuple(term_on(known_effect, problem, logs) for known_effect in known)
    selection, before, after = _selected(problem, terms, lambda share: progress(0.9 * share))
    accepted = selection.accepted
    kept: tuple[KnownEffect, ...] = ()
    if known:
        errors = standard_errors(after)
        accepted = tuple(
            replace(item, candidate=in_place(after, i, item.candidate), standard_error=float(errors[i]))
            for i, item in enumerate(accepted, len(known))
        )
        kept = tuple(
            _kept(after.terms[i], float(errors[i]), known_effect, logs) for i, known_effect in enumerate(known)
        )
    found = tuple(known_effect_of(problem, logs, item) for item in accepted)
    findings = tuple(finding_of(logs, item) for item in accepted)
    judged = []
    for log in hold_out:
        unseen = lay([log])
        acting = [[term_on(item, unseen, [log]) for item in effects] for effects in (kept, kept + found)]
        judged.append(losses_on_unseen((before, after), (acting[0], acting[1]), unseen))
    named, unexplained = list(zip(findings, found, strict=True)), selection.verdict == "unexplained"
    parts = [selection.losses.part(problem.of_log == i) for i in range(len(logs))]
    by_log = [
        outcome_on(log, own, selection.verdict, named, shown_by(after, i))
        for i, (log, own) in enumerate(zip(logs, parts, strict=True))
    ]
    whole = structure(after)
    left = None if whole.white and not unexplained else leftover(after, logs, whole.correlated_with)
    result = Trace(
        verdict=selection.verdict,
        p_value=selection.p_value,
        effects=findings,
        error=error_output(selection.losses.comparison(), HOW),
        residual=ResidualOutput(whole.white, tuple(whole.correlated_with), **({} if left is None else left.as_json())),
        candidates=_leading(selection) if unexplained else UNSET,
        healthy_drives=() if healthy is None else healthy.logs,
        known_effects=tuple(known_finding(known_effect) for known_effect in kept) or UNSET,
        error_on_held_out_logs=error_output(pooled_losses(judged).comparison(), HOW_WHOLE) if judged else UNSET,
        logs=(
            *by_log,
            *(outcome_on(log, own, selection.verdict, named) for log, own in zip(hold_out, judged, strict=True)),
        ),
        ranking=tuple(Ranked(c.id, c.term.size, c.term.effect.unit, c.gain, c.unevenness) for c in selection.ranking),
        left=left,
    )
    progress(1.0)
    deviation = np.sqrt(np.maximum(np.diag(after.covariance)[after.p :], 0.0))
    return Refinement(
        trace=result,
        beta=dict.fromkeys(widths, 0.0) | dict(zip(model.names, after.beta.tolist(), strict=False)),
        beta_deviation=widths | dict(zip(model.names, deviation.tolist(), strict=False)),
        known_effects=kept + found,
        before=before,
        after=after,
    )


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


def _leading(selection: Selection) -> tuple[Leading, ...]:
    """Return the candidates that come nearest, with what each alone would explain of the residual's power above noise."""
    power = float(loss_of(selection.before).sum())
    return tuple(
        Leading(
            id=c.id,
            parameters={c.term.effect.parameter: parameter_of(c.term.size, c.term.effect.unit, c.standard_error)},
            explained=min(c.gain / max(power, c.gain, 1e-300), 1.0),
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
