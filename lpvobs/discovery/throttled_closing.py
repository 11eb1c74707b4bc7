"""The entry points for a throttled engine: from logs and a learned engine to what is missing, each log judged by itself."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.held_out import Comparison, compared
from lpvobs.discovery.outcome import Finding, Parameter, Ranked
from lpvobs.discovery.standing import Span, Standing
from lpvobs.discovery.throttled_case import ALWAYS, FOREVER, Case, Term
from lpvobs.discovery.throttled_errors import weighed
from lpvobs.discovery.throttled_judging import (
    Judged,
    balance_errors,
    comparison_of,
    in_flow,
    judged,
    levels,
    lost_balances,
    missing_channels,
    needed_channels,
    same_place,
    structure_of,
)
from lpvobs.discovery.throttled_noise import HealthyErrors, held_out_engines
from lpvobs.discovery.throttled_outcome import ThrottledPart, ThrottledTrace
from lpvobs.discovery.throttled_selection import Accepted, Selection, select
from lpvobs.discovery.whiteness import Whiteness
from lpvobs.engines.throttled.balances import BALANCES, imbalances, scene_of
from lpvobs.engines.throttled.blocks import blocks_of
from lpvobs.engines.throttled.constants import DayToDay, Learned, ThrottledEngine
from lpvobs.engines.throttled.effects import CATALOGUE
from lpvobs.errors import DataError
from lpvobs.records import Array, Log

NINETY = 1.645
LEAST_BLOCKS = 30
"""Blocks that a log must have to be judged."""
DRIVES = "drives with low and high load, with and without boost, and a stretch before the effect begins"


@dataclass(frozen=True)
class Nominal:
    """The model that logs are held against.

    Attributes
    ----------
    engine : ThrottledEngine
    learned : Learned
    healthy : HealthyErrors
    day_to_day : DayToDay
    taught : mapping of str to str
        Name of each log that taught the engine, by digest.
    had : tuple of Standing
        Effects that are part of it.
    """

    engine: ThrottledEngine
    learned: Learned
    healthy: HealthyErrors
    day_to_day: DayToDay
    taught: Mapping[str, str]
    had: tuple[Standing, ...] = ()


@dataclass(frozen=True)
class Closed:
    """What the logs hold.

    Attributes
    ----------
    trace : ThrottledTrace
    standing : tuple of Standing
        Effects of the model with those that were found.
    before, after : Whiteness
        Structure of the residual of the first log.
    balances : tuple of str
        Its balances.
    comparisons : mapping of str to (Comparison, bool)
        By log, and whether nothing was fitted to it.
    """

    trace: ThrottledTrace
    standing: tuple[Standing, ...]
    before: Whiteness
    after: Whiteness
    balances: tuple[str, ...]
    comparisons: Mapping[str, tuple[Comparison, bool]]


def close(
    nominal: Nominal,
    logs: Sequence[Log],
    hold_out: Sequence[Log],
    frozen: bool | None,
    progress: Callable[[float], None],
) -> Closed:
    """Return what logs hold that a throttled engine's model lacks.

    Parameters
    ----------
    nominal : Nominal
    logs : sequence of Log
        Judged one by one.
    hold_out : sequence of Log
        Logs that only the error is judged on: effects that last act on them all the time.
    frozen : bool or None
        Whether the engine stands even on logs that taught it; None: on those, it is learned anew without each part in turn.
    progress : callable
        Takes the fraction done.
    """
    done: list[tuple[Case, Selection, Judged]] = []
    for number, log in enumerate(logs):
        case = case_of(nominal, log, logs, frozen)
        found = select(case)
        done.append((found.w.case, found, judged(found.w.case, found)))
        progress((number + 1) / (len(logs) + len(hold_out)))
    parts = [part_of(*item) for item in done]
    standing = _standing(nominal, done)
    unseen = [_unseen(nominal, standing, log) for log in hold_out]
    progress(1.0)
    pooled = _pooled([(case, residuals) for case, _, residuals in done])
    found_anywhere = [part.verdict for part in parts]
    verdict = next((v for v in ("effect", "unexplained") if v in found_anywhere), "none")
    case, selection, residuals = done[0]
    use = [name for b, name in enumerate(BALANCES) if case.counted[:, b].any() and name != "ambient"]
    structure = structure_of(case, residuals.before), structure_of(case, residuals.after)
    trace = ThrottledTrace(
        verdict=verdict,
        findings=tuple(finding for part in parts for finding in part.findings),
        ranking=_ranked(selection),
        comparison=pooled,
        white=all(part.own.white for part in parts if part.own is not None),
        correlated_with={n: x for part in parts if part.own is not None for n, x in part.own.correlated_with.items()},
        standing=tuple(_as_finding(effect) for effect in nominal.had),
        logs=(*parts, *(part for _, part in unseen)),
        held_out=_pooled([item for item, _ in unseen]) if unseen else None,
        left=None,
    )
    comparisons = {part.log: (part.comparison, part.own is None) for part in trace.logs}
    return Closed(trace, standing, *structure, tuple(use), comparisons)


def case_of(nominal: Nominal, log: Log, logs: Sequence[Log], frozen: bool | None) -> Case:
    """Return a log held against the engine, learned anew without each part of the log where the log taught it."""
    blocks = blocks_of(log)
    if blocks.count < LEAST_BLOCKS:
        raise DataError(
            f"{log.name}: {blocks.count} blocks of {blocks.length:g} s without a gap, expected at least {LEAST_BLOCKS}; "
            "record a minute or more"
        )
    own = log.sha256 in nominal.taught and not frozen
    shift = np.zeros((blocks.count, len(BALANCES)))
    if own:
        others = [each for each in logs if each.sha256 in nominal.taught and each.sha256 != log.sha256]
        scene = scene_of(log)
        stands = imbalances(nominal.engine, nominal.learned, blocks, scene)
        for learned, out in held_out_engines(nominal.engine, log, others):
            shift[out] = (imbalances(nominal.engine, learned, blocks, scene) - stands)[out]
    had = tuple(term for effect in nominal.had for term in _terms_on(effect, log))
    return Case(nominal.engine, nominal.learned, nominal.healthy, nominal.day_to_day, log, blocks, shift, own, had)


def _terms_on(effect: Standing, log: Log) -> list[Term]:
    """Return an effect of the model as it acts on a log; times there are of the log's own clock."""
    span = effect.span_on(log)
    known = next((each for each in CATALOGUE if each.id == effect.id), None)
    if known is None or not span.acts or any(channel not in log.channels for channel in known.needs):
        return []
    return [Term(known, effect.value, span.begin - log.time[0], span.end - log.time[0])]


