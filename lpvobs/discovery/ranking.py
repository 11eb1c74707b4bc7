"""All candidates against one model: how promising each is, the logged channels among them, and which is worth a name."""

from collections.abc import Mapping, Sequence

from lpvobs.discovery.channels import Curve, channel_candidates
from lpvobs.discovery.evidence import (
    Candidate,
    best_intervals,
    fit_candidate,
    gains_of_intervals,
    p_value,
    penalty,
    promise_of,
    score,
    slope_of,
    with_best_interval,
)
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.residual import Problem
from lpvobs.discovery.thresholds import (
    ALWAYS,
    LEAST_LENGTH,
    LEAST_SHARE,
    LOOKED_AT,
    PROVEN,
    SHORTLIST,
    SIGNIFICANT,
    TIE,
)
from lpvobs.engines.effects import Effect


def uneven_share(candidate: Candidate, problem: Problem) -> float:
    """Return what a size of its own for every block would gain, over what the one size gains."""
    return 0.5 * (candidate.unevenness - 1.0) * problem.coarse_blocks / max(candidate.gain, 1e-9)


def rank(linear: Linear, effects: Sequence[Effect], intervals: bool = True) -> list[Candidate]:
    """Return the most promising effects, each on its best interval where it is at the front, best first."""
    free = linear.problem.prior.free
    if not intervals or linear.problem.first.size < 3 * LEAST_LENGTH:
        promise = {e: promise_of(linear, e) for e in effects if not (free and e.in_map)}
        return sorted((fit_candidate(linear, e) for e in foremost(promise)), key=score, reverse=True)
    promise = {e: _promise_of_intervals(linear, e, free and e.in_map) for e in effects}
    found: list[Candidate] = []
    for effect in foremost(promise):
        absorbed = free and effect.in_map
        whole = fit_candidate(linear, effect)
        if len(found) < SHORTLIST:
            found.append(with_best_interval(linear, whole, not absorbed))
        elif not absorbed:
            found.append(whole)
    return _plainest_first(sorted(found, key=score, reverse=True), linear.problem)


def _plainest_first(ranked: list[Candidate], problem: Problem) -> list[Candidate]:
    """Return the ranking with the plainest of those that tie with the first, in the same interval, at its head."""
    order = [effect.id for effect in problem.catalogue]
    first = ranked[0]
    tied = [
        c
        for c in ranked
        if score(c) > score(first) - TIE and (c.term.begin, c.term.end) == (first.term.begin, first.term.end)
    ]
    head = min(tied, key=lambda c: order.index(c.id))
    return [head, *(c for c in ranked if c is not head)]


def foremost(promise: Mapping[Effect, float]) -> list[Effect]:
    """Return the effects that promise most, best first."""
    return sorted(promise, key=lambda effect: promise[effect], reverse=True)[:LOOKED_AT]


def _promise_of_intervals(linear: Linear, effect: Effect, absorbed: bool) -> float:
    """Return what an effect promises on the range of blocks, or over the whole logs, that suits it best."""
    blocks = linear.problem.first.size
    gains = gains_of_intervals(linear, slope_of(linear, effect, effect.null))
    tops = [
        float(gains[first, last]) - penalty(1 + (first > 0 and last < blocks), blocks, float(gains[first, last]))
        for first, last in best_intervals(gains)
    ]
    return max(0.0 if absorbed else float(gains[0, blocks]), *tops)


def tried(problem: Problem) -> int:
    """Return how many hypotheses compete."""
    return len(problem.catalogue) + 2 * len(problem.carriers) * len(problem.auxiliary)


def matters(candidate: Candidate, linear: Linear) -> bool:
    """Return whether a candidate explains more than smoothing, a bilinear map and another day leave.

    Where days differ, what acts from the first sample to the last needs more: how much they differ is known from experience alone.
    """
    always = bool(linear.problem.levels) and candidate.changes == 0
    return candidate.gain >= least(linear.problem) * (ALWAYS if always else 1.0)


def least(problem: Problem) -> float:
    """Return the gain that is the least to matter."""
    return max(LEAST_SHARE * 0.5 * problem.data, PROVEN)


def worth(candidate: Candidate, linear: Linear) -> bool:
    """Return whether a candidate is neither chance nor too small to matter."""
    return matters(candidate, linear) and p_value(candidate, tried(linear.problem)) < SIGNIFICANT


def best_of(linear: Linear) -> tuple[list[Candidate], Curve | None]:
    """Return all candidates, best first, channels among them where they beat the catalogue."""
    found = rank(linear, linear.problem.catalogue)
    curves = channel_candidates(linear) if linear.problem.auxiliary else []
    if not curves:
        return found, None
    best, curve = max(curves, key=lambda item: score(item[0]))
    if score(best) > 1.05 * max(score(found[0]), 0.0):
        return [best, *found], curve
    return [*found[:1], best, *found[1:]], curve
