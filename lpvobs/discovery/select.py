"""Forward selection: the effect that explains most, then map, constants and effects anew, until nothing is left worth a name."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy.stats

from lpvobs.discovery.channels import Curve
from lpvobs.discovery.episodes import comes_and_goes, sharpened
from lpvobs.discovery.evidence import (
    Candidate,
    dated_again,
    fit_candidate,
    in_place,
    loss_of,
    p_value,
    promise_of,
    score,
)
from lpvobs.discovery.fit import fit, refit
from lpvobs.discovery.held_out import Losses, compare, cross_validated
from lpvobs.discovery.intervals import standard_errors
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.ranking import best_of, foremost, matters, tried, uneven_share, worth
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.settling import Named, exchanged, settled, without
from lpvobs.discovery.thresholds import (
    AGAIN,
    ALIKE,
    MOST_EFFECTS,
    MOST_STRUCTURE,
    MOST_UNEVEN,
    REST,
    STRETCH,
    STRUCTURE_LEFT,
    WEAKEST,
)


@dataclass(frozen=True)
class Accepted:
    """An effect that became part of the model.

    Attributes
    ----------
    candidate : Candidate
        As fitted beside all the others, with the final weights.
    p_value : float
    share : float
        Of the half sum of squares above noise that was there before any effect.
    alike : tuple of str
        Effects that explain it as well.
    curve : Curve or None
        For a channel.
    standard_error : float
        Of the size, in its unit; of a channel's curve, of its multiple.
    """

    candidate: Candidate
    p_value: float
    share: float
    alike: tuple[str, ...]
    curve: Curve | None
    standard_error: float


@dataclass(frozen=True)
class Selection:
    """What the search found.

    Attributes
    ----------
    verdict : str
        `effect`, `none` or `unexplained`.
    accepted : tuple of Accepted
    before, after : Linear
        Made with all data once everything is decided.
    losses : Losses
        Of the models that were made and chosen without the stretches they are computed on.
    ranking : tuple of Candidate
        Of the first round.
    """

    verdict: str
    accepted: tuple[Accepted, ...]
    before: Linear
    after: Linear
    losses: Losses
    ranking: tuple[Candidate, ...]


def select(problem: Problem, progress: Callable[[float], None] = lambda _: None) -> Selection:
    """Return what the logs hold that the model lacks."""
    verdict, accepted, linear, ranking = _search(problem, progress)
    losses = compare(_bare(linear), linear)
    final = _with_all(linear)
    progress(0.95)
    errors = standard_errors(final)
    bare = _bare(final)
    found = tuple(
        _finished(final, bare if len(accepted) == 1 else without(final, i), i, c, curve, float(errors[i]))
        for i, (c, curve) in enumerate(accepted)
    )
    progress(1.0)
    return Selection(verdict, found, bare, final, losses, tuple(ranking))


def _search(problem: Problem, progress: Callable[[float], None]) -> tuple[str, list[Named], Linear, list[Candidate]]:
    """Return verdict, effects, the model with them, and the ranking of the first round; no kept stretch is looked at."""
    before = linear = fit(problem)
    ranking: list[Candidate] = []
    accepted: list[Named] = []
    for step in range(MOST_EFFECTS):
        progress(0.05 + 0.85 * step / MOST_EFFECTS)
        found, curve = best_of(linear)
        ranking = ranking or found
        best = next((c for c in found if worth(c, linear)), found[0])
        if any(_twice_to_blame(c, accepted) for c in (found[0], best) if matters(c, linear)):
            return "unexplained", [], before, ranking
        if not worth(best, linear):
            break
        if any(c.id == best.id for c, _ in accepted):
            break
        trial = fit(problem, [*linear.terms, best.term], start=linear)
        named, trial = settled(trial, best, curve if best.id.startswith("channel:") else None)
        if not _holds_out(linear, trial) or _only_a_rest(named[0], accepted, problem):
            break
        linear, accepted = exchanged(trial, [*accepted, named])
    accepted, linear = _pruned(linear, accepted)
    uneven = any(uneven_share(c, problem) > MOST_UNEVEN for c, _ in accepted)
    goes = any(comes_and_goes(linear, i) for i in range(len(accepted)))
    apart = any(_apart(a.term, b.term) for (a, _), (b, _) in combinations(accepted, 2))
    if uneven or goes or apart or _left_over(before, linear):
        return "unexplained", [], before, ranking
    return "effect" if accepted else "none", accepted, linear, ranking


def _bare(linear: Linear) -> Linear:
    """Return the model without effects, its weights those with them."""
    return refit(linear, ()) if linear.terms else linear


def _with_all(linear: Linear) -> Linear:
    """Return the chosen model made from all data: what was kept back sharpens sizes and onsets, and chooses nothing."""
    problem = linear.problem.with_all()
    final = fit(problem, linear.terms, passes=2, start=linear)
    for i, term in enumerate(final.terms):
        if np.isfinite(term.begin) or np.isfinite(term.end):
            final = _with_term(final, i, dated_again(without(final, i), term))
            final = _with_term(final, i, sharpened(final, i))
    return final


def _with_term(linear: Linear, i: int, term: Term) -> Linear:
    """Return the model with another term in one place."""
    return linear if term == linear.terms[i] else refit(linear, [*linear.terms[:i], term, *linear.terms[i + 1 :]])


def structure(linear: Linear) -> float:
    """Return what sizes of their own for every block would gain, for the effect of general kind that gains most so."""
    blocks = linear.problem.coarse_blocks
    named = {term.effect.id for term in linear.terms}
    carriers = [effect for effect in linear.problem.carriers if effect.id not in named]
    return max(0.5 * (fit_candidate(linear, effect).elsewhere - 1.0) * blocks for effect in carriers)


def _left_over(before: Linear, after: Linear) -> bool:
    """Return whether the residual has a structure in time that the named effects do not explain."""
    left = structure(after)
    if left < MOST_STRUCTURE * 0.5 * after.problem.data:
        return False
    return after is before or left > STRUCTURE_LEFT * structure(refit(after, ()))


def _holds_out(before: Linear, after: Linear) -> bool:
    """Return whether blocks that an effect was not fitted to are predicted better with it."""
    return cross_validated(refit(after, before.terms), after).comparison().ratio < 1.0


def _only_a_rest(candidate: Candidate, accepted: Sequence[Named], problem: Problem) -> bool:
    """Return whether an effect is what others leave in fast transients or at their edges.

    It is little beside them, and has no one size or both begins and ends.
    """
    most = max((c.gain for c, _ in accepted), default=0.0)
    little = candidate.gain < min(AGAIN * most, REST * 0.5 * problem.data)
    return little and (candidate.changes > 1 or uneven_share(candidate, problem) > MOST_UNEVEN)


def _pruned(linear: Linear, accepted: list[Named]) -> tuple[list[Named], Linear]:
    """Return the effects that the others have not made superfluous, and the model without the rest."""
    while accepted:
        accepted = [(in_place(linear, i, c), curve) for i, (c, curve) in enumerate(accepted)]
        weakest = int(np.argmin([wald(c) for c, _ in accepted]))
        if wald(accepted[weakest][0]) >= WEAKEST:
            break
        accepted = [item for i, item in enumerate(accepted) if i != weakest]
        terms = [t for i, t in enumerate(linear.terms) if i != weakest]
        linear = fit(linear.problem, terms, start=linear)
    return accepted, linear


def wald(candidate: Candidate) -> float:
    """Return the squared distance of a size from none, over its variance."""
    away = candidate.term.size - candidate.term.effect.null
    return float(away**2 * candidate.information / max(candidate.unevenness, 1.0))


def _twice_to_blame(candidate: Candidate, accepted: Sequence[Named]) -> bool:
    """Return whether the same place is to blame twice, at different times: no cause of the catalogue does that.

    The second time it is the same effect, or one that starts and stops beside one with an onset. It need not be worth a name: two
    episodes and the pause between them have no one size.
    """
    stops = candidate.changes > 0 and bool(np.isfinite(candidate.term.end))
    return any(
        (c.id == candidate.id and candidate.gain > AGAIN * c.gain)
        or (
            c.term.effect.place == candidate.term.effect.place
            and c.changes > 0
            and stops
            and (candidate.gain > AGAIN * c.gain or _apart(c.term, candidate.term))
        )
        for c, _ in accepted
    )


def _apart(one: Term, other: Term) -> bool:
    """Return whether terms of one place act one well before the other: farther apart than an edge that is badly placed reaches."""
    apart = one.end + STRETCH < other.begin or other.end + STRETCH < one.begin
    return bool(apart and one.effect.place == other.effect.place)


def _finished(
    linear: Linear, bare: Linear, index: int, candidate: Candidate, curve: Curve | None, standard_error: float
) -> Accepted:
    problem = linear.problem
    term = linear.terms[index]
    own = replace(in_place(linear, index, candidate), gain=float((loss_of(bare) - loss_of(linear)).sum()))
    absorbing = problem.prior.free and own.changes == 0
    others = [e for e in problem.catalogue if e.id != own.id and not (absorbing and e.in_map)]
    promise = {e: promise_of(bare, e, term.begin, term.end) for e in others}
    rivals = sorted((fit_candidate(bare, e, term.begin, term.end) for e in foremost(promise)), key=score, reverse=True)
    like = fit_candidate(bare, term.effect, term.begin, term.end, term.size)  # judged as the rivals are
    alike = tuple(c.id for c in rivals if _cannot_be_told(like, c, problem.per_coarse))
    share = own.gain / max(float(loss_of(bare).sum()), own.gain, 1e-300)
    return Accepted(own, p_value(own, tried(problem)), share, alike, curve, standard_error)


def _cannot_be_told(best: Candidate, other: Candidate, per_coarse: int) -> bool:
    """Return whether the differences of the losses by block are as often, and as much, the one way as the other.

    Both by their sum (after Vuong) and by their signed ranks: one block with a large difference spoils the one, many with small
    ones the other.
    """
    difference = np.add.reduceat(other.loss - best.loss, np.arange(0, best.loss.size, per_coarse))
    ranks = scipy.stats.rankdata(np.abs(difference)) * np.sign(difference)
    told = (float(x.sum() / max(np.sqrt(x @ x), 1e-300)) for x in (difference, ranks))
    return max(told) <= ALIKE and other.gain > 0.5 * best.gain
