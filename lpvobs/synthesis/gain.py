"""The observer's gain with its proof, and what can be said of it without one."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.synthesis.certificate import Certificate
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region


@dataclass(frozen=True, eq=False)
class Gain:
    """A feedback gain of Eq. (26) and the numbers that prove it.

    Attributes
    ----------
    L : ndarray, shape (n, r)
        [state unit / (output unit s)]
    P, Q : ndarray, shape (n, n)
        Of Theorem 1.
    eps_1, eps_2 : float
        Of Theorem 1.
    region : Region
        What the certificate covers.
    certificate : Certificate
        Proven; a gain without a proof is not made.
    """

    L: Array
    P: Array
    Q: Array
    eps_1: float
    eps_2: float
    region: Region
    certificate: Certificate


def poles(problem: GainProblem, L: Array) -> NDArray[np.complex128]:
    """Return the eigenvalues of A - L C at the N vertices, shape (N, n), [1/s]. Floats: an aid, not a proof."""
    A, C = problem.matrices()
    return np.linalg.eigvals(A - L @ C).astype(np.complex128)


def hurwitz_at_vertices(problem: GainProblem, L: Array) -> bool:
    """Tell whether A - L C is Hurwitz at every vertex: necessary for stability, not sufficient."""
    return bool(poles(problem, L).real.max() < 0.0)


def hurwitz_interval(
    problem_at: Callable[[float], GainProblem],
    L: Array,
    inside: float,
    *,
    reach: float = 100.0,
    resolution: float = 1e-4,
) -> tuple[float, float]:
    """Return the interval of one number around `inside` in which A - L C is Hurwitz at every vertex.

    Parameters
    ----------
    problem_at : callable
        The problem for a value of that number, for example the ratio a_1/a_2 with a_2 at rest.
    L : ndarray, shape (n, r)
    inside : float
        A value where it is Hurwitz; positive.
    reach : float
        How far to look: from inside/reach to inside times reach. Where no limit lies in between, that end is returned.
    resolution : float
        Relative accuracy of the limits.

    Raises
    ------
    UsageError
        It is not Hurwitz at `inside`.

    Notes
    -----
    Eigenvalues in floating point at the vertices: what no gain may fail, not a proof of stability.
    """
    if not hurwitz_at_vertices(problem_at(inside), L):
        raise UsageError(f"gain: A - L C is not Hurwitz at {inside:g}; expected a value inside the interval looked for")

    def limit(good: float, bad: float) -> float:
        if hurwitz_at_vertices(problem_at(bad), L):
            return bad
        while abs(np.log(bad / good)) > resolution:
            middle = float(np.sqrt(good * bad))
            good, bad = (middle, bad) if hurwitz_at_vertices(problem_at(middle), L) else (good, middle)
        return good

    return limit(inside, inside / reach), limit(inside, inside * reach)
