"""From a problem to a proven gain: balance, solve, return to the problem's units, prove. Imports the solver."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lpvobs.errors import DataError, NotProven
from lpvobs.records import Array
from lpvobs.synthesis import lmi
from lpvobs.synthesis.balance import BalancedUnits, balance
from lpvobs.synthesis.certificate import Gain, check, prove_bound, state_bound
from lpvobs.synthesis.problem import GainProblem

EPSILON = 0.49
"""eps_1 = eps_2: of one sum equal ones have the largest product; Eq. (28) would allow twice as much."""
DIGITS = 12  # of the balanced matrices: rounding in other units must not send the solver along another path
RESOLUTION = 0.01  # of the scale of a region


def synthesise(problem: GainProblem, *, cascade: bool, decay: float = 0.0) -> Gain:
    """Return a gain proven by Theorem 1 on the whole region: Eq. (27), (28), (33).

    With `cascade`, L takes nothing from the map's output: the state estimate does not depend on theta, and P L G = 0. The state
    error is to decay at least as fast as exp(-decay t), `decay` in 1/s, whatever the parameters do inside the region: asked of the
    solver with A + decay I in place of A; the certificate is that of Theorem 1 and does not state it. The paper does not say which
    of the many feasible gains to take; `lpvobs.synthesis.lmi` does.

    Raises NotProven if no gain was found for this region, or the one found does not pass the exact check.
    """
    A, C = problem.matrices()
    units = balance(A, C)
    T, S, rate = units.states, units.outputs, units.rate
    A_balanced = np.round((A * T / T[:, None] + decay * np.eye(T.size)) / rate, DIGITS)
    C_balanced = np.round(C * T / S[:, None], DIGITS)
    found = lmi.free_gain(A_balanced, C_balanced, problem.map_output, EPSILON**2, units.linked, cascade)
    if isinstance(found, str):
        raise _refused(problem, f"no gain was found that can be proven ({found})")
    L = found.L * T[:, None] / S * rate + 0.0  # no negative zeros
    return _proven(problem, units, found, L, (EPSILON, EPSILON))


def certify_fixed_gain(problem: GainProblem, L: Array, epsilon: tuple[float, float] = (EPSILON, EPSILON)) -> Gain:
    """Return a given gain, shape (n, r), with P and Q that prove it on the whole region for eps_1 and eps_2.

    Raises NotProven if no P, Q were found, or they do not pass the exact check; DataError for a gain of the wrong shape or with
    NaN in it.
    """
    A, C = problem.matrices()
    L = np.array(L, dtype=float)
    _, r, n = C.shape
    if L.shape != (n, r) or not np.all(np.isfinite(L)):
        raise DataError(
            f"gain: L has the shape {L.shape}, expected {(n, r)} with finite numbers; synthesise the gain again"
        )
    closed = A - L @ C
    units = balance(closed, C)
    T, S, rate = units.states, units.outputs, units.rate
    m, L_balanced = problem.map_output, L * S / T[:, None] / rate
    closed_balanced, C_2 = np.round(closed * T / T[:, None] / rate, DIGITS), np.round(C[:, m] * T / S[m], DIGITS)
    found = lmi.fixed_gain(closed_balanced, L_balanced, C_2, m, epsilon[0] * epsilon[1])
    if isinstance(found, str):
        raise _refused(problem, f"no matrices P and Q were found that prove the given gain ({found})")
    return _proven(problem, units, found, L, epsilon)


def largest_feasible(
    problem: GainProblem, centre: Sequence[float], *, cascade: bool, decay: float = 0.0
) -> tuple[float, Gain]:
    """Return a gain for the largest part of the region, drawn towards `centre`, and its scale, by bisection.

    The scale is 1 for the whole region; raises NotProven if there is not even a gain for the centre.
    """

    def attempt(scale: float) -> Gain:
        part = replace(problem, region=problem.region.scaled(scale, centre))
        return synthesise(part, cascade=cascade, decay=decay)

    try:
        return 1.0, attempt(1.0)
    except NotProven:
        low, high, best = 0.0, 1.0, attempt(0.0)
    while high - low > RESOLUTION:
        middle = (low + high) / 2.0
        try:
            low, best = middle, attempt(middle)
        except NotProven:
            high = middle
    return low, best


def _proven(
    problem: GainProblem, units: BalancedUnits, found: lmi.LmiSolution, L: Array, epsilon: tuple[float, float]
) -> Gain:
    """Return the gain in the problem's units, with the certificate of exactly these floats."""
    eps_1, eps_2 = epsilon
    # c = 1 / (beta eps_2) of `lmi`, and what y = S w and the time unit make of it.
    c = units.outputs[problem.map_output] ** 2 / (units.rate * found.beta * eps_2)
    squares = np.outer(units.states, units.states)
    P, Q = c * found.P / squares, 0.5 * c * units.rate * np.eye(len(squares)) / squares
    certificate = check(problem, L, P, Q, eps_1, eps_2)
    if not certificate.proven:
        raise _refused(problem, f"the solver's gain does not pass the check in exact arithmetic ({certificate.reason})")
    bound = state_bound(problem, L)
    if bound is not None and (reason := prove_bound(problem, L, bound)):
        raise _refused(problem, reason)
    return Gain(L, P, Q, eps_1, eps_2, problem.region, certificate, bound)


def _refused(problem: GainProblem, what: str) -> NotProven:
    return NotProven(
        f"gain: {what} on the region {problem.region}; expected the matrix inequality Eq. (27) to hold at every vertex; "
        "in [gain], narrow the ranges, add a measured state to outputs, or exclude negative sums with nonnegative_sums"
    )
