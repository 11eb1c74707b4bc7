"""The second choice of an effect: size, interval and name once map, constants and the other effects are fitted beside it.

Of those that stay it says which others explain the logs as well.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpvobs.discovery.course_choice import (
    best_course,
    finer,
    fit_course,
    is_worth,
    sharpened,
    timed_again,
    with_courses,
)
from lpvobs.discovery.courses import GRADED, Curve, FactorSurface, can_be_graded
from lpvobs.discovery.curves import channel_candidates, curve_in_place_of, onset, surface_again
from lpvobs.discovery.evidence import (
    Candidate,
    best_first,
    fit_candidate,
    in_place,
    loss_of,
    score,
    stays,
    with_best_interval,
)
from lpvobs.discovery.fit import fit, objective, refit, with_term, without
from lpvobs.discovery.forms import PREFIX, cause_of, share_a_signal, without_variants
from lpvobs.discovery.inside import Number, with_inside
from lpvobs.discovery.known_effects import NINETY
from lpvobs.discovery.linear import Linear, changed_by, dot
from lpvobs.discovery.ranking import chance, each_once, is_proven, rank, rank_in
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.sizes import slope_of
from lpvobs.discovery.thresholds import (
    AS_WELL,
    CLOSE,
    FORM_ALIKE,
    HALF_WIDTH,
    ONE_SIDED,
    PASSES,
    SHAPE,
    SHORTLIST,
    TIE,
)
from lpvobs.engines.effects import Effect


def choose_again(linear: Linear, candidate: Candidate) -> tuple[Candidate, Linear]:
    """Return the newest effect, or the one that explains the residual better now that the fault no longer inflates the weights.

    The curve over a channel is found again.
    """
    problem, newest, curve = linear.problem, len(linear.terms) - 1, candidate.term.curve
    course = linear.terms[newest].course is not None
    if course or isinstance(curve, FactorSurface):
        simpler = _simpler(linear, candidate)
        if simpler is not None:
            linear, candidate = fit(problem, [*linear.terms[:newest], simpler.term], start=linear), simpler
            return choose_again(linear, candidate) if simpler.term.course is None else _course_again(linear, candidate)
        return _course_again(linear, candidate) if course else _curve_again(linear, candidate)
    bare = without(linear, newest)
    if isinstance(curve, Curve):
        own = fit_candidate(bare, candidate.term.effect, size=linear.terms[newest].size, like=linear.terms[newest])
        own = replace(own, gain=own.gain - curve.cost)
        for again in channel_candidates(bare, SHORTLIST):
            if again.id == own.id and objective(refit(linear, [*bare.terms, again.term])) < objective(linear) - TIE:
                own, linear = again, fit(problem, [*bare.terms, again.term], start=linear)
        return in_place(linear, newest, own), linear
    again = fit_candidate(bare, candidate.term.effect, candidate.term.begin, candidate.term.end, candidate.term.size)
    others, span = _others(bare), (again.term.begin, again.term.end)
    ranked = rank_in(bare, [effect for effect in others if not problem.absorbs(effect)])[:SHORTLIST]
    # What stands out all along and what does in the interval need not be the same.
    acting = _acting(problem, others, again.term)
    here = rank_in(bare, acting, *span)[:SHORTLIST] if again.changes else []
    unusual = [fit_candidate(bare, each, *span) for effect in acting for each in effect.variants]
    alike = _in_its_place(linear, bare, newest)
    rivals = [again, with_best_interval(bare, again), *alike, *ranked, *here, *unusual]
    proven = [rival for rival in rivals if is_proven(rival, bare)] or [again]
    again = _joint_best(linear, again, best_first(proven))
    if again.term != linear.terms[newest]:
        linear = fit(problem, [*bare.terms, again.term], start=linear)
        bare = without(linear, newest)
    effects = dict.fromkeys(rival.term.effect for rival in best_first(proven) if rival.id != again.id)
    on_course = best_course(linear, bare, again, [each for each in effects if each in problem.catalogue][:SHORTLIST])
    # Errors of a healthy engine that change slowly look like a course over time, hardly like an onset.
    unproven = on_course.in_time and is_proven(again, bare) and not is_proven(on_course, bare)
    if on_course is not again and not unproven and _is_better(linear, bare, on_course, again):
        return _course_again(fit(problem, [*bare.terms, on_course.term], start=linear), on_course)
    curved = curve_in_place_of(bare, again.term)
    if curved is not None and score(curved) > score(again) + TIE and is_proven(curved, bare):
        found = _curve_again(fit(problem, [*bare.terms, curved.term], start=linear), curved)
        if not at_its_end(found[1].terms[newest]):
            return found
    if again.changes:
        linear = fit(problem, [*bare.terms, sharpened(linear, newest)], start=linear)
    return in_place(linear, newest, again), linear


def _course_again(linear: Linear, found: Candidate) -> tuple[Candidate, Linear]:
    """Return the newest effect of a model, `found`, with its course sought again beside the weights that it leaves."""
    newest, course = len(linear.terms) - 1, found.term.course
    bare, nearer = without(linear, newest), found
    if course is None or not course.intervals:
        nearer = finer(bare, found)
    elif (again := timed_again(linear, newest)) is not None and again.term.course != course:
        nearer = again
    if nearer.term.course != course:
        linear = fit(linear.problem, [*bare.terms, nearer.term], start=linear)
    return in_place(linear, newest, nearer), linear


def _acting(problem: Problem, effects: Sequence[Effect], term: Term) -> list[Effect]:
    """Return the effects that may act when a term does."""
    return [effect for effect in effects if not (np.isfinite(term.end) and stays(problem, effect))]


def _others(bare: Linear) -> list[Effect]:
    """Return the effects of the catalogue that a model does not have."""
    taken = {term.effect.id for term in bare.terms}
    return [effect for effect in bare.problem.catalogue if effect.id not in taken]


def _simpler(linear: Linear, candidate: Candidate) -> Candidate | None:
    """Return an effect or a logged channel, on whatever course, that explains more than a component's curve or another course."""
    newest, bare = len(linear.terms) - 1, without(linear, len(linear.terms) - 1)
    own = fit_candidate(bare, candidate.term.effect, size=linear.terms[newest].size, like=linear.terms[newest])
    ranked = rank(bare, _others(bare))[:SHORTLIST]
    best = best_course(linear, bare, ranked[0], [c.term.effect for c in ranked[1:]])
    if isinstance(surface := candidate.term.curve, FactorSurface):
        return best if score(best) > score(own) - surface.cost else None
    return best if score(best) > score(own) and is_proven(best, bare) else None


