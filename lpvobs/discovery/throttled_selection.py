"""Which effects a log proves: the best candidate first, then what still is missing beside it, then what cannot be told apart."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.stats

from lpvobs.discovery.throttled_case import Case, Term
from lpvobs.discovery.throttled_errors import (
    MOST_DAILY,
    Weighed,
    daily_sizes,
    on_its_day,
    strangeness_of,
    stretched,
    weighed,
)
from lpvobs.discovery.throttled_evidence import Fit
from lpvobs.discovery.throttled_search import best_shift, refit, search
from lpvobs.engines.throttled.effects import Effect
from lpvobs.records import Array

PROVEN = 15.0
"""Score from which an effect with an onset is named: e^-15, and a margin for errors that are not quite as they are assumed."""
PROVEN_ALWAYS = 30.0
"""The same where it acts all the time: how days differ is known from experience alone, not from the healthy log."""
NEXT = 0.1
"""Share of the first effect's gain that a further one must have: a large effect is never undone without a rest."""
MOST = 3
DAY_PASSES = 2
"""Times that the day's zeros are sought anew about the last ones: curves are not straight."""
ALIKE = 6.0
"""Difference of gains that does not tell two candidates apart."""
TIE = 1.0
"""Difference of gains that is none: the simpler one of two is listed first in the catalogue."""
LEVELS = 1.3
"""Times the best effect's gain at which a mere shift of single balances explains more than any effect: then no name is given."""
STRANGE = 8.0
"""Strangeness of what is left from which a log is not that of an engine in order, whatever is undone: one is a healthy log."""


@dataclass(frozen=True)
class Accepted:
    """An effect that a log proves.

    Attributes
    ----------
    term : Term
    fit : Fit
        Beside the other effects.
    alike : tuple of str
        Effects that explain the log as well.
    p_value : float
    """

    term: Term
    fit: Fit
    alike: tuple[str, ...]
    p_value: float


@dataclass(frozen=True)
class Selection:
    """What a log holds.

    Attributes
    ----------
    verdict : str
        `effect`, `none` or `unexplained`.
    accepted : tuple of Accepted
    ranking : tuple of Fit
        All candidates against the engine as learned, best first.
    w : Weighed
        Errors as they are judged in the end.
    before, after : ndarray, shape (blocks, 4)
        The balances without and with the effects undone.
    strangeness : float
        How far what is left strays over what strays on a healthy log.
    """

    verdict: str
    accepted: tuple[Accepted, ...]
    ranking: tuple[Fit, ...]
    w: Weighed
    before: Array
    after: Array
    strangeness: float


def select(case: Case) -> Selection:
    """Return what one log holds that the learned engine lacks."""
    recorded = case.imbalances(())
    w = weighed(case, np.ones_like(recorded))
    first = search(w, (), not case.own)
    guess = _first_guess(case, first, recorded)
    left = recorded + guess
    stretch = stretched(w, left)
    if not case.own:
        for _ in range(DAY_PASSES):
            case = on_its_day(w, left)
            w = weighed(case, stretch)
            left = case.imbalances(()) + guess
    else:
        w = weighed(case, stretch)
    before = case.imbalances(())
    close = [fit.id for fit in first if fit.gain > 0.3 * first[0].gain][:6]
    again = search(w, (), not case.own, [e for e in case.candidates if e.id in close])
    ranking = sorted([*again, *(fit for fit in first if fit.id not in close)], key=lambda fit: fit.score, reverse=True)
    terms, fits = _forward(w, ranking)
    after = case.imbalances(terms)
    accepted = tuple(
        Accepted(term, fit, _alike(w, terms, i, ranking), _p_value(w, fit))
        for i, (term, fit) in enumerate(zip(terms, fits, strict=True))
    )
    strangeness = strangeness_of(w, after)
    verdict = "effect" if terms else "none"
    if _a_name_is_no_answer(w, before, after, strangeness, bool(terms)):
        verdict, accepted, after = "unexplained", (), before
    return Selection(verdict, accepted, tuple(ranking), w, before, after, strangeness)


