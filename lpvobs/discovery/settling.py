"""An effect settled in the joint model: its size, its interval and its name, once all unknowns have followed it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lpvobs.discovery.channels import Curve
from lpvobs.discovery.episodes import sharpened
from lpvobs.discovery.evidence import Candidate, fit_candidate, in_place, penalty, score, with_best_interval
from lpvobs.discovery.fit import fit, objective, refit
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.ranking import rank
from lpvobs.discovery.residual import Term
from lpvobs.discovery.thresholds import CLOSE, SHORTLIST

Named = tuple[Candidate, Curve | None]
"""An effect and, for a channel, its curve."""


def without(linear: Linear, index: int) -> Linear:
    """Return the model without one of its effects."""
    terms = tuple(t for i, t in enumerate(linear.terms) if i != index)
    return refit(linear, terms)


def settled(linear: Linear, candidate: Candidate, curve: Curve | None) -> tuple[Named, Linear]:
    """Return the newest effect judged again with weights that it no longer inflates, exchanged if another one fits better."""
    problem, newest = linear.problem, len(linear.terms) - 1
    bare = without(linear, newest)
    again = fit_candidate(bare, candidate.term.effect, candidate.term.begin, candidate.term.end, candidate.term.size)
    if curve is None:
        absorbed = problem.prior.free and again.term.effect.in_map
        rivals = [again, with_best_interval(bare, again, not absorbed)]
        taken = {term.effect.id for term in bare.terms}
        others = [effect for effect in problem.catalogue if effect.id not in taken]
        for rival in rank(bare, others, intervals=False)[:SHORTLIST]:
            rivals += [rival, fit_candidate(bare, rival.term.effect, again.term.begin, again.term.end)]
        again = _joint_best(linear, again, sorted(rivals, key=score, reverse=True))
        if again.term != linear.terms[newest]:
            linear = fit(problem, [*bare.terms, again.term], start=linear)
    if again.changes:
        linear = fit(problem, [*bare.terms, sharpened(linear, newest)], start=linear)
    return (in_place(linear, newest, again), curve), linear


def exchanged(linear: Linear, accepted: list[Named]) -> tuple[Linear, list[Named]]:
    """Return the model with all but the newest effect judged again beside it: it may be part of what they stood for."""
    for number in range(len(accepted) if len(accepted) > 1 else 0):
        linear = refit(linear, [*linear.terms[1:], linear.terms[0]])
        first = accepted[0]
        if number < len(accepted) - 1:
            first, linear = settled(linear, *first)
        accepted = [*accepted[1:], first]
    return linear, accepted


def _joint_best(linear: Linear, newest: Candidate, ranked: Sequence[Candidate]) -> Candidate:
    """Return the newest effect or a close rival, the one that gains most after all unknowns have followed.

    A large effect bends more than a step shows, so the newest is tried whatever its own score. Of each effect the best interval
    and the whole logs are tried.
    """
    others = linear.terms[:-1]
    newest = replace(newest, term=linear.terms[-1])
    close: dict[tuple[str, bool, bool], Candidate] = {}
    for candidate in [newest, *ranked]:
        if candidate is newest or score(candidate) > CLOSE * score(ranked[0]):
            ends = bool(np.isfinite(candidate.term.begin)), bool(np.isfinite(candidate.term.end))
            close.setdefault((candidate.id, *ends), candidate)
    if len(close) == 1:
        return newest
    bare = objective(refit(linear, others))
    joint_score = {key: _joint_score(linear, others, candidate, bare) for key, candidate in close.items()}
    return close[max(joint_score, key=lambda key: joint_score[key])]


def _joint_score(linear: Linear, others: tuple[Term, ...], candidate: Candidate, bare: float) -> float:
    """Return the gain of a candidate less what its interval costs, in the joint model; nothing at the end of its size's range."""
    joint = refit(linear, [*others, candidate.term])
    last = joint.terms[-1]
    if not last.effect.low < last.size < last.effect.high:
        return -np.inf
    gain = bare - objective(joint)
    return gain - penalty(candidate.changes, candidate.loss.size, gain, candidate.from_start)
