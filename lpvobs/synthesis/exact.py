"""Matrices of fractions, as arrays of Python's own numbers: what the proofs are worked out in."""

from fractions import Fraction
from math import inf, lcm
from typing import Any

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[Any]  # of fractions, or whole numbers
TINY = 5e-324  # stands for a positive pivot too small for a float, which must not read as zero


def fractions(values: Any) -> Matrix:
    """Return the exact values of an array of floats or fractions."""
    return np.asarray(np.vectorize(Fraction, otypes=[object])(np.asarray(values, dtype=object)))


def product(left: Matrix, right: Matrix) -> Matrix:
    """Return the product of two matrices; raises ValueError where they do not fit."""
    (rows, by), (columns, its) = _whole(left), _whole(right)
    return np.asarray(rows @ columns * Fraction(1, by * its))


def _whole(matrix: Matrix) -> tuple[Matrix, int]:
    """Return a matrix of whole numbers and what it is to be divided by: no fraction is reduced on the way."""
    scale = lcm(*(entry.denominator for entry in matrix.flat))
    return np.vectorize(lambda entry: entry.numerator * (scale // entry.denominator), otypes=[object])(matrix), scale


def falling(P: Matrix, Y: Matrix, A: Matrix, C: Matrix) -> Matrix:
    """Return -(A - L C)^T P - P (A - L C), with Y = P L."""
    half = product(Y, C) - product(P, A)
    return np.asarray(half + half.T)


def smallest_pivot(matrix: Matrix) -> float:
    """Return the smallest pivot of LDL^T of a symmetric matrix over its diagonal entry, or the first that is not positive.

    The matrix is positive definite if and only if the value is positive. On whole numbers by Bareiss' elimination, whose
    diagonal holds the leading minors; a pivot is the ratio of two of them.
    """
    work = _whole(matrix)[0]
    before, smallest = 1, inf
    for k, entry in enumerate(work.diagonal().tolist()):
        if entry <= 0:
            return -1.0
        minor, rest = work[k, k], slice(k + 1, None)
        ratio = Fraction(minor, before * entry)
        if ratio <= 0:
            return float(max(ratio, Fraction(-1)))
        smallest = min(smallest, float(ratio) or TINY)
        work[rest, rest] = (work[rest, rest] * minor - np.outer(work[rest, k], work[k, rest])) // before
        before = minor
    return smallest
