"""Whether an effect beside others is one of its own, or what is left of them because the catalogue has not quite their shape."""

import numpy as np

from lpvobs.discovery.fit import refit
from lpvobs.discovery.linear import Linear, residual_with
from lpvobs.discovery.residual import Problem
from lpvobs.discovery.thresholds import SHAPE, STANDS
from lpvobs.records import Array


def own_share(linear: Linear, index: int) -> float:
    """Return the share of a term's gain that is left where every other term may have another shape.

    What another term changes may be off, in all balances alike, by a share of `SHAPE` rms that is smooth in the channels.
    """
    problem, terms = linear.problem, linear.terms
    whole = residual_with(linear, terms)
    changes = [whole - residual_with(linear, [t for t in terms if t is not term]) for term in terms]
    smooth = _smooth(problem)
    bent = [linear.whiten(change * each) for i, change in enumerate(changes) if i != index for each in smooth]
    others = refit(linear, [*terms[:index], *terms[index + 1 :]])
    gradient, information = others.beside(np.stack([*bent, linear.whiten(changes[index])]))
    known = information[:-1, :-1] + np.eye(len(bent)) * len(smooth) / SHAPE**2
    taken = np.linalg.solve(known, np.stack([gradient[:-1], information[:-1, -1]], axis=1))
    left, told = np.array([gradient[-1], information[-1, -1]]) - information[-1, :-1] @ taken
    if not (told > 0.0 and information[-1, -1] > 0.0):
        return 0.0
    return float((left**2 / told) / max(gradient[-1] ** 2 / information[-1, -1], 1e-300))


def _smooth(problem: Problem) -> Array:
    """Return lines and parabolas over every moving channel and over the time, of unit variance, shape (m, K)."""
    lines = [x for x in (*problem.inputs().values(), problem.clock) if np.std(x) > STANDS * abs(np.mean(x))]
    scaled = [(x - x.mean()) / x.std() for x in lines]
    return np.stack([*scaled, *((x**2 - 1.0) / np.std(x**2) for x in scaled)])
