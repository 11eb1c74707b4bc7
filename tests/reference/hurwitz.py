"""Eigenvalues of the closed loop at the vertices, in floating point: what no gain may fail, not a proof."""

import numpy as np


def poles(problem, L):
    """Return the eigenvalues of A - L C at the N vertices, shape (N, n), [1/s]."""
    A, C = problem.matrices()
    return np.linalg.eigvals(A - L @ C)


def is_hurwitz(problem, L):
    return bool(poles(problem, L).real.max() < 0.0)


def limit(problem_at, L, good, bad):
    """Return where between two values of one number, the second one bad, A - L C stops being Hurwitz; to 1e-4 of it."""
    assert is_hurwitz(problem_at(good), L)
    assert not is_hurwitz(problem_at(bad), L)
    while abs(np.log(bad / good)) > 1e-4:
        middle = float(np.sqrt(good * bad))
        good, bad = (middle, bad) if is_hurwitz(problem_at(middle), L) else (good, middle)
    return good
