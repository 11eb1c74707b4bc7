"""Matrices of fractions: what the proofs are worked out in."""

from collections.abc import Sequence
from fractions import Fraction
from math import inf, lcm

from lpvobs.records import Array

Matrix = list[list[Fraction]]
TINY = 5e-324  # stands for a positive pivot too small for a float, which must not read as zero


def fractions(values: Array) -> Matrix:
    """Return the exact values of a matrix of floats."""
    return [[Fraction(float(value)) for value in row] for row in values]


def product(left: Sequence[Sequence[Fraction]], right: Sequence[Sequence[Fraction]]) -> Matrix:
    """Return the product of two matrices; raises ValueError where they do not fit."""
    (rows, by), (others, its) = _whole(left), _whole(right)
    columns = list(zip(*others, strict=True))
    return [
        [Fraction(sum(a * b for a, b in zip(row, column, strict=True)), by * its) for column in columns] for row in rows
    ]


def _whole(matrix: Sequence[Sequence[Fraction]]) -> tuple[list[list[int]], int]:
    """Return a matrix of whole numbers and what it is to be divided by: no fraction is reduced on the way."""
    scale = lcm(*(entry.denominator for row in matrix for entry in row))
    return [[entry.numerator * (scale // entry.denominator) for entry in row] for row in matrix], scale


def smallest_pivot(matrix: Matrix) -> float:
    """Return the smallest pivot of LDL^T of a symmetric matrix over its diagonal entry, or the first that is not positive.

    The matrix is positive definite if and only if the value is positive. On whole numbers by Bareiss' elimination, whose
    diagonal holds the leading minors; a pivot is the ratio of two of them.
    """
    work = _whole(matrix)[0]
    diagonal = [row[k] for k, row in enumerate(work)]
    before, smallest = 1, inf
    for k, pivot_row in enumerate(work):
        if diagonal[k] <= 0:
            return -1.0
        minor = pivot_row[k]
        ratio = Fraction(minor, before * diagonal[k])
        if ratio <= 0:
            return float(max(ratio, Fraction(-1)))
        smallest = min(smallest, float(ratio) or TINY)
        for row in work[k + 1 :]:
            for j in range(k + 1, len(row)):
                row[j] = (row[j] * minor - row[k] * pivot_row[j]) // before
        before = minor
    return smallest
