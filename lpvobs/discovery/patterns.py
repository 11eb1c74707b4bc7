"""What the errors of a healthy engine may look like: shapes along the places of a problem, each in one balance."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.records import Array


@dataclass(frozen=True, eq=False)
class Patterns:
    """The m shapes of B balances along K places, each of size one before any data."""

    each: tuple[Array, ...]  # of every balance, (m_b, K)

    def __len__(self) -> int:
        """Return the number of shapes."""
        return sum(len(shapes) for shapes in self.each)

    def along(self, sizes: Array) -> Array:
        """Return their sum with sizes of shape (m,), shape (B, K)."""
        parts = np.split(sizes, np.cumsum([len(shapes) for shapes in self.each])[:-1])
        return np.stack([size @ shapes for size, shapes in zip(parts, self.each, strict=True)])

    def times(self, values: Array) -> Array:
        """Return the product with values of shape (B, K) at every place, shape (m, K)."""
        return np.concatenate([shapes * row for shapes, row in zip(self.each, values, strict=True)])

    def sums(self, values: Array) -> Array:
        """Return the sums of that product over the places, with values of shape (..., B, K), shape (..., m)."""
        return np.concatenate([values[..., b, :] @ shapes.T for b, shapes in enumerate(self.each)], axis=-1)

    def by_block(self, values: Array, first: NDArray[np.int64]) -> Array:
        """Return the same over blocks of places that begin at `first`, with values of shape (B, K), shape (blocks, m)."""
        return np.hstack([_by_block(shapes, row, first) for shapes, row in zip(self._by_place, values, strict=True)])

    @cached_property
    def _by_place(self) -> tuple[Array, ...]:
        """The shapes of every balance with the places first, (K, m_b)."""
        return tuple(np.ascontiguousarray(shapes.T) for shapes in self.each)

    def gram(self, precision: Array) -> Array:
        """Return the products with each other, shape (m, m); `precision` is that of the balances at a place, (B, B, K)."""
        above = {
            (i, j): (a * precision[i, j]) @ b.T
            for i, a in enumerate(self.each)
            for j, b in enumerate(self.each)
            if i <= j
        }
        numbers = range(len(self.each))
        return np.block([[above[i, j] if i <= j else above[j, i].T for j in numbers] for i in numbers])

    def at(self, instants: NDArray[np.int64] | slice) -> "Patterns":
        """Return the same at some of the places."""
        return Patterns(tuple(shapes[:, instants] for shapes in self.each))


@njit(cache=True)
def _by_block(shapes, row, first):  # type: ignore[no-untyped-def]
    """Return the sums by block of shapes, (K, m), times values, (K,), shape (blocks, m)."""
    out = np.zeros((first.size, shapes.shape[1]))
    for b in range(first.size):
        for k in range(first[b], first[b + 1] if b + 1 < first.size else row.size):
            for i in range(shapes.shape[1]):
                out[b, i] += shapes[k, i] * row[k]
    return out


def beyond_of(information: Array, size: Array, share: Array, most: Array) -> Array:
    """Return the variance of a size over that of noise, 1/information, of an effect that acts for a share of the time.

    What varies with the time on a healthy drive varies more within a shorter time: below half a drive as the noise does.
    """
    return np.asarray(np.minimum(information * size**2 * np.maximum(1.0, 0.5 / share), most))


@dataclass(frozen=True)
class Seeming:
    """What a healthy engine seems to have of effects: the standard deviation of their sizes beyond noise.

    The curve of a component has no single size. What is known is the variance of its shape beside the component's factor.
    """

    whole: Mapping[str, float] = field(default_factory=dict)  # by effect, in its unit, where it acts all along
    late: Mapping[str, float] = field(default_factory=dict)  # where it acts from the middle of a drive on
    # by effect, the variance over that of noise, by independent residual
    effects: Mapping[str, float] = field(default_factory=dict)
    places: Mapping[str, float] = field(default_factory=dict)  # of a curve or a formula, by the place where it acts
    common: float = 0.0  # the same of all effects together, for any other place
    uneven: float = 1.0  # the largest variance over blocks of the score of an effect, over that of noise
    degrees: float = np.inf  # drives that tell of it, those that the pooled variance counts as among them
    drives: int = 0  # those drives alone
    most: int = 0  # drives as long as these that are learned from at most
    # by effect, by place, and by "" for any other: what the search for one end, and for two, finds, over what it finds in noise
    searched: Mapping[str, Array] = field(default_factory=dict)