def _curve_again(linear: Linear, candidate: Candidate) -> tuple[Candidate, Linear]:
    """Return a component's curve that follows map, constants and weights which now go with it, and the model with that.

    It begins where it then explains most.
    """
    newest = len(linear.terms) - 1
    bare, term, surface = without(linear, newest), linear.terms[newest], candidate.term.curve
    if not isinstance(surface, FactorSurface):
        raise TypeError("a component's curve follows a surface")
    own = with_best_interval(bare, fit_candidate(bare, term.effect, size=term.size, like=term))
    for begin in onset(own.term):
        candidate = replace(candidate, gain=own.gain - surface.cost)
        linear = fit(linear.problem, [*bare.terms, replace(term, begin=begin)], start=linear)
    for _ in range(PASSES):
        moved = surface_again(linear, newest, surface)
        if moved is None:
            break
        surface, term = moved
        linear = fit(linear.problem, [*linear.terms[:newest], term], passes=1, start=linear)
    bare, term = without(linear, newest), linear.terms[newest]
    own = fit_candidate(bare, term.effect, size=term.size, like=term)
    return in_place(linear, newest, replace(own, gain=candidate.gain)), linear


def at_its_end(term: Term) -> bool:
    """Return whether an effect stands for another.

    It does if it is a curve or a coefficient as large as it can be, or a lag or a leak below none. Others may well be as large as
    they are sought: a valve that is stuck shut.
    """
    effect, shaped = term.effect, isinstance(term.curve, FactorSurface) or term.effect.parameter == "coefficient"
    return is_below_none(term) or (shaped and not effect.low < term.size < effect.high)


def is_below_none(term: Term) -> bool:
    """Return whether an effect that is there or not is less than not there."""
    effect = term.effect
    return effect.null == 0.0 and -effect.low <= ONE_SIDED * effect.high and term.size < 0.0


