"""The matrix inequality of Theorem 1 as a convex problem. The only module that imports cvxpy.

With P, Q and Y = P L counted in units of c = 1 / (beta eps_2), and k = eps_1 eps_2, Eq. (27) reads after its Schur
complement

    A^T P + P A - Y C - C^T Y^T + Q + (Y G)(Y G)^T / (k beta) + beta C_2^T C_2 < 0,      beta > 0.

So only the product of eps_1 and eps_2 matters. Multiplying P, Y, Q and beta by one number changes nothing, so Q = I and
beta >= 1 / (4 max |C_2|^2) can be asked for without loss. Solved is the inequality with I in place of Q, and stored
will be Q = I/2: what lies between is the slack that rounding and the solver's tolerance may eat.

Among all solutions, the one with the least tr(P) + tr(L^T P L): it bounds the energy of the state error after unit
impulses on every state and every output, in balanced units and on any path through the region. A gain too small pays in
the first term, a gain too large in the second; for a single vertex it is the Kalman filter for unit intensities.
"""

import warnings
from dataclasses import dataclass
from typing import Any

import cvxpy
import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array

cp: Any = cvxpy
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class LmiSolution:
    """Numbers of a solver, to be checked."""

    P: Array  # (n, n)
    L: Array  # (n, r)
    beta: float


def free_gain(A: Array, C: Array, map_output: int, k: float, linked: Mask, cascade: bool) -> LmiSolution | str:
    """Return a gain for balanced matrices A, shape (N, n, n), and C, (N, r, n), or the solver's word where it has none.

    k is eps_1 eps_2. Entries of P and L may differ from zero where they are `linked`, shape (n, n + r): between parts of a
    plant that are not tied the best solution has none. A cascade keeps the column of the map's output at zero.
    """
    _, r, n = C.shape
    P, Y = cp.Variable((n, n), symmetric=True), cp.Variable((n, r))
    Z = cp.Variable((r, r), symmetric=True)
    allowed = linked.copy()
    if cascade:
        allowed[:, n + map_output] = False
    constraints = [cp.bmat([[Z, Y.T], [Y, P]]) >> 0]
    if not allowed.all():
        constraints.append(cp.hstack([P, Y])[~allowed] == 0)
    halves = [P @ a - Y @ c for a, c in zip(A, C, strict=True)]
    beta, more = _vertices(P, halves, Y[:, [map_output]], C[:, map_output], k, cascade)
    word = _solve(cp.trace(P) + cp.trace(Z), constraints + more)
    if P.value is None:
        return word
    P_value, Y_value = np.where(allowed[:, :n], P.value, 0.0), np.where(allowed[:, n:], Y.value, 0.0)
    return _usable(P_value, lambda: np.linalg.solve(P_value, Y_value), beta, word)


def fixed_gain(closed: Array, L: Array, C_2: Array, map_output: int, k: float) -> LmiSolution | str:
    """Return P for balanced A - L C (N, n, n), L (n, r), C_2 (N, n), k = eps_1 eps_2; the solver's word where it has none."""
    n, _ = L.shape
    P = cp.Variable((n, n), symmetric=True)
    column = L[:, [map_output]]
    beta, constraints = _vertices(P, [P @ f for f in closed], P @ column, C_2, k, not column.any())
    word = _solve(cp.trace(P), [P >> 0, *constraints])
    return word if P.value is None else _usable(P.value, lambda: L, beta, word)


def _vertices(P: Any, halves: list[Any], PLG: Any, C_2: Array, k: float, cascade: bool) -> tuple[Any, list[Any]]:
    """Return beta and the constraints at the vertices; `halves` are P (A - L C); a cascade keeps beta at its bound."""
    _, n = C_2.shape
    longest = float((C_2**2).sum(axis=1).max())
    least = 0.25 / longest if longest > 0.0 else 1.0
    if cascade:
        return cp.Constant(least), [-half - half.T - np.eye(n) >> 0 for half in halves]
    beta, S = cp.Variable(), cp.Variable((n, n), symmetric=True)
    corner = cp.reshape(k * beta, (1, 1), order="C")
    constraints = [cp.bmat([[S, PLG], [PLG.T, corner]]) >> 0, beta >= least]
    for half, c in zip(halves, C_2, strict=True):
        constraints.append(-half - half.T - S - beta * np.outer(c, c) - np.eye(n) >> 0)  # Eq. (27)
    return beta, constraints


def _solve(objective: Any, constraints: list[Any]) -> str:
    problem = cp.Problem(cp.Minimize(objective), constraints)
    with warnings.catch_warnings():
        # It warns of an inaccurate optimum: as good as any other once the certificate has passed it.
        warnings.simplefilter("ignore", UserWarning)
        try:
            problem.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return "the solver stopped with an error"
    return f"status of the solver: {problem.status}"


def _usable(P: Array, gain: Any, beta: Any, word: str) -> LmiSolution | str:
    """Return the solution where P is positive definite, so that L = P^-1 Y exists."""
    if beta.value is None or not np.all(np.isfinite(P)) or np.linalg.eigvalsh(P).min() <= 0.0:
        return word
    return LmiSolution((P + P.T) / 2.0, gain(), float(beta.value))
