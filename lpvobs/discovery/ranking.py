"""All candidates against one model: how promising each is, the logged channels among them, and which is worth a name."""

from collections.abc import Sequence

import numpy as np

from lpvobs.discovery.candidates import (
    LEAST_LENGTH,
    Candidate,
    best_intervals,
    fit_candidate,
    gains_of_intervals,
    p_value,
    penalty,
    score,
    slope_of,
    with_best_interval,
)
from lpvobs.discovery.channels import Curve, channel_candidates
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.plant import Effect
from lpvobs.discovery.problem import Problem

SHORTLIST = 4
SIGNIFICANT = 1e-3
"""Probability of naming anything by chance on a log without effects; all candidates and intervals together."""
LEAST_SHARE = 0.008
"""Of the noise's sum of squares: an effect that explains less is within what smoothing and a bilinear map leave."""


def uneven_share(candidate: Candidate, per_coarse: int) -> float:
    """Return what a size of its own for every block would gain, over what the one size gains."""
    blocks = candidate.loss.size / per_coarse
    return 0.5 * (candidate.unevenness - 1.0) * blocks / max(candidate.gain, 1e-9)


def rank(linear: Linear, effects: Sequence[Effect], intervals: bool = True) -> list[Candidate]:
    """Return the effects, each on its best interval where it is among the most promising, best first."""
    blocks = linear.problem.first.size
    free = linear.problem.prior.free
    whole = [fit_candidate(linear, effect) for effect in effects]
    if not intervals or blocks < 3 * LEAST_LENGTH:
        return sorted((c for c in whole if not (free and c.term.effect.in_map)), key=score, reverse=True)
    promise = []
    for c in whole:
        gains = gains_of_intervals(linear, slope_of(linear, c.term.effect, c.term.size))
        tops = [
            float(gains[first, last]) - penalty(1 + (first > 0 and last < blocks), blocks, float(gains[first, last]))
            for first, last in best_intervals(gains)
        ]
        own = 0.0 if free and c.term.effect.in_map else c.gain
        promise.append(max(own, *tops))
    found: list[Candidate] = []
    for i in np.argsort(promise)[::-1]:
        c = whole[int(i)]
        absorbed = free and c.term.effect.in_map
        if len(found) < SHORTLIST:
            found.append(with_best_interval(linear, c, not absorbed))
        elif not absorbed:
            found.append(c)
    return sorted(found, key=score, reverse=True)


def tried(problem: Problem) -> int:
    """Return how many hypotheses compete."""
    return len(problem.plant.catalogue) + 2 * len(problem.plant.carriers) * len(problem.auxiliary)


def worth(candidate: Candidate, linear: Linear) -> bool:
    """Return whether a candidate is neither chance nor too small to matter."""
    noise = 0.5 * linear.residual[0].size
    return candidate.gain >= LEAST_SHARE * noise and p_value(candidate, tried(linear.problem)) < SIGNIFICANT


def best_of(linear: Linear) -> tuple[list[Candidate], Curve | None]:
    """Return all candidates, best first, channels among them where they beat the catalogue."""
    found = rank(linear, linear.problem.plant.catalogue)
    curves = channel_candidates(linear) if linear.problem.auxiliary else []
    if not curves:
        return found, None
    best, curve = max(curves, key=lambda item: score(item[0]))
    if score(best) > 1.05 * max(score(found[0]), 0.0):
        return [best, *found], curve
    return [*found[:1], best, *found[1:]], curve
