"""Forward selection of effects: add the one that explains most, fit everything again, and stop when no effect is proven."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from typing import Any

from lpvobs.discovery import thresholds
from lpvobs.discovery.companions import (
    has_other_cause,
    is_another_episode,
    is_remainder,
    predicts_better,
    pruned,
    same_place_again,
    separate_in_time,
)
from lpvobs.discovery.course_choice import comes_and_goes, on_courses, sharpened, timed_again
from lpvobs.discovery.episodes import edges_again, from_its_end, in_episodes, shorter
from lpvobs.discovery.evidence import Candidate, dated_again, fit_candidate
from lpvobs.discovery.fit import fit, objective, refit, standard_errors, with_term, without
from lpvobs.discovery.form_search import beside_forms, best_forms
from lpvobs.discovery.forms import CHANNEL, PREFIX, follows_the_time, share_a_signal
from lpvobs.discovery.held_out import Losses, compare, cross_validated
from lpvobs.discovery.inside import settled
from lpvobs.discovery.joint_choice import (
    Accepted,
    at_its_end,
    choose_again,
    choose_all_again,
    finished,
    is_below_none,
    says_something,
)
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.ranking import (
    best_of,
    chance_of_nothing,
    drives_needed,
    each_once,
    is_proven,
    is_relevant,
    is_remnant,
    is_slight,
    is_small,
    is_uneven,
    structure,
)
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.rival_forms import Rivals, beside_names, in_place_of
from lpvobs.discovery.sizes import forget
from lpvobs.engines.effects import Effect

Once = Callable[..., Any]  # returns what work on the same objects gives, or gave before


@dataclass(frozen=True)
class Selection:
    """What the search found."""

    verdict: str  # `effect`, `none` or `unexplained`
    accepted: tuple[Accepted, ...]
    before: Linear  # fitted to all data once everything is decided
    after: Linear  # the same
    losses: Losses  # computed on stretches that no fit and no choice has seen
    ranking: tuple[Candidate, ...]  # of the first round
    p_value: float  # that nothing is there, or where healthy drives tell, nothing that is no changed constant
    leading: tuple[Candidate, ...]  # what comes nearest: what the search had accepted on its way, then the ranking
    needed: tuple[str, int] | None  # verdict `none`: what more healthy drives would prove, and how many in all


@dataclass(frozen=True)
class _Search:
    """Verdict, effects, the model with them, the first round, and what was accepted even where nothing is named in the end."""

    verdict: str
    accepted: Sequence[Candidate]
    linear: Linear
    first: Linear
    ranking: Sequence[Candidate]
    on_the_way: Sequence[Candidate] = ()
    forms: tuple[Effect, ...] = ()  # that came near in the first round, each perhaps of another place


def select(problem: Problem, progress: Callable[[float], None] = lambda _: None) -> Selection:
    """Return the effects that the logs prove, or the verdict that there are none or that something stays unexplained."""
    # The search with formulas takes the steps of the first one where none of them leads.
    once: Once = cache(lambda work, *on: work(*on))
    search = _listed(problem, progress, once, _search(problem, progress, once))
    learned = len(problem.patterns) > 0
    tried = [*search.ranking, *_forms_of(search, once)[:1], *search.on_the_way] if learned else search.ranking
    nothing, named = chance_of_nothing(search.first, tried), search.accepted
    # Where healthy drives tell how errors look, the probability of nothing is that of the verdict.
    unnamed = "none" if learned and nothing >= thresholds.SIGNIFICANT_LEARNED else "unexplained"
    search = replace(search, verdict=unnamed) if learned and search.verdict != "effect" else search
    rivals, search = _rival_forms(search, once), _unless_other_cause(search)
    if search.verdict == "unexplained" or rivals.best is not None:
        leader = rivals.best if rivals.clearly and nothing < thresholds.SIGNIFICANT_LEARNED else None
        search = _with_forms(problem, progress, once, search, leader)
    progress(0.95)
    final, search = _sized(search)
    bare = _bare(final)
    effects = _finished(final, bare, search, rivals.as_good if search.accepted is named else ())
    small, own = any(is_small(term, problem) for term in final.terms), [e.p_value for e in effects]
    told = min([nothing, *own])
    by_chance = learned and len(own) and (told >= thresholds.SIGNIFICANT_LEARNED or max(own) >= thresholds.LIKELY)
    if small or by_chance or not all(map(says_something, effects)):  # once all data tell
        search = _nameless(search, unnamed, search.accepted)
        final = bare = _with_all(search.linear)
        effects, told = (), nothing
    losses = compare(_bare(search.linear), search.linear)
    forget()
    progress(1.0)
    ranking, leading = (each_once(found) for found in (search.ranking, (*search.on_the_way, *search.ranking)))
    needed = drives_needed(tried, problem) if search.verdict == "none" else None
    return Selection(search.verdict, effects, bare, final, losses, ranking, told, leading, needed)


def _finished(final: Linear, bare: Linear, search: _Search, as_good: tuple[Effect, ...]) -> tuple[Accepted, ...]:
    """Return what was accepted as all data tell of it; `as_good` are formulas that rival a listed effect."""
    errors, alone = standard_errors(final), len(final.terms) == 1
    rivals = [search.forms if term.effect in search.forms else as_good for term in final.terms]
    return tuple(
        finished(final, bare if alone else without(final, i), i, c, float(errors[i]), rivals[i])
        for i, c in enumerate(search.accepted)
    )


def _rival_forms(search: _Search, once: Once) -> Rivals:
    """Return the formulas that rival what a search has named: those of the first round, unless a name is as free as they are."""
    instead = in_place_of(search.linear, search.accepted)
    if instead is not None:
        return instead
    first = _forms_of(search, once)[: thresholds.SHORTLIST] if search.accepted else ()
    return beside_names(search.linear, search.accepted, first)


def _forms_of(search: _Search, once: Once) -> Sequence[Candidate]:
    """Return the formulas of the first round, best first; none for a model of blocks, where only what is left is asked for them."""
    first = search.first
    forms: Sequence[Candidate] = (
        once(best_forms, first, once(best_of, first, True)) if first.problem.blocks is None else ()
    )
    return forms


def _with_forms(
    problem: Problem, progress: Callable[[float], None], once: Once, search: _Search, leader: Candidate | None
) -> _Search:
    """Return what the search comes to with formulas among the candidates; only where it proves one that leaves nothing.

    `leader` is a formula that explains clearly more than what was named. The search begins with it. Where it does not end with
    formulas that are few enough, share a signal and take off enough, nothing is named.
    """
    wider = _unless_other_cause(_search(problem, progress, once, with_forms=True, leader=leader))
    few = len(wider.accepted) <= (len(search.accepted) or 3)
    form = few and any(c.id.startswith(PREFIX) for c in wider.accepted)
    of_sensor = [c.id for c in wider.accepted if not c.id.startswith(CHANNEL) or c.term.effect.place == "sensor"]
    if form and share_a_signal(of_sensor) and _leaves_less(wider.linear):
        rivals = tuple(c.term.effect for c in wider.ranking if c.id.startswith(PREFIX))
        return replace(wider, ranking=search.ranking, forms=rivals)
    way = wider.accepted or wider.on_the_way
    if leader is not None and any(c.id.startswith(PREFIX) for c in way):
        return _nameless(search, "unexplained", (leader, *way))
    return replace(search, on_the_way=way or search.on_the_way) if search.verdict == "unexplained" else search


def _listed(problem: Problem, progress: Callable[[float], None], once: Once, search: _Search) -> _Search:
    """Return a search that names a logged channel beside another effect, or one without channels that explains more.

    A channel's curve may stand for two listed effects at once, and then keeps the second of them from its name.
    """
    if len(search.accepted) < 2 or not any(c.id.startswith(CHANNEL) for c in search.accepted):
        return search
    listed = _search(problem, progress, once, channels=False)
    left = objective(refit(search.linear, listed.linear.terms))  # with the same weights
    return replace(listed, ranking=search.ranking) if listed.accepted and left < objective(search.linear) else search


def _leaves_less(linear: Linear) -> bool:
    """Return whether a model with formulas leaves less by what a formula must take off.

    Blocks that are left out tell; where healthy drives tell, too, all of them: the rest is mostly what a healthy engine leaves.
    """
    bare = _bare(linear)
    if len(linear.problem.patterns):
        return objective(linear) < thresholds.FORM_LEAVES * objective(bare)
    return cross_validated(bare, linear).comparison().ratio < thresholds.FORM_LEAVES


def _search(
    problem: Problem,
    progress: Callable[[float], None],
    once: Once,
    with_forms: bool = False,
    leader: Candidate | None = None,
    channels: bool = True,
) -> _Search:
    """Return what the search comes to; kept stretches take no part."""
    before = linear = once(fit, problem)
    ranking: Sequence[Candidate] = ()
    accepted: tuple[Candidate, ...] = ()
    for step in range(thresholds.MOST_EFFECTS):
        progress(0.05 + 0.85 * step / thresholds.MOST_EFFECTS)
        found = once(best_of, linear, channels)
        if with_forms:
            found = beside_forms(linear, found, once(best_forms, linear, found), None if accepted else leader)
        if is_relevant(found[0], linear) and not any(is_proven(c, linear) for c in found):
            found = (once(_beside_itself, linear, found[0]), *found[1:])
        if not (accepted or any(is_proven(c, linear) for c in found)):
            found = (*found, *once(on_courses, linear))
        ranking = ranking or found
        named = {c.id for c in accepted}
        best = next((c for c in found if c.id not in named and is_proven(c, linear)), found[0])
        # More than what may be left: proven, where healthy drives tell how errors look.
        counts = is_proven if len(problem.patterns) else is_relevant
        again = [c for c in (found[0], best) if counts(c, linear) and same_place_again(c, accepted, problem)]
        # One that is less than none all along cannot be: it stands for what the named one leaves.
        if not all(is_below_none(c.term) and c.term.whole for c in again):
            episodes = once(in_episodes, linear, accepted, again[0]) or once(from_its_end, linear, accepted, again[0])
            if episodes is None:
                return _Search("unexplained", [], before, before, ranking, accepted)
            (linear, accepted), found = episodes, ()
            continue
        if not is_proven(best, linear) or best.id in named:
            break
        longer = once(_with_one_more, linear, best, accepted)
        # What is too small for a fault takes no name away from those before it.
        if longer is None or (accepted and is_small(longer[0].terms[-1], problem)):
            break
        (linear, accepted), found = longer, ()
        if any(follows_the_time(c.id) for c in accepted):  # has no name, and leaves room for none
            return _Search("unexplained", [], before, before, ranking, accepted)
    rest, (needed, linear) = [c for c in found if is_proven(c, linear)], pruned(linear, accepted)
    learned = len(problem.patterns) > 0
    uneven = any(is_uneven(c, problem) for c in needed)
    goes = any(t.course is None and comes_and_goes(linear, i) for i, t in enumerate(linear.terms))
    apart = any(separate_in_time(a.term, b.term) for a, b in combinations(needed, 2))
    apart = apart or (learned and any(is_another_episode(c, needed) for c in rest))
    # where healthy drives tell, names have not quite the shape of a cause
    shaped = objective(_bare(linear)) - objective(linear) if learned and needed else 0.0
    varies = structure(linear) >= thresholds.MOST_STRUCTURE * (0.5 * problem.data + shaped)
    if uneven or goes or apart or varies or _has_slight(linear) or any(at_its_end(term) for term in linear.terms):
        return _Search("unexplained", [], before, before, ranking, needed)
    return _Search("effect" if needed else "none", needed, linear, before, ranking)


def _unless_other_cause(search: _Search) -> _Search:
    """Return a search, without its names where the sensor's error has another cause."""
    other = search.verdict == "effect" and has_other_cause(search.linear)
    return _nameless(search, "unexplained", search.accepted) if other else search


