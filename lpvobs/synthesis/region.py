"""The set of scheduling parameters that a certificate covers, and its vertices in exact arithmetic."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, pairwise, product
from math import inf

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import UsageError
from lpvobs.records import Array

Point = tuple[Fraction, ...]


@dataclass(frozen=True)
class Region:
    """A box of parameters; pairs of them may be cut by "their sum is not negative".

    The region is a product of blocks: intervals, and polygons for the pairs. Where a matrix inequality is affine in each block
    while the others stand still (the diesel multiplies a_1 with rho_1, rho_2, rho_3, but never rho_2 with rho_4), it may be moved
    to a vertex one block after the other without growing, so the vertices of the product prove the whole region. Raises UsageError
    for bounds that are not finite or not in order, unknown or repeated names, a pair whose sum is negative everywhere.

    Examples
    --------
    >>> region = Region(("x", "y", "a"), (-1.0, 0.5, 2.0), (1.0, 3.0, 2.0), (("x", "y"),))
    >>> len(region.vertices())
    5
    """

    names: tuple[str, ...]  # m parameters
    lower: tuple[float, ...]  # bounds, inclusive; equal bounds fix a parameter and do not double the vertices
    upper: tuple[float, ...]
    nonnegative_sums: tuple[tuple[str, str], ...] = ()  # pairs with x + y >= 0; a parameter belongs to one pair at most

    def __post_init__(self) -> None:
        names, lower, upper = self.names, self.lower, self.upper
        if len(set(names)) != len(names) or not len(names) == len(lower) == len(upper):
            raise UsageError(
                f"region: {len(names)} names, {len(lower)} lower and {len(upper)} upper bounds; expected "
                "one lower and one upper bound for each name, and every name once"
            )
        for name, low, high in zip(names, lower, upper, strict=True):
            if not -inf < low <= high < inf:
                raise UsageError(
                    f"region: {name} has the bounds [{low:g}, {high:g}], expected finite numbers, the lower one first"
                )
        paired = [name for pair in self.nonnegative_sums for name in pair]
        if len(set(paired)) != len(paired) or not set(paired) <= set(names):
            raise UsageError(
                f"region: nonnegative_sums is {self.nonnegative_sums}, expected pairs of the names {names}, each name in "
                "at most one pair"
            )
        for first, second in self.nonnegative_sums:
            if upper[names.index(first)] + upper[names.index(second)] < 0.0:
                raise UsageError(
                    f"region: {first} + {second} is negative in the whole region, but nonnegative_sums asks for zero or more; "
                    "raise an upper bound"
                )

    def vertices(self) -> tuple[Point, ...]:
        """Return every vertex as exact fractions, in the order of `names`, none twice."""
        blocks = self.blocks()
        blockwise = [name for names, _ in blocks for name in names]
        order = [blockwise.index(name) for name in self.names]
        points = (list(chain(*choice)) for choice in product(*(corners for _, corners in blocks)))  # Eq. (33)
        return tuple(tuple(point[k] for k in order) for point in points)

    def blocks(self) -> tuple[tuple[tuple[str, ...], tuple[Point, ...]], ...]:
        """Return the factors of the product: the parameters of each block and its corners."""
        paired = {name for pair in self.nonnegative_sums for name in pair}
        single = [((name,), tuple((end,) for end in self._ends(name))) for name in self.names if name not in paired]
        polygons = [(pair, _clip(self._ends(pair[0]), self._ends(pair[1]))) for pair in self.nonnegative_sums]
        return (*single, *polygons)

    def contains(self, values: Array) -> NDArray[np.bool_]:
        """Tell which samples, shape (N, m), lie inside; parameters are in the order of `names`, and NaN is outside."""
        inside = np.all((values >= self.lower) & (values <= self.upper), axis=1)
        for first, second in self.nonnegative_sums:
            inside &= values[:, self.names.index(first)] + values[:, self.names.index(second)] >= 0.0
        return np.asarray(inside)

    def scaled(self, s: float, centre: Sequence[float]) -> "Region":
        """Return the region with its box drawn towards a point inside, s = 1 the whole of it, s = 0 the point.

        Cuts stay where they are, so the regions are nested in s. Raises UsageError for a centre outside or s outside [0, 1].
        """
        if not 0.0 <= s <= 1.0:
            raise UsageError(f"region: scale is {s:g}, expected 0 to 1")
        if len(centre) != len(self.names) or not self.contains(np.array([centre], dtype=float))[0]:
            raise UsageError(
                f"region: the centre {tuple(centre)} is not inside {self}; expected {len(self.names)} "
                "values within the bounds: choose another centre"
            )
        # Rounding must not push a bound past the original one: the regions are promised to be nested.
        point, low, high = np.array([centre, self.lower, self.upper], dtype=float)
        lower, upper = np.maximum(low, point + s * (low - point)), np.minimum(high, point + s * (high - point))
        return Region(self.names, tuple(lower.tolist()), tuple(upper.tolist()), self.nonnegative_sums)

    def place(self, point: Sequence[Fraction]) -> str:
        """Return a point as one line of text; raises ValueError where it has not one value per name."""
        return ", ".join(f"{name} = {float(value):.6g}" for name, value in zip(self.names, point, strict=True))

    def __str__(self) -> str:
        """Return the bounds as one line of text."""
        bounds = zip(self.names, self.lower, self.upper, strict=True)
        box = [f"{name} [{low:.6g}, {high:.6g}]" for name, low, high in bounds]
        return ", ".join(box + [f"{first} + {second} >= 0" for first, second in self.nonnegative_sums])

    def _ends(self, name: str) -> tuple[Fraction, ...]:
        index = self.names.index(name)
        return tuple(dict.fromkeys((Fraction(self.lower[index]), Fraction(self.upper[index]))))


def _clip(x: tuple[Fraction, ...], y: tuple[Fraction, ...]) -> tuple[Point, ...]:
    """Return the corners of the rectangle x by y where the sum of the coordinates is not negative."""
    ring = list(dict.fromkeys(((x[0], y[0]), (x[-1], y[0]), (x[-1], y[-1]), (x[0], y[-1]))))
    corners: list[Point] = []
    for here, there in pairwise([*ring, ring[0]]):
        sum_here, sum_there = here[0] + here[1], there[0] + there[1]
        if sum_here >= 0:
            corners.append(here)
        if sum_here * sum_there < 0:  # the edge crosses the cut
            corners.append((here[0], -here[0]) if here[0] == there[0] else (-here[1], here[1]))
    return tuple(dict.fromkeys(corners))


@dataclass(frozen=True)
class GainSettings:
    """The region that the certificate is to cover, and the form of the gain."""

    outputs: tuple[str, ...]  # measured states that the observer corrects itself by; the sensor comes after them
    # scheduling parameters where no log tells their range; with logs, the range of the logs counts
    bounds: Mapping[str, tuple[float, float]]
    # [K]; ranges of the temperatures behind a_1 and a_2; logs do not widen or narrow them
    temperatures: Mapping[str, tuple[float, float]]
    margin: float = 0.05  # share of the range of the logs by which it is widened at either end
    # [1/s], least decay of the state error. A fast state stays with its measurements, which are good; a slow one leans
    # on the engine model, and its wrong constants then reach both balances at once.
    decay: float = 0.0
    # pairs of parameters whose sum never is negative, which cuts the box
    nonnegative_sums: tuple[tuple[str, str], ...] = ()
    cascade: bool = True  # the sensor does not correct the state: the last column of L is zero

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin <= 1.0:
            raise ValueError("margin must be a fraction between 0 and 1")
        if not 0.0 <= self.decay < 1e6:
            raise ValueError("decay must be at least 0 and below 1e6 1/s")
        for name, (low, high) in {**self.bounds, **self.temperatures}.items():
            if not -inf < low <= high < inf:
                raise ValueError(f"the bounds of {name} must be two finite numbers, the lower one first")
        for name, (low, _) in self.temperatures.items():
            if not low > 0:
                raise ValueError(f"temperature {name} must be above 0 K")