def _a_name_is_no_answer(w: Weighed, before: Array, after: Array, strangeness: float, named: bool) -> bool:
    """Return whether something is there that the named effects, or none, do not explain."""
    lost, shift = w.loss(before), best_shift(w, before)
    if strangeness > STRANGE:
        return True
    return shift > (LEVELS * (lost - w.loss(after)) if named else PROVEN_ALWAYS)


def _forward(w: Weighed, ranking: Sequence[Fit]) -> tuple[list[Term], list[Fit]]:
    """Return the effects that are proven beside each other."""
    terms: list[Term] = []
    fits: list[Fit] = []
    candidates = list(ranking)
    while candidates and len(terms) < MOST:
        best = _first_of_ties(w, candidates)
        if best.score < _needed(best) or (fits and best.gain < NEXT * fits[0].gain):
            break
        terms.append(term_of(w.case, best))
        fits.append(best)
        terms, fits = _settled(w, terms)
        found = search(w, terms, not w.case.own)
        candidates = [fit for fit in found if fit.id not in {term.effect.id for term in terms}]
    return terms, fits


def _first_guess(case: Case, fits: Sequence[Fit], like: Array) -> Array:
    """Return what the best candidate changes, unless it is what every day has a little of."""
    usual = daily_sizes(case)
    for fit in fits:
        if fit.score < PROVEN:
            break
        away = abs(fit.size - effect_of(case, fit.id).null)
        if np.isfinite(fit.begin) or away > MOST_DAILY * usual.get(fit.id, 0.0):
            return fit.change
    return np.zeros_like(like)


def _needed(fit: Fit) -> float:
    return PROVEN if np.isfinite(fit.begin) or np.isfinite(fit.end) else PROVEN_ALWAYS


def _first_of_ties(w: Weighed, fits: Sequence[Fit]) -> Fit:
    near = [fit for fit in fits if fit.score > fits[0].score - TIE]
    order = [effect.id for effect in w.case.candidates]
    return min(near, key=lambda fit: order.index(fit.id))


def _settled(w: Weighed, terms: list[Term]) -> tuple[list[Term], list[Fit]]:
    """Return every effect at its best size beside the others, without those that the others have made superfluous."""
    fits: list[Fit] = []
    for i in range(len(terms)):
        others = [term for k, term in enumerate(terms) if k != i]
        fit = refit(w, others, terms[i].effect, terms[i].size, terms[i].begin, terms[i].end)
        terms = [replace(term, size=fit.size) if k == i else term for k, term in enumerate(terms)]
        fits.append(fit)
    kept = [k for k, fit in enumerate(fits) if fit.score >= _needed(fit)]
    return [terms[k] for k in kept], [fits[k] for k in kept]


def term_of(case: Case, fit: Fit) -> Term:
    """Return a fitted candidate as an effect of the model."""
    return Term(effect_of(case, fit.id), fit.size, fit.begin, fit.end)


def effect_of(case: Case, name: str) -> Effect:
    """Return a candidate by its identifier."""
    return next(effect for effect in case.candidates if effect.id == name)


def _alike(w: Weighed, terms: Sequence[Term], index: int, alone: Sequence[Fit]) -> tuple[str, ...]:
    """Return the candidates that explain the log as well in the place of an effect; `alone` are those beside no other."""
    own = terms[index]
    others = [term for k, term in enumerate(terms) if k != index]
    best = refit(w, others, own.effect, own.size, own.begin, own.end)
    found = search(w, others, not w.case.own) if others else alone
    return tuple(
        fit.id
        for fit in found
        if fit.id != own.effect.id and fit.score > best.score - ALIKE and fit.gain > 0.5 * best.gain
    )


def _p_value(w: Weighed, fit: Fit) -> float:
    """Return the probability of such a gain by chance, after all candidates and onsets that were tried (Bonferroni)."""
    ends = int(np.isfinite(fit.begin)) + int(np.isfinite(fit.end))
    tried = len(w.case.candidates) * float(w.case.blocks.count) ** ends
    return float(min(1.0, tried * scipy.stats.chi2.sf(2.0 * max(fit.gain, 0.0), 1)))
