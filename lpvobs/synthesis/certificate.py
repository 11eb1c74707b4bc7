"""The exact certificate of Theorem 1 and a proven bound on the error of the state: no solver, no rounding.

The stored floats of L, P, Q, eps_1, eps_2 and of the bounds are fractions with a power of two below. In rational arithmetic every
vertex matrix of Eq. (33) is therefore known exactly, and so are the pivots of its LDL^T factorisation. All positive is a proof.

The bound is for disturbances of which only the size is known. The error e of the observer follows de/dt = (A - L C) e + w, where
w holds, as rates, all that is not in A - L C: what the model lacks, sensor errors times L, the error of rho times |x|, and what a
step of backward Euler leaves out. Let N be the comparison matrix of A - L C: the diagonal as it is, the rest as absolute
values, the largest of each over the vertices. Every entry is affine in one block of parameters at a time, so that is the largest on
the whole region. With |w| <= W at all times, d|e|/dt <= N |e| + W (Coppel 1965, the Metzler comparison), and a vector b > 0 with
N b + W <= 0 is never left: |e| <= b once it was, and in any case in the long run. A step of backward Euler of any length h keeps it
too, for (I - h N) |e+| <= |e| + h W and (I - h N) b >= b + h W.

A matrix X >= 0 with -N X >= I gives b = X W for every W, and shows that -N is an M-matrix. Both are shown in rational arithmetic.
rho_2 may have either sign. About the map it says little: see `docs/method.md`.
"""

from dataclasses import dataclass
from fractions import Fraction
from math import inf, isfinite
from typing import Annotated

import numpy as np

from lpvobs.errors import DataError
from lpvobs.records import Array, Item
from lpvobs.synthesis.balance import balance
from lpvobs.synthesis.exact import Matrix, falling, fractions, product, smallest_pivot
from lpvobs.synthesis.problem import GainProblem, bent_block
from lpvobs.synthesis.region import Region


@dataclass(frozen=True)
class Certificate:
    """What was proven, or why not.

    The smallest pivot is that of P, Q and of all -M examined, each divided by its diagonal entry: between 0 and 1 in any units,
    not positive where the proof fails. `failed_vertex` is the first one where M is not negative definite; the reason is empty
    when proven.
    """

    proven: Annotated[bool, Item("1", "whether Theorem 1 is proven on the whole region")]
    vertices: Annotated[int, Item("1", "number of vertices of the region")]
    smallest_pivot: Annotated[float, Item("1", "smallest pivot over its diagonal entry", gaps=True)]
    failed_vertex: tuple[float, ...] | None
    reason: str


def check(problem: GainProblem, L: Array, P: Array, Q: Array, eps_1: float, eps_2: float) -> Certificate:
    """Prove Theorem 1 for given L (n, r), P and Q (n, n), or say why it does not hold: Eq. (27), (28), (33).

    Raises DataError for numbers that are not finite, and for shapes that do not fit the system. Departure from the paper: none in
    the conditions.
    """
    vertices = problem.region.vertices()
    n, r = (len(matrix) for matrix in problem.at(vertices[0]))
    for name, value, shape in (("L", L, (n, r)), ("P", P, (n, n)), ("Q", Q, (n, n))):
        if np.shape(value) != shape:
            raise DataError(
                f"gain: matrix {name} has the shape {np.shape(value)}, expected {shape}; use this system's gain"
            )
        if not np.all(np.isfinite(value)):
            raise DataError(
                f"gain: matrix {name} has NaN or infinity in it, expected finite numbers; synthesise the gain again"
            )
    if not (isfinite(eps_1) and isfinite(eps_2)):
        raise DataError(f"gain: eps_1 = {eps_1}, eps_2 = {eps_2}, expected finite numbers; synthesise the gain again")
    e_1, e_2 = fractions([eps_1, eps_2])

    if reason := _why_not(problem, P, Q, e_1, e_2):
        return Certificate(False, len(vertices), 0.0, None, reason)
    exact_P, exact_Q = fractions(P), fractions(Q)
    smallest = inf
    for name, matrix in (("P", exact_P), ("Q", exact_Q)):
        smallest = min(smallest, smallest_pivot(matrix))
        if smallest <= 0:
            return Certificate(False, len(vertices), smallest, None, f"{name} is not positive definite")
    Y = product(exact_P, fractions(L))
    for vertex in vertices:  # Eq. (33)
        A, C = problem.at(vertex)
        side = -np.hstack([Y[:, [problem.map_output]], C[[problem.map_output]].T])
        minus_M = np.block([[falling(exact_P, Y, A, C) - exact_Q, side], [side.T, np.diag([e_1, e_2])]])  # Eq. (27)
        smallest = min(smallest, smallest_pivot(minus_M))
        if smallest <= 0:
            reason = f"M is not negative definite at {problem.region.place(vertex)}"
            return Certificate(False, len(vertices), smallest, tuple(map(float, vertex)), reason)
    return Certificate(True, len(vertices), smallest, None, "")