def part_of(case: Case, found: Selection, residuals: Judged) -> ThrottledPart:
    """Return what is said of one log."""
    lost = lost_balances(case)
    missing = missing_channels(case, needed_channels())
    return ThrottledPart(
        log=case.log.name,
        verdict=found.verdict,
        findings=tuple(finding_of(case, found, item) for item in found.accepted),
        comparison=comparison_of(case, residuals),
        own=structure_of(case, residuals.after),
        balances=balance_errors(case, residuals, [item.term for item in found.accepted]),
        day=levels(case, found),
        missing=missing,
        lost=lost,
        same_place=same_place(case) if lost else (),
    )


def finding_of(case: Case, found: Selection, item: Accepted) -> Finding:
    """Return an effect for people and programs."""
    term, low, high = item.term, *_interval(item)
    without = [other.term for other in found.accepted if other is not item]
    loss = found.w.loss(case.imbalances(without))
    return Finding(
        id=term.effect.id,
        parameters={term.effect.parameter: Parameter(term.size, term.effect.unit, (low, high))},
        onset=float(term.begin) if np.isfinite(term.begin) else None,
        end=float(term.end) if np.isfinite(term.end) else None,
        explained=float(np.clip(item.fit.gain / max(loss, 1e-300), 0.0, 1.0)),
        p_value=item.p_value,
        indistinguishable=item.alike,
        drive=DRIVES,
        curve=None,
    )