def _nameless(search: _Search, verdict: str, on_the_way: Sequence[Candidate]) -> _Search:
    """Return a search that names nothing, with what was accepted on its way."""
    return _Search(verdict, [], search.first, search.first, search.ranking, on_the_way)


def _has_slight(linear: Linear) -> bool:
    """Return whether an effect of the model may be constants that have changed."""
    return any(is_slight(term, linear.problem) for term in linear.terms)


def _beside_itself(linear: Linear, candidate: Candidate) -> Candidate:
    """Return a candidate as the weights that hold beside it judge it: before, what it explains counts as noise."""
    term = candidate.term
    beside = fit(linear.problem, [*linear.terms, term], start=linear)
    again, before = (
        fit_candidate(each, term.effect, size=term.size, like=term) for each in (refit(beside, linear.terms), linear)
    )
    return replace(again, gain=candidate.gain + again.gain - before.gain)  # a curve or a formula has paid its price


def _with_one_more(
    linear: Linear, best: Candidate, accepted: tuple[Candidate, ...]
) -> tuple[Linear, tuple[Candidate, ...]] | None:
    """Return the model with a further effect, and all effects chosen again beside it; None where it does not predict enough."""
    problem = linear.problem
    trial = fit(problem, [*linear.terms, best.term], start=linear)
    named, trial = choose_again(trial, best)
    if not predicts_better(linear, trial, named) or is_remainder(named, accepted, problem) or at_its_end(named.term):
        return None
    return shorter(choose_all_again(trial, (*accepted, named)), in_episodes(linear, accepted, named))