def _why_not(problem: GainProblem, P: Array, Q: Array, eps_1: Fraction, eps_2: Fraction) -> str:
    """Return why vertices prove nothing, empty where they do."""
    if eps_1 <= 0 or eps_2 <= 0:
        return "eps_1 and eps_2 must be positive"
    if 2 - eps_1 - eps_2 <= 0:  # Eq. (28)
        return "2 - eps_1 - eps_2 > 0 does not hold"
    if bent := bent_block(problem):
        return f"the system is not affine in {' and '.join(bent)}, so a check at the vertices proves nothing"
    for name, matrix in (("P", np.asarray(P)), ("Q", np.asarray(Q))):
        if not np.array_equal(matrix, matrix.T):
            return f"{name} is not symmetric"
    return ""


SLACK = 1e-9
"""Share by which the floats of a bound are larger than need be, in balanced units, so that rounding does not break the proof."""


@dataclass(frozen=True, eq=False)
class StateBound:
    """How large the error of the state can be, in units of the states, for what disturbs it."""

    of_rates: Annotated[
        Array, Item("SI", "largest error of a state per disturbance of each state's rate", ("state", "other_state"))
    ]
    # nothing of the sensor's where the gain is a cascade
    of_outputs: Annotated[Array, Item("SI", "largest error of a state per error of each output", ("state", "output"))]


def state_bound(problem: GainProblem, L: Array) -> StateBound | None:
    """Return the bound for a gain, shape (n, r), None where the comparison matrix allows none; to be proven by `prove_bound`."""
    N = comparison(problem, L).astype(float)
    if np.linalg.eigvals(N).real.max() >= 0.0:
        return None
    units = balance(*problem.matrices()).states
    reserve = np.eye(units.size) + SLACK * np.divide.outer(units, units)
    rates = np.maximum(np.linalg.solve(-N, reserve), 0.0)
    return StateBound(rates, rates @ np.abs(L) * (1.0 + SLACK))


def prove_bound(problem: GainProblem, L: Array, bound: StateBound) -> str:
    """Return why a bound is not proven, empty where it is; raises DataError where shapes do not fit L, (n, r)."""
    n, r = L.shape
    shapes = bound.of_rates.shape, bound.of_outputs.shape
    if shapes != ((n, n), (n, r)) or not all(np.isfinite(each).all() for each in vars(bound).values()):
        raise DataError(
            f"gain: the stored error bound has arrays of shapes {shapes}, expected {((n, n), (n, r))} with finite "
            "numbers; synthesise the gain again"
        )
    if min(each.min() for each in vars(bound).values()) < 0.0:
        return "the error bound of the states has a negative entry"
    X, N = fractions(bound.of_rates), comparison(problem, L)
    if np.any(product(N, X) > -np.eye(n, dtype=object)):
        return "the error bound of the states is not proven: the inequality -N X >= I fails"
    if np.any(product(X, fractions(np.abs(L))) > fractions(bound.of_outputs)):
        return "the error bound of the states is too small for errors of the outputs"
    return ""


def comparison(problem: GainProblem, L: Array) -> Matrix:
    """Return the Metzler comparison matrix of A - L C over the region, exactly."""
    exact_L = fractions(L)
    closed = np.array([A - product(exact_L, C) for A, C in map(problem.at, problem.region.vertices())])
    return np.asarray(np.where(np.eye(len(L), dtype=bool), closed.max(axis=0), np.abs(closed).max(axis=0)))


@dataclass(frozen=True, eq=False)
class Gain:
    """A feedback gain of Eq. (26) and the numbers that prove it on the region; a gain without a proof is not made."""

    L: Annotated[Array, Item("SI", "gain of Eq. (26), state unit per output unit and second", ("state", "output"))]
    P: Annotated[Array, Item("SI", "Lyapunov matrix of Theorem 1", ("state", "other_state"))]
    Q: Annotated[Array, Item("SI", "matrix Q of Theorem 1", ("state", "other_state"))]
    eps_1: Annotated[float, Item("1", "eps_1 of Theorem 1")]
    eps_2: Annotated[float, Item("1", "eps_2 of Theorem 1")]
    region: Region
    certificate: Annotated[Certificate, Item()]
    # proven, on the error of the state; None where the comparison matrix allows none
    bound: Annotated[StateBound | None, Item(name="state_bound")] = None