def _interval(item: Accepted) -> tuple[float, float]:
    """Return the 90 % interval of a size; an unknown curvature leaves the range that was looked at."""
    sizes, half = item.term.effect.sizes, NINETY * item.fit.spread
    if not np.isfinite(half):
        return float(sizes[0]), float(sizes[-1])
    return item.term.size - half, item.term.size + half


def _ranked(found: Selection) -> tuple[Ranked, ...]:
    units = {effect.id: effect.unit for effect in CATALOGUE}
    return tuple(Ranked(fit.id, fit.size, units[fit.id], fit.score, 1.0) for fit in found.ranking)


def _standing(nominal: Nominal, done: Sequence[tuple[Case, Selection, Judged]]) -> tuple[Standing, ...]:
    """Return the effects of the model with those found; an effect without an end lasts."""
    found = list(nominal.had)
    for case, selection, _ in done:
        for item in selection.accepted:
            term, clock = item.term, case.log.time[0]
            begin = term.begin + clock if np.isfinite(term.begin) else -np.inf
            end = term.end + clock if np.isfinite(term.end) else np.inf
            spans = [Span(case.log.name, case.log.sha256, begin, end)]
            spans += [Span(each.log.name, each.log.sha256, np.inf, np.inf) for each, _, _ in done if each is not case]
            healthy = {digest: name for digest, name in nominal.taught.items() if digest != case.log.sha256}
            spans += [Span(name, digest, np.inf, np.inf) for digest, name in healthy.items()]
            effect = term.effect
            found.append(
                Standing(
                    effect.id,
                    "sensor" if effect.id.startswith("maf.") else "engine",
                    effect.parameter,
                    effect.unit,
                    term.size,
                    _interval(item),
                    tuple(spans),
                    bool(np.isinf(end)),
                    None,
                )
            )
    return tuple(found)


def _unseen(nominal: Nominal, standing: Sequence[Standing], log: Log) -> tuple[tuple[Case, Judged], ThrottledPart]:
    """Return the error on a log that took no part: effects that last act all the time, only the day's levels are fitted."""
    case = case_of(nominal, log, (), True)
    new = [
        term for effect in standing if effect not in nominal.had and effect.lasting for term in _terms_on(effect, log)
    ]
    before, after = case.imbalances(()), case.imbalances(new)
    w = weighed(case, np.ones_like(before))
    residuals = Judged(before - w.day(before)[1], after - w.day(after)[1])
    part = ThrottledPart(
        log=log.name,
        verdict="none",
        findings=(),
        comparison=comparison_of(case, residuals),
        own=None,
        balances=balance_errors(case, residuals, [Term(t.effect, t.size, ALWAYS, FOREVER) for t in new]),
        day=(),
        missing=missing_channels(case, needed_channels()),
        lost=lost_balances(case),
        same_place=(),
    )
    return (case, residuals), part


def _pooled(items: Sequence[tuple[Case, Judged]]) -> Comparison:
    coarse: list[NDArray[np.int64]] = []
    lost: list[Array] = []
    left: list[Array] = []
    for case, residuals in items:
        stretch, before, after = in_flow(case, residuals)
        coarse.append(stretch + (int(coarse[-1].max()) + 1 if coarse else 0))
        lost.append(before)
        left.append(after)
    all_lost, all_left = np.concatenate(lost), np.concatenate(left)
    return compared(np.concatenate(coarse).astype(np.int64), 1.0, all_lost, all_left, all_lost.size)


def _as_finding(effect: Standing) -> Finding:
    """Return an effect of the model for people and programs."""
    return Finding(
        id=effect.id,
        parameters={effect.parameter: Parameter(effect.value, effect.unit, effect.ci90)},
        onset=None,
        end=None,
        explained=None,
        p_value=None,
        indistinguishable=(),
        drive="",
        curve=None,
    )
