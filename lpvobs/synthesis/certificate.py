"""The exact certificate of Theorem 1: no solver, no rounding.

The stored floats of L, P, Q, eps_1, eps_2 and of the bounds are fractions with a power of two below. In rational
arithmetic every vertex matrix of Eq. (33) is therefore known exactly, and so are the pivots of its LDL^T factorisation.
All positive is a proof.
"""

from dataclasses import dataclass
from fractions import Fraction
from math import inf, isfinite
from typing import Annotated

import numpy as np

from lpvobs.errors import DataError
from lpvobs.records import Array, Item
from lpvobs.synthesis.exact import Matrix, fractions, product, smallest_pivot
from lpvobs.synthesis.problem import GainProblem, bent_block


@dataclass(frozen=True)
class Certificate:
    """What was proven, or why not.

    The smallest pivot is that of P, Q and of all -M examined, each divided by its diagonal entry: between 0 and 1 in any units,
    not positive where the proof fails. `failed_vertex` is the first one where M is not negative definite; the reason is empty
    when proven.
    """

    proven: Annotated[bool, Item("1", "Theorem 1 proven on the whole region")]
    vertices: Annotated[int, Item("1", "vertices of the region")]
    smallest_pivot: Annotated[float, Item("1", "smallest relative pivot", gaps=True)]
    failed_vertex: tuple[float, ...] | None
    reason: str


def check(problem: GainProblem, L: Array, P: Array, Q: Array, eps_1: float, eps_2: float) -> Certificate:
    """Prove Theorem 1 for given numbers, or say why it does not hold.

    Raises DataError for numbers that are not finite, and for shapes that do not fit the system.

    Parameters
    ----------
    problem : GainProblem
        n states, r outputs.
    L : ndarray, shape (n, r)
    P, Q : ndarray, shape (n, n)

    Notes
    -----
    Eq. (27), (28), (33). Departure from the paper: none in the conditions.
    """
    vertices = problem.region.vertices()
    n, r = _sizes(problem)
    for name, value, shape in (("L", L, (n, r)), ("P", P, (n, n)), ("Q", Q, (n, n))):
        _refuse_unusable(name, np.asarray(value), shape)
    if not (isfinite(eps_1) and isfinite(eps_2)):
        raise DataError(f"gain: eps_1 = {eps_1}, eps_2 = {eps_2}, expected finite numbers: synthesise the gain again")
    e_1, e_2 = Fraction(float(eps_1)), Fraction(float(eps_2))

    def verdict(reason: str, pivot: float, failed: tuple[Fraction, ...] | None = None) -> Certificate:
        where = None if failed is None else tuple(float(value) for value in failed)
        return Certificate(not reason, len(vertices), pivot, where, reason)

    reason = _about_scalars(e_1, e_2) or _about_system(problem) or _about_symmetry(P, Q)
    if reason:
        return verdict(reason, 0.0)
    exact_P, exact_Q = fractions(P), fractions(Q)
    smallest = inf
    for name, matrix in (("P", exact_P), ("Q", exact_Q)):
        smallest = min(smallest, smallest_pivot(matrix))
        if smallest <= 0:
            return verdict(f"{name} is not positive definite", smallest)
    Y = product(exact_P, fractions(L))
    for vertex in vertices:  # Eq. (33)
        A, C = problem.at(vertex)
        minus_M = _minus_M(A, C, problem.map_output, exact_P, Y, exact_Q, e_1, e_2)
        smallest = min(smallest, smallest_pivot(minus_M))
        if smallest <= 0:
            return verdict(f"M is not negative definite at {problem.region.place(vertex)}", smallest, vertex)
    return verdict("", smallest)


def _minus_M(
    A: Matrix, C: Matrix, map_output: int, P: Matrix, Y: Matrix, Q: Matrix, eps_1: Fraction, eps_2: Fraction
) -> Matrix:
    """Return -M of Eq. (27), (n + 2) x (n + 2), with Y = P L."""
    PA, YC, n, zero = product(P, A), product(Y, C), len(A), Fraction(0)
    PLG, C_2 = [row[map_output] for row in Y], C[map_output]
    states = [[YC[i][j] + YC[j][i] - PA[i][j] - PA[j][i] - Q[i][j] for j in range(n)] for i in range(n)]
    rows = [[*row, -b, -c] for row, b, c in zip(states, PLG, C_2, strict=True)]
    return [*rows, [*(-b for b in PLG), eps_1, zero], [*(-c for c in C_2), zero, eps_2]]  # Eq. (27)


def _sizes(problem: GainProblem) -> tuple[int, int]:
    A, C = problem.at(problem.region.vertices()[0])
    return len(A), len(C)


def _refuse_unusable(name: str, value: Array, shape: tuple[int, int]) -> None:
    if value.shape != shape:
        raise DataError(f"gain: {name} has the shape {value.shape}, expected {shape}: use the gain of this system")
    if not np.all(np.isfinite(value)):
        raise DataError(f"gain: {name} holds NaN or infinity, expected finite numbers: synthesise the gain again")


def _about_scalars(eps_1: Fraction, eps_2: Fraction) -> str:
    if eps_1 <= 0 or eps_2 <= 0:
        return "eps_1 and eps_2 must be positive"
    if 2 - eps_1 - eps_2 <= 0:  # Eq. (28)
        return "2 - eps_1 - eps_2 > 0 does not hold"
    return ""


def _about_system(problem: GainProblem) -> str:
    names = bent_block(problem)
    return "" if names is None else f"the system is not affine in {' and '.join(names)}, so vertices prove nothing"


def _about_symmetry(P: Array, Q: Array) -> str:
    for name, matrix in (("P", np.asarray(P)), ("Q", np.asarray(Q))):
        if not np.array_equal(matrix, matrix.T):
            return f"{name} is not symmetric"
    return ""