def choose_all_again(linear: Linear, accepted: tuple[Candidate, ...]) -> tuple[Linear, tuple[Candidate, ...]]:
    """Return the model with every earlier effect chosen again beside the newest one, which may explain part of what they did."""
    for number in range(len(accepted) if len(accepted) > 1 else 0):
        linear = refit(linear, [*linear.terms[1:], linear.terms[0]])
        first = accepted[0]
        if number < len(accepted) - 1:
            first, linear = choose_again(linear, first)
        accepted = (*accepted[1:], first)
    return linear, accepted


def _joint_best(linear: Linear, newest: Candidate, ranked: Sequence[Candidate]) -> Candidate:
    """Return the newest effect or a close rival: the one that gains most when all unknowns are fitted with it."""
    # The residual is not linear in a large effect, so the newest is tried whatever its own score. Each effect is tried on
    # its best interval and on the whole logs, the newest on the interval that it has as well.
    others, own = linear.terms[:-1], linear.terms[-1]
    close: dict[tuple[Effect, bool, bool], Candidate] = {}
    for candidate in ranked:
        term = candidate.term
        same = (term.effect, term.begin, term.end) == (own.effect, own.begin, own.end)
        if not same and score(candidate) > CLOSE * score(ranked[0]):
            ends = bool(np.isfinite(term.begin)), bool(np.isfinite(term.end))
            close.setdefault((term.effect, *ends), candidate)
    newest = replace(newest, term=own)
    if not close:
        return newest
    bare = objective(refit(linear, others))
    joint = [
        (score(found), candidate)
        for candidate in (newest, *close.values())
        if (found := _jointly(linear, others, candidate, bare))
    ]
    return max(joint, key=lambda each: each[0], default=(0.0, newest))[1]


def _in_its_place(linear: Linear, bare: Linear, index: int) -> list[Candidate]:
    """Return the other effects at the place of one of a model, sought from where they change the residual most nearly as it does.

    The residual is linear in what the sensor reads. In a large effect elsewhere it is not, and a search from none may end early.
    """
    term, problem = linear.terms[index], linear.problem
    if term.effect.place == "sensor" or term.course is not None or term.curve is not None:
        return []
    changed, on, found = linear.whiten(changed_by(linear, index)), term.acts(problem.clock), []
    for effect in _others(linear):
        if effect.place == term.effect.place and not (term.whole and problem.absorbs(effect)):
            slope = linear.whiten(slope_of(bare, effect, effect.null) * on)
            size = effect.null + dot(slope, changed) / max(dot(slope, slope), 1e-300)
            size = float(np.clip(size, effect.low, effect.high))
            found.append(fit_candidate(bare, effect, term.begin, term.end, size))
    return found


def _is_better(linear: Linear, bare: Linear, other: Candidate, own: Candidate) -> bool:
    """Return whether another candidate gains more than its own one when all unknowns are fitted with either."""
    # To first order an effect that is far from its true size may seem to explain what a large fault does to the residual.
    without_both = objective(bare)
    theirs, ours = (_jointly(linear, bare.terms, each, without_both) for each in (other, own))
    return theirs is not None and (ours is None or is_worth(theirs, ours))


def _jointly(linear: Linear, others: tuple[Term, ...], candidate: Candidate, bare: float) -> Candidate | None:
    """Return a candidate with what it gains in the joint model, None at the end of its size's range."""
    joint = refit(linear, [*others, candidate.term])
    last = joint.terms[-1]
    inside = last.effect.low < last.size < last.effect.high
    return replace(candidate, gain=bare - objective(joint)) if inside else None


@dataclass(frozen=True)
class Accepted:
    """An effect that became part of the model."""

    candidate: Candidate  # fitted beside all the others, with the final weights
    p_value: float
    share: float  # of half the sum of squares before any effect
    indistinguishable: tuple[str, ...]  # effects that explain the logs as well
    standard_error: float  # of the size, in its unit; of a channel's curve, of its multiple
    further: Mapping[str, Number]  # what the effect has inside, by name


