"""A proven bound on the error of the state, for disturbances of which no more than their size is known.

The error e of the observer follows de/dt = (A - L C) e + w, where w holds, as rates, all that is not in A - L C: what the model
lacks, sensor errors times L, the error of rho times |x|, and what a step of backward Euler leaves out. Let N be the comparison
matrix of A - L C: the diagonal as it is, the rest as absolute values, the largest of each over the vertices. Every entry is affine
in one block of parameters at a time, so that is the largest on the whole region. With |w| <= W at all times, d|e|/dt <= N |e| + W
(Coppel 1965, the Metzler comparison), and a vector b > 0 with N b + W <= 0 is never left: |e| <= b once it was, and in any case in
the long run. A step of backward Euler of any length h keeps it too, for (I - h N) |e+| <= |e| + h W and (I - h N) b >= b + h W.

A matrix X >= 0 with -N X >= I gives b = X W for every W, and shows that -N is an M-matrix. Both are shown in rational arithmetic.
rho_2 may have either sign. About the map it says little: see `docs/method.md`.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from lpvobs.errors import DataError
from lpvobs.records import Array, Item
from lpvobs.synthesis.balance import balance
from lpvobs.synthesis.exact import Matrix, fractions, product
from lpvobs.synthesis.problem import GainProblem

SLACK = 1e-9
"""Share by which the floats of a bound are larger than need be, in balanced units, so that rounding does not break the proof."""


@dataclass(frozen=True, eq=False)
class StateBound:
    """How large the error of the state can be, in units of the states, for what disturbs it."""

    of_rates: Annotated[
        Array, Item("SI", "largest error of a state per size of what disturbs each rate", ("state", "other_state"))
    ]
    # nothing of the sensor's where the gain is a cascade
    of_outputs: Annotated[
        Array, Item("SI", "largest error of a state per size of the error of each output", ("state", "output"))
    ]


def state_bound(problem: GainProblem, L: Array) -> StateBound | None:
    """Return the bound for a gain, shape (n, r), None where the comparison matrix allows none; to be proven by `prove_bound`."""
    N = np.array([[float(entry) for entry in row] for row in comparison(problem, L)])
    if np.linalg.eigvals(N).real.max() >= 0.0:
        return None
    units = balance(*problem.matrices()).states
    reserve = np.eye(units.size) + SLACK * np.divide.outer(units, units)
    rates = np.maximum(np.linalg.solve(-N, reserve), 0.0)
    return StateBound(rates, rates @ np.abs(L) * (1.0 + SLACK))


def prove_bound(problem: GainProblem, L: Array, bound: StateBound) -> str:
    """Return why a bound is not proven, empty where it is.

    Raises DataError where its shapes do not fit those of the gain, (n, r).
    """
    n, r = L.shape
    shapes = bound.of_rates.shape, bound.of_outputs.shape
    if shapes != ((n, n), (n, r)) or not all(np.isfinite(each).all() for each in vars(bound).values()):
        raise DataError(f"gain: its bound has the shapes {shapes}, expected finite numbers in {((n, n), (n, r))}")
    if min(each.min() for each in vars(bound).values()) < 0.0:
        return "the bound of the state has a negative entry"
    X, N = fractions(bound.of_rates), comparison(problem, L)
    left = product(N, X)
    if any(left[i][j] + (i == j) > 0 for i in range(n) for j in range(n)):
        return "the bound of the state does not hold: -N X >= I fails"
    least, given = product(X, fractions(np.abs(L))), fractions(bound.of_outputs)
    if any(least[i][j] > given[i][j] for i in range(n) for j in range(r)):
        return "the bound of the state for errors of the outputs is too small"
    return ""


def comparison(problem: GainProblem, L: Array) -> Matrix:
    """Return the Metzler comparison matrix of A - L C over the region, exactly."""
    exact_L, n = fractions(L), L.shape[0]
    closed = []
    for vertex in problem.region.vertices():
        A, C = problem.at(vertex)
        LC = product(exact_L, C)
        closed.append([[A[i][j] - LC[i][j] for j in range(n)] for i in range(n)])
    return [[max(m[i][j] if i == j else abs(m[i][j]) for m in closed) for j in range(n)] for i in range(n)]
