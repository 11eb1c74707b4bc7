"""How sizes vary: from block to block of a drive, and between healthy drives, which leaves a share of what is told of a size."""

import numpy as np

from lpvobs.discovery.courses import GRADED
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.residual import Term
from lpvobs.discovery.sizes import slope_of
from lpvobs.discovery.thresholds import BY_CHANCE
from lpvobs.records import Array

HARDLY = 1e-100
"""Mean square of its share below which an effect has hardly begun when the drive ends. Products of such shares are zero."""


def own_sizes_of(linear: Linear, term: Term, scores: Array, direction: Array) -> float:
    """Return by how much more a size of its own for every block gains than noise does in 39 of 40 logs.

    `direction` is the effect's derivative, all unknowns projected out, and `scores` its products, by stretch, with what is left.
    Before any data, these sizes differ by as much as the effect is large. Where little but noise moves a rate, as that of a slow
    sensor, a score varies by the square of the noise in it, and tells nothing of a size.
    """
    squares = np.add.reduceat((direction**2).sum((0, 1)), linear.problem.first)
    each = scores, linear.by_block(direction, direction), squares
    scores, power, varies = (linear.problem.by_coarse(values) for values in each)
    of_size = np.maximum(power, 0.0) ** 2 * (term.size - term.effect.null) ** 2
    share = of_size / np.maximum(varies + of_size, 1e-300)
    by_noise = 0.5 * share.sum() + BY_CHANCE * np.sqrt(0.5 * (share**2).sum())
    return float(0.5 * (share * scores**2 / np.maximum(varies, 1e-300)).sum() - by_noise)


def told_of(linear: Linear, term: Term, information: float, unevenness: float) -> float:
    """Return the share of the information about a size that is left beside what a healthy engine seems to have of it.

    Its variance is that of noise and of what the size takes of the healthy one, by how much they act alike.
    """
    problem = linear.problem
    if len(problem.known_as(term)) > 1:
        return _told_of_shape(linear, term, unevenness)
    information = information / max(unevenness, 1.0)  # what varies from block to block tells less of a size
    share = term.acts(problem.clock).astype(float)
    if term.course is not None and term.course.name in GRADED:
        share = problem.share(term.course)
    healthy = np.ones(share.size) if term.whole else share  # how it seems to act: all along, or as the term does
    power, own = float((share**2).mean()), float((healthy**2).mean())
    if power < HARDLY:
        return 1.0
    known = problem.seems(term, information * own / power)
    alike = float((share * healthy).mean()) ** 2 / (power * own)
    return 1.0 / (1.0 + alike * known)


def _told_of_shape(linear: Linear, term: Term, unevenness: float) -> float:
    """Return the share of the gain of what follows an input that is left beside its carrier and its shape, which vary by day.

    What it has of its carrier varies as that does, the rest as its shape: their scores are weighed by their own variances.
    """
    problem, on = linear.problem, term.acts(linear.problem.clock).astype(float)
    of_carrier, of_shape = problem.known_as(term)
    carrier = next(effect for effect in problem.catalogue if effect.id == of_carrier)
    slopes = [slope_of(linear, effect, effect.null) * on for effect in (term.effect, carrier)]
    (curved, level), ((own, both), (_, factor)) = linear.beside(linear.whiten(np.stack(slopes)))
    shape = own - both**2 / factor if factor > 0.0 else 0.0
    if not (shape > 0.0 and curved != 0.0):
        return 0.0
    uneven, along = max(unevenness, 1.0), both / factor  # what varies from block to block tells less of a size
    varies = 1.0 + np.array([problem.seems(term, factor / uneven), problem.seems(term, shape / uneven, of_shape)])
    score = np.array([along * level, curved - along * level]) / varies
    power = np.array([along * both, shape]) / varies
    return float(min((score.sum() ** 2 / power.sum()) / (curved**2 / own), 1.0))