def finished(
    linear: Linear, bare: Linear, index: int, candidate: Candidate, standard_error: float, forms: tuple[Effect, ...]
) -> Accepted:
    """Return an effect of the final model with what is said of it; `bare` is the model without it, `forms` are its rivals."""
    problem = linear.problem
    term = linear.terms[index]
    own = replace(in_place(linear, index, candidate), gain=float((loss_of(bare) - loss_of(linear)).sum()))
    like = _as_fitted(linear, bare, own)
    others = [e for e in _others(linear) if own.changes or not problem.absorbs(e)]
    others += [replace(e, apply=law, straight=False) for e in others for law in e.laws]
    others += [e for e in forms if cause_of(e.id) != cause_of(own.id)]
    if term.course is not None:
        able = [e for e in with_courses(others) if term.course.name not in GRADED or can_be_graded(e)]
        rivals = best_first(fit_course(bare, e, term.course) for e in able)
    else:
        rivals = rank_in(bare, _acting(problem, others, term), term.begin, term.end)
    driven = channel_candidates(bare, SHORTLIST) if isinstance(term.curve, Curve) else []
    near = each_once(best_first([*each_once(rivals)[:SHORTLIST], *_in_its_place(linear, bare, index), *driven]))
    close = [c for c in near if c.gain > AS_WELL * like.gain]
    beside = [_as_fitted(with_term(linear, index, c.term), bare, c) for c in close]  # all unknowns fitted with each
    alike = dict.fromkeys([own.id, *(c.id for c in beside if fits_as_well(like, c, problem))])
    indistinguishable = tuple(id_ for id_ in without_variants(list(alike)) if id_ != own.id)
    share = own.gain / max(float(loss_of(bare).sum()), own.gain, 1e-300)
    p_value = chance(replace(own, gain=own.gain - own.paid), problem)
    return Accepted(own, p_value, share, indistinguishable, *error_of(linear, index, standard_error))


def error_of(linear: Linear, index: int, standard_error: float) -> tuple[float, Mapping[str, Number]]:
    """Return the standard error of a size with all that is inside the effect unknown, too, and what is inside it by name."""
    curve = linear.terms[index].curve
    standard_error, further = with_inside(linear, index, standard_error)
    return float(np.hypot(standard_error, curve.error)) if isinstance(curve, FactorSurface) else standard_error, further


def says_something(effect: Accepted) -> bool:
    """Return whether a listed effect's interval is all on one side of none, or a formula says what many that explain as much do.

    If formulas that explain the logs as well are many, they must have a signal in common.
    """
    term, form = effect.candidate.term, effect.candidate.id.startswith(PREFIX)
    if not form:
        return abs(term.size - term.effect.null) > NINETY * effect.standard_error
    alike = [id_ for id_ in (effect.candidate.id, *effect.indistinguishable) if id_.startswith(PREFIX)]
    return len(alike) < FORM_ALIKE or share_a_signal(alike)


def _as_fitted(linear: Linear, bare: Linear, candidate: Candidate) -> Candidate:
    """Return an effect with losses of the model that has it, and what it gains there, less what a curve's coefficients cost."""
    cost = 0.0 if candidate.term.curve is None else candidate.term.curve.cost
    return replace(candidate, gain=objective(bare) - objective(linear) - cost, loss=loss_of(linear))


def fits_as_well(best: Candidate, other: Candidate, problem: Problem) -> bool:
    """Return whether another effect explains the log as well as the best one does.

    Two tests compare the losses by block, and neither may prefer the best effect: the sum of the differences (after Vuong), which
    a single block with a large difference may spoil, and their signed ranks, which many blocks with small differences may spoil.
    Where all blocks together differ by less than a tie, neither test is needed. Where healthy drives tell, the engine is not the
    model, and a cause is not quite the catalogue's: gains that differ by what its shape is off by are a tie. A dead time and a
    slow response that are shorter than the window of a place differ in the fastest changes alone, in which such an engine has
    errors of its own: either may be the other.
    """
    learned = len(problem.patterns) > 0
    tie = max(TIE, SHAPE**2 * best.gain if learned else 0.0)
    if other.gain > best.gain - tie:
        return True
    short = [each.term.effect.late and abs(each.term.size) < 2.0 * HALF_WIDTH for each in (best, other)]
    if learned and all(short):
        return other.gain > AS_WELL * best.gain
    difference = problem.by_coarse(other.loss - best.loss)
    ranks = (1 + np.argsort(np.argsort(np.abs(difference)))) * np.sign(difference)
    statistics = (float(x.sum() / max(np.sqrt(x @ x), 1e-300)) for x in (difference, ranks))
    return max(statistics) <= NINETY and other.gain > AS_WELL * best.gain
