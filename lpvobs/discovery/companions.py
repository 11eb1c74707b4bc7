"""Whether an effect beside others is a cause of its own, or what they leave: of a pause, or of a shape that is not quite theirs."""

import numpy as np

from lpvobs.discovery.fit import without
from lpvobs.discovery.linear import Linear, changed_by, dot
from lpvobs.discovery.residual import Problem
from lpvobs.discovery.thresholds import SHAPE, STANDS
from lpvobs.records import Array


def cancels(linear: Linear, one: int, other: int) -> bool:
    """Return whether one term, while it acts, changes the residual nearer to opposite to the other than to perpendicular."""
    a, b = (linear.whiten(changed_by(linear, i)) for i in (one, other))
    b = b * np.any(a != 0.0, axis=(0, 1))
    return bool(dot(a, b) < -np.sqrt(0.5 * max(dot(a, a) * dot(b, b), 0.0)))


def own_share(linear: Linear, index: int) -> float:
    """Return the share of a term's gain that is left where every other term may have another shape.

    What another term changes may be off, in all balances alike, by a share of `SHAPE` rms that is smooth in the channels.
    """
    smooth, others = _smooth(linear.problem), [i for i in range(len(linear.terms)) if i != index]
    changes = [changed_by(linear, i) for i in others]
    bent = [linear.whiten(change * each) for change in changes for each in smooth]
    own = linear.whiten(changed_by(linear, index))
    gradient, information = without(linear, index).beside(np.stack([*bent, own]))
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
