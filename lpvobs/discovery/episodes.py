"""What comes and goes: one effect in all its episodes in place of several that are there one after the other."""

from dataclasses import replace

import numpy as np

from lpvobs.discovery.course_choice import by_place, gains, is_worth, may_have_episodes, on_places, timed_again
from lpvobs.discovery.courses import TracedCourse
from lpvobs.discovery.evidence import Candidate, in_place
from lpvobs.discovery.fit import fit, objective
from lpvobs.discovery.joint_choice import choose_all_again
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.residual import Term, are_apart
from lpvobs.discovery.sizes import slope_of
from lpvobs.discovery.thresholds import DATED, HOPELESS, STRETCH, TIE
from lpvobs.records import Array

Model = tuple[Linear, tuple[Candidate, ...]]
"""A model, and what was accepted of it."""


def in_episodes(linear: Linear, accepted: tuple[Candidate, ...], further: Candidate) -> Model | None:
    """Return the model with one effect in several episodes instead of an accepted one and a further one at another time.

    It is the accepted one, or the further one if both have one place; or the same effect acts then alone. None where there is none,
    or it has been in its episodes before.
    Without healthy drives, what comes and goes like that may be any disturbance.
    """
    if not len(linear.problem.patterns):
        return None
    for i, (term, candidate) in enumerate(zip(linear.terms, accepted, strict=True)):
        same = term.effect.place == further.term.effect.place
        if not (same or are_apart(term, further.term)):
            continue
        tried = [_with_episodes(linear, i, own) for own in ((candidate, further) if same else (candidate,))]
        found = [each for each in (*tried, _moved(linear, i, further)) if each is not None]
        if found:
            again, own = min(found, key=lambda each: objective(each[0]))
            return choose_all_again(again, (*accepted[:i], in_place(again, i, own), *accepted[i + 1 :]))
    return None


def shorter(longer: Model, episodes: Model | None) -> Model:
    """Return the model with an effect in episodes, if it leaves no more than the one with a further effect does."""
    return longer if episodes is None or objective(episodes[0]) > objective(longer[0]) + TIE else episodes


def from_its_end(linear: Linear, accepted: tuple[Candidate, ...], further: Candidate) -> Model | None:
    """Return the model with a further effect from where it would end; None where that leaves more, or healthy drives tell nothing.

    An accepted effect beside it, which stands for both, is too large before.
    """
    term = further.term
    if not (np.isfinite(term.end) and len(linear.problem.patterns)):
        return None
    until = fit(linear.problem, [*linear.terms, term], start=linear)
    turned = replace(term, begin=term.end, end=np.inf, size=2.0 * term.effect.null - term.size)
    trial = fit(linear.problem, [*linear.terms, turned], start=linear)
    left, least, most = (objective(each) for each in (trial, until, linear))
    if most - left < HOPELESS * (most - least):  # what is as good once all are chosen again takes much of that before
        return None
    named = in_place(trial, len(accepted), replace(further, term=trial.terms[-1]))
    again, longer = choose_all_again(trial, (*accepted, named))
    return (again, longer) if objective(again) < least + TIE else None


def edges_again(bare: Linear, term: Term) -> Term:
    """Return what comes and goes, each edge moved by a stretch at most to where it gains clearly more with all unknowns fitted.

    `bare` is the model without it. Once an edge in a stretch that was kept back stayed at the end of that: the unknowns of a model
    with the wrong edge had taken the rest.
    """
    course, problem = term.course, bare.problem
    if course is None:
        return term
    each, slope = by_place(bare), slope_of(bare, term.effect, term.effect.null)
    block, edges = 2.0 * float(np.median(np.diff(problem.begins))), np.ravel(course.intervals)
    for reach, tried in ((STRETCH + block, problem.begins), (block, 0.5 * (problem.clock[1:] + problem.clock[:-1]))):
        for i, edge in enumerate(edges):
            low, high = max(edge - reach, *edges[:i], -np.inf), min(edge + reach, *edges[i + 1 :], np.inf)
            at = np.append(edge, tried[(tried > low) & (tried < high)])
            moved = np.tile(edges, (at.size, 1))
            moved[:, i] = at
            gain = gains(each, slope, np.array([problem.share(_between(course, one)) for one in moved]))
            edges[i] = at[np.argmax(gain)] if gain.max() > gain[0] + DATED else edge
    return replace(on_places(term.effect, _between(course, edges), problem), size=term.size)


def _between(course: TracedCourse, edges: Array) -> TracedCourse:
    """Return a course whose intervals have these edges, one after the other."""
    return replace(course, intervals=tuple((float(a), float(b)) for a, b in edges.reshape(-1, 2)))


def _moved(linear: Linear, i: int, further: Candidate) -> tuple[Linear, Candidate] | None:
    """Return the model with an effect at another time than it was accepted at, if it leaves less: beside others it acts then."""
    if further.id != linear.terms[i].effect.id:
        return None
    moved = fit(linear.problem, [*linear.terms[:i], further.term, *linear.terms[i + 1 :]], start=linear)
    return (moved, further) if objective(moved) < objective(linear) - TIE else None


def _with_episodes(linear: Linear, i: int, own: Candidate) -> tuple[Linear, Candidate] | None:
    """Return the model with an effect on intervals in one place, and the effect; None where these explain no more than one."""
    effect, terms = own.term.effect, list(linear.terms)
    if terms[i].course is not None or not may_have_episodes(effect, linear.problem):
        return None
    if effect != terms[i].effect:
        terms[i] = replace(own.term, begin=terms[i].begin, end=terms[i].end)
        linear = fit(linear.problem, terms, start=linear)
    again = timed_again(linear, i)
    if again is None or not is_worth(again, in_place(linear, i, own)):
        return None
    terms[i] = again.term
    return fit(linear.problem, terms, start=linear), again
