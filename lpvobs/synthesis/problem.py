"""What a gain is asked for: an LPV system, the region of its parameters, the output that carries the map."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from numbers import Rational
from typing import Any

import numpy as np

from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.synthesis.exact import Matrix, product
from lpvobs.synthesis.region import Point, Region

System = Callable[[Sequence[Fraction]], tuple[Sequence[Sequence[Any]], Sequence[Sequence[Any]]]]


@dataclass(frozen=True)
class GainProblem:
    """The data of Theorem 1."""

    # Parameters in the order of `region.names`, as fractions, to A (n x n) and C (r x n) as nested sequences of whole
    # numbers or fractions. Exact: a float among them would make the certificate speak of another system.
    system: System
    region: Region  # where M(rho) < 0 is wanted
    map_output: int  # row of C that is C_2; G is the unit vector of this output

    def at(self, point: Sequence[Fraction]) -> tuple[Matrix, Matrix]:
        """Return A and C at one point; raises UsageError where they are not exact or their shapes do not fit."""
        raw_A, raw_C = self.system(point)
        A, C = _exact(raw_A), _exact(raw_C)
        n = len(A)
        if n == 0 or any(len(row) != n for row in (*A, *C)):
            raise UsageError(
                f"system: the rows of A have {[len(row) for row in A]} entries and the rows of C {[len(row) for row in C]}; "
                "expected a square A, and as many columns in C as in A"
            )
        if not 0 <= self.map_output < len(C):
            raise UsageError(
                f"system: map_output is {self.map_output}, expected the number of a row of C, 0 to {len(C) - 1}"
            )
        return A, C

    def matrices(self) -> tuple[Array, Array]:
        """Return A, shape (N, n, n), and C, shape (N, r, n), at the N vertices, rounded to floats."""
        pairs = [self.at(vertex) for vertex in self.region.vertices()]
        return np.array([A for A, _ in pairs], dtype=float), np.array([C for _, C in pairs], dtype=float)


def bent_block(problem: GainProblem) -> tuple[str, ...] | None:
    """Return a block of parameters in which the system is not affine, None where vertices prove the region."""
    # Each block is walked along a slanted line through the inside of the region, the other blocks at rest: equal slopes
    # over the whole and over the first third mean affine, for any polynomial without coefficients made to deceive.
    blocks = problem.region.blocks()
    rest: dict[str, Fraction] = {}
    for names, corners in blocks:
        rest |= _inside(names, corners, 1)
    for names, corners in blocks:
        end = rest | _inside(names, corners, 2)
        third = {name: rest[name] + (end[name] - rest[name]) / 3 for name in rest}
        start, short, long = (_flat(problem, place) for place in (rest, third, end))
        if any(c - a != 3 * (b - a) for a, b, c in zip(start, short, long, strict=True)):
            return names
    return None


def _inside(names: Sequence[str], corners: Sequence[Point], power: int) -> dict[str, Fraction]:
    """Return an uneven mixture of a block's corners; another power is another mixture."""
    weights = [Fraction(k**power) for k in range(1, len(corners) + 1)]
    return {name: value / sum(weights) for name, value in zip(names, product([weights], corners)[0], strict=True)}


def _flat(problem: GainProblem, place: dict[str, Fraction]) -> list[Fraction]:
    A, C = problem.at([place[name] for name in problem.region.names])
    return [entry for row in (*A, *C) for entry in row]


def _exact(rows: Sequence[Sequence[Any]]) -> Matrix:
    for row in rows:
        for entry in row:
            if not isinstance(entry, Rational):
                raise UsageError(
                    f"system: {entry!r} is a {type(entry).__name__}, expected an exact fraction; use no floats"
                )
    return [[Fraction(entry) for entry in row] for row in rows]
