"""The ranking of all candidates against one model, logged channels included, and the test whether one of them is proven."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from lpvobs.discovery import thresholds
from lpvobs.discovery.curves import channel_candidates, component_candidates
from lpvobs.discovery.evidence import (
    Candidate,
    best_first,
    best_gain,
    elsewhere_of,
    first_order_gain,
    fit_candidate,
    score,
    with_best_interval,
)
from lpvobs.discovery.forms import PREFIX
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.residual import Problem, Term
from lpvobs.engines.effects import Effect

FAMILIES = 4
"""Families of tests that share the probability of an error: effects of one size, those with a size of their own in every block,
effects on a course, and what has a curve or a formula. Counted as one, three of 100 clean drives of seed 285712 of the first bank
had a p-value below 0.01, and 15 of 262 of seed 568864 of the second."""


def is_uneven(candidate: Candidate, problem: Problem) -> bool:
    """Return whether a candidate has no single size: by how much more one of its own for every block would gain, of its gain.

    Where healthy drives tell, the engine is not the model, and a cause is not quite the catalogue's.
    """
    most = thresholds.MOST_UNEVEN_LEARNED if len(problem.patterns) else thresholds.MOST_UNEVEN
    return candidate.own_sizes > most * max(candidate.gain, 0.0)


def rank(linear: Linear, effects: Sequence[Effect]) -> list[Candidate]:
    """Return the most promising effects, best first; the leading ones on their best intervals."""
    problem = linear.problem
    if problem.first.size < 3 * thresholds.LEAST_LENGTH:
        return rank_in(linear, [effect for effect in effects if not problem.absorbs(effect)])
    expected = {effect: best_gain(linear, effect) for effect in effects}
    found: list[Candidate] = []
    for effect in _most_promising(expected):
        whole = fit_candidate(linear, effect)
        if len(found) < thresholds.SHORTLIST:
            found.append(with_best_interval(linear, whole))
        elif not problem.absorbs(effect):
            found.append(whole)
    ranked = best_first(found)
    # Of those that tie with the best in its interval, the effect that the catalogue lists first heads the ranking.
    order = [effect.id for effect in problem.catalogue]
    least, ends = score(ranked[0]) - thresholds.TIE, (ranked[0].term.begin, ranked[0].term.end)
    tied = [c for c in ranked if score(c) > least and (c.term.begin, c.term.end) == ends]
    head = min(tied, key=lambda c: order.index(c.id))
    return [head, *(c for c in ranked if c is not head)]


def rank_in(linear: Linear, effects: Sequence[Effect], begin: float = -np.inf, end: float = np.inf) -> list[Candidate]:
    """Return the most promising effects in an interval, best first."""
    expected = {effect: first_order_gain(linear, effect, begin, end) for effect in effects}
    least = thresholds.HOPELESS * max(expected.values(), default=0.0)
    near = [effect for effect in _most_promising(expected) if expected[effect] >= least]
    return best_first(fit_candidate(linear, effect, begin, end) for effect in near)


def _most_promising(expected: Mapping[Effect, float]) -> list[Effect]:
    """Return the effects with the largest gain to first order, best first."""
    return sorted(expected, key=lambda effect: expected[effect], reverse=True)[: thresholds.LOOKED_AT]


def is_relevant(candidate: Candidate, linear: Linear) -> bool:
    """Return whether a candidate explains more than smoothing and a bilinear map may leave."""
    return candidate.gain >= least_gain(linear.problem)


def least_gain(problem: Problem) -> float:
    """Return the smallest gain that is relevant; what smoothing and the map leave is learned where healthy drives tell of it."""
    share = 0.0 if problem.seeming.drives else thresholds.LEAST_SHARE
    return float(max(share * 0.5 * problem.data, thresholds.PROVEN))


def is_proven(candidate: Candidate, linear: Linear) -> bool:
    """Return whether a candidate is both relevant and significant, the errors of a learned function counted."""
    return is_relevant(candidate, linear) and is_significant(candidate, linear.problem, beside=len(linear.terms) > 0)


def is_significant(candidate: Candidate, problem: Problem, beside: bool = False) -> bool:
    """Return whether chance alone hardly explains a candidate, the errors of a healthy engine counted where drives show them.

    Beside another effect the drive is no healthy one, and a further effect is no accusation.
    """
    most = thresholds.SIGNIFICANT_LEARNED if problem.seeming.drives and not beside else thresholds.SIGNIFICANT
    return chance(candidate, problem) < most


def chance(candidate: Candidate, problem: Problem, wider: float = 1.0) -> float:
    """Return the probability of such a gain by chance, after all effects and intervals that were tried (Bonferroni).

    They count for each of `FAMILIES`, for every family tests the same residual.
    A curve's coefficients and a formula's search have paid a price, and do not compete; an unusual constant inside pays it here.
    Every end counts as `places_tried` says. `wider` is the variance of a gain, in that of noise.

    Healthy drives tell how far sizes vary. Each shows an effect that lasts once, its noise included: the distribution is Student's
    with as many degrees of freedom as there are drives (the moderated t-test, Smyth 2004). An effect that begins or ends is
    compared with the rest of its drive, which tells the noise: the larger the part of noise, the nearer is its distribution to
    the normal one (Satterthwaite). That is a choice, held by the clean drives of seed 723923 of the second bank. Nor may it gain
    less, over noise, than the best onset gains on a healthy drive: what they leave comes and goes, too. An effect that acts for
    less than a minute counts as its share of one.
    """
    gain = max(candidate.told * max(candidate.gain - candidate.price + candidate.paid, 0.0) - candidate.paid, 0.0)
    statistic = 2.0 * (gain / wider) / max(candidate.unevenness, 1.0)
    statistic *= _share_of_a_minute(candidate, problem) / _by_search(candidate, problem)
    hypotheses = FAMILIES * len(problem.catalogue) * places_tried(statistic, candidate.loss.size) ** candidate.changes
    varies = 1.0 - candidate.told if candidate.changes else 1.0  # the part whose variance drives alone tell
    degrees = min(problem.seeming.degrees / max(varies, 1e-6) ** 2, 1e6)
    return float(min(1.0, hypotheses * scipy.special.fdtrc(1, degrees, statistic)))


def places_tried(statistic: float, blocks: int) -> float:
    """Return how many independent tests the search for the place of an end counts as, one at least.

    The largest statistic over all places of n blocks, at least m from either end, exceeds x up to x log(n / m) times as often as
    that of one place (James, James and Siegmund 1987, "Tests for a change-point", Biometrika 74, for continuous time). Departure
    from it: half as often, for places are blocks; so the square is right for two ends.
    """
    return 1.0 + 0.5 * statistic * math.log(max(blocks / thresholds.LEAST_LENGTH, 1.0))


def _share_of_a_minute(candidate: Candidate, problem: Problem) -> float:
    """Return for which share of a minute an effect acts, one at most: at one place an error of a healthy engine lasts as long."""
    if not (problem.seeming.drives and candidate.changes):
        return 1.0
    return min(1.0, problem.spacing * float(candidate.term.acts(problem.clock).sum()) / thresholds.MEMORY)


def _by_search(candidate: Candidate, problem: Problem) -> float:
    """Return how much more the search for the ends of a candidate finds on healthy drives than in noise."""
    found, ends = problem.seeming.searched, candidate.changes
    if not (found and ends):
        return 1.0
    names = (problem.known_as(candidate.term)[0], candidate.term.effect.place, "")
    return float(next(found[name] for name in names if name in found)[min(ends, 2) - 1])


def drives_needed(candidates: Sequence[Candidate], problem: Problem) -> tuple[str, int] | None:
    """Return the candidate that the fewest healthy drives would prove, and their number, if days differ as the known ones do.

    None where no number does that is learned from, if drives are as long as the known ones. One drive does not tell how days
    differ. Candidates that would have no name even then are left out.
    """
    known, seeming = [c for c in candidates if _may_be_named(c, problem)], problem.seeming
    for number in range(seeming.drives + 1, seeming.most + 1 if seeming.drives > 1 else 0):
        told = replace(problem, seeming=replace(seeming, degrees=number + thresholds.POOLED))
        proven = [c.id for c in known if is_significant(c, told)]
        if proven:
            return proven[0], number
    return None


def _may_be_named(candidate: Candidate, problem: Problem) -> bool:
    """Return whether nothing but chance stands between a candidate and its name."""
    return candidate.gain >= least_gain(problem) and not (
        is_uneven(candidate, problem) or is_slight(candidate.term, problem)
    )


def is_small(term: Term, problem: Problem) -> bool:
    """Return whether a listed effect is too small for a fault, where healthy drives tell: what others leave may look like it."""
    listed = len(problem.patterns) > 0 and not term.effect.id.startswith(PREFIX)
    return listed and abs(term.size - term.effect.null) < thresholds.SLIGHT * _noticeable(term.effect, problem)


def _noticeable(effect: Effect, problem: Problem) -> float:
    """Return the size that one notices; a drift is noticed where it has grown to a gain that one notices, too."""
    if effect.parameter != "rate":
        return effect.size
    gains = [e.size for e in problem.catalogue if e.id == effect.id.replace(".drift", ".gain")]
    return min([effect.size, *(size / float(np.ptp(problem.time)) for size in gains)])


def is_remnant(term: Term, problem: Problem) -> bool:
    """Return whether an effect beside others is what these leave: too small for a fault, and no constants that have changed."""
    return is_small(term, problem) and not is_slight(term, problem)


def is_slight(term: Term, problem: Problem) -> bool:
    """Return whether a small effect may be constants that have changed since the healthy drives.

    They have done so before the first sample, whatever they follow, and do not drift.
    """
    lasts = term.whole and (term.course is None or (term.course.ends == 0 and term.course.name != "ramp"))
    return lasts and term.effect.parameter != "rate" and is_small(term, problem)


def structure(linear: Linear) -> float:
    """Return the largest gain of any general effect that may have a size of its own in every block."""
    return 0.5 * (elsewhere_of(linear) / linear.problem.seeming.uneven - 1.0) * linear.problem.coarse_blocks


def chance_of_nothing(first: Linear, ranking: Sequence[Candidate]) -> float:
    """Return the probability of the strongest candidate of all, or of such a structure in time, if nothing is there.

    Noise is not all that a sound model leaves: its error, a share of the data, widens the distribution of every gain. The gain of a
    formula has paid the price of its search. Where healthy drives tell, constants that changed by little since are nothing, too.
    """
    problem, blocks = first.problem, first.problem.coarse_blocks
    # In units of the variance by noise; where several healthy drives tell of the error, `Candidate.told` has it.
    wider = 1.0 if problem.seeming.drives > 1 else 1.0 + thresholds.MODEL_ERROR * problem.data
    single = min((chance(c, problem, wider) for c in ranking if not is_slight(c.term, problem)), default=1.0)
    elsewhere = elsewhere_of(first) / problem.seeming.uneven
    uneven = float(scipy.special.chdtrc(blocks, elsewhere * blocks / wider))
    return min(single, FAMILIES * len(problem.carriers) * uneven)


def each_once(found: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Return the first candidate of every name."""
    first: dict[str, Candidate] = {}
    for candidate in found:
        first.setdefault(candidate.id, candidate)
    return tuple(first.values())


def best_of(linear: Linear, channels: bool = True) -> tuple[Candidate, ...]:
    """Return all candidates, best first, those with a curve among them where they beat the catalogue."""
    found = rank(linear, linear.problem.catalogue)
    logged = channel_candidates(linear) if channels else []
    driven = best_first([*logged, *component_candidates(linear, found)])
    if driven and score(driven[0]) > thresholds.ADVANTAGE * max(score(found[0]), 0.0):
        return (*driven, *found)
    return (*found[:1], *driven, *found[1:])
