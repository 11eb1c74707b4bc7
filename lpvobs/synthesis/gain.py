"""The observer's gain with its proof, and what can be said of it without one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array
from lpvobs.synthesis.certificate import Certificate
from lpvobs.synthesis.problem import Problem
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


def poles(problem: Problem, L: Array) -> NDArray[np.complex128]:
    """Return the eigenvalues of A - L C at the N vertices, shape (N, n), [1/s]. Floats: an aid, not a proof."""
    A, C = problem.matrices()
    return np.linalg.eigvals(A - L @ C).astype(np.complex128)


def hurwitz_at_vertices(problem: Problem, L: Array) -> bool:
    """Tell whether A - L C is Hurwitz at every vertex: necessary for stability, not sufficient."""
    return bool(poles(problem, L).real.max() < 0.0)
