"""What a gain is asked for: an LPV system, the region of its parameters, the output that carries the map."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from numbers import Rational
from typing import Any

import numpy as np

from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.synthesis.exact import Matrix, fractions
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
        A, C = self.system(point)
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
        return _exact(A), _exact(C)

    def matrices(self) -> tuple[Array, Array]:
        """Return A, shape (N, n, n), and C, shape (N, r, n), at the N vertices, rounded to floats."""
        A, C = zip(*map(self.at, self.region.vertices()), strict=True)
        return np.array(A, dtype=float), np.array(C, dtype=float)


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
        if np.any(long - start != 3 * (short - start)):
            return names
    return None


def _inside(names: Sequence[str], corners: Sequence[Point], power: int) -> dict[str, Fraction]:
    """Return an uneven mixture of a block's corners; another power is another mixture."""
    weights = fractions(np.arange(1, len(corners) + 1) ** power)
    return dict(zip(names, weights @ fractions(corners) / weights.sum(), strict=True))


def _flat(problem: GainProblem, place: dict[str, Fraction]) -> Matrix:
    return np.concatenate([matrix.ravel() for matrix in problem.at([place[name] for name in problem.region.names])])


def _exact(rows: Sequence[Sequence[Any]]) -> Matrix:
    for row in rows:
        for entry in row:
            if not isinstance(entry, Rational):
                raise UsageError(
                    f"system: {entry!r} is a {type(entry).__name__}, expected an exact fraction; use no floats"
                )
    return fractions(rows)