def _bare(linear: Linear) -> Linear:
    """Return the model without effects, its weights those with them."""
    return refit(linear, ()) if linear.terms else linear


def _sized(search: _Search) -> tuple[Linear, _Search]:
    """Return the model fitted to all data, and the search without what is too small for a fault once all data tell."""
    final = _with_all(search.linear)
    small = [i for i, term in enumerate(final.terms) if is_remnant(term, final.problem)]
    if not small or len(final.terms) == 1:
        return final, search
    accepted, terms = list(search.accepted), list(search.linear.terms)
    weakest = min(small, key=lambda i: accepted[i].gain)
    del accepted[weakest], terms[weakest]
    linear = fit(search.linear.problem, terms, start=search.linear)
    return _sized(replace(search, accepted=accepted, linear=linear))


def _with_all(linear: Linear) -> Linear:
    """Return the chosen model fitted to all data, which sharpens all their numbers; the choice of effects stays."""
    problem = linear.problem.with_all()
    final = fit(problem, linear.terms, passes=2, start=linear)
    for i, term in enumerate(final.terms):
        if term.course is not None and term.course.intervals:
            timed = again.term if (again := timed_again(final, i)) else term
            final = with_term(final, i, edges_again(without(final, i), timed))
        if not term.whole:
            final = _with_term(final, i, dated_again(without(final, i), term))
            final = _with_term(final, i, sharpened(final, i))
        final = settled(final, i)
    return final


def _with_term(linear: Linear, i: int, term: Term) -> Linear:
    """Return the model with another term in one place."""
    return linear if term == linear.terms[i] else with_term(linear, i, term)
