"""The smooth function that a balance leaves on healthy drives: bells over channels, and lines over rates.

The function is a Gaussian process over the channels. It is written as a sum of bells around some instants of the healthy drives,
as many as it takes. Bells overlap, so before any data their weights depend on each other; `root` makes features of them whose
weights do not.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
import scipy

from lpvobs.discovery.thresholds import FAR, RIDGE, SHAPES, SHARPER
from lpvobs.records import Array, Item


@dataclass(frozen=True, eq=False)
class Bells:
    """m bells over c channels and lines over r rates, f = m + r in all, and what is learned of them beside n constants."""

    centres: Annotated[
        Array, Item("1", "middle of a bell, in standard deviations from a channel's mean", ("bell", "channel"))
    ]
    lengths: Annotated[
        Array, Item("1", "length of the bells along a channel, in its standard deviations", ("channel",))
    ]
    weights: Annotated[Array, Item("kg/s", "weight of each bell and each line in the residual", ("feature",))]
    by_constant: Annotated[
        Array,
        Item("kg/s", "derivative of the weights by the relative deviation of a constant", ("feature", "constant")),
    ]
    unsure: Annotated[
        Array,
        Item("kg/s", "root U of the weights' covariance U U^T, in independent columns", ("feature", "other_feature")),
    ]
    daily: Annotated[
        Array, Item("1", "weights of shapes of unit size that differ from day to day, independent", ("bell", "shape"))
    ]

    def along(self, inputs: Array) -> Array:
        """Return bells and lines, shape (k, f), of inputs of shape (k, c + r)."""
        c, m = self.lengths.size, len(self.centres)
        out = np.empty((len(inputs), m + inputs.shape[1] - c))
        out[:, :m], out[:, m:] = bells_of(inputs[:, :c], self.centres, self.lengths), inputs[:, c:]
        return out

    def steady(self, along: Array) -> Array:
        """Return the function without its lines, (k,), of bells and lines: what it is where nothing changes."""
        return np.asarray(along[:, : len(self.centres)] @ self.weights[: len(self.centres)])

    def of_day(self, along: Array) -> Array:
        """Return what may differ from one day to the next, (k, 1 + shapes), of unit size: a level, and shorter bells."""
        return np.hstack([np.ones((len(along), 1)), shorter(along[:, : len(self.centres)]) @ self.daily])

    def with_days(self, inputs: Array) -> "Bells":
        """Return the same with the shapes of a day that vary most along inputs, shape (k, c)."""
        own, along = (shorter(bells_of(x, self.centres, self.lengths)) for x in (self.centres, inputs))
        root = _root(own)
        _, axes = np.linalg.eigh(root @ along.T @ along @ root.T)
        return replace(self, daily=root.T @ axes[:, ::-1][:, :SHAPES])

    @cached_property
    def root(self) -> Array:
        """R, shape (m, m): before any data, the features R b of the bells b have independent weights of unit variance."""
        return _root(bells_of(self.centres, self.centres, self.lengths))

    def root_with_lines(self, f: int) -> Array:
        """Return the same for bells and lines, shape (f, f); the lines' weights are independent as they are."""
        return np.asarray(scipy.linalg.block_diag(self.root, np.eye(f - len(self.root))))

    def missed(self, views: Array, along: Array) -> Array:
        """Return the share of the function's variance that these bells lack, shape (k,).

        `views` are the inputs, (2, k, c + r), `along` the mean of their bells and lines. The mean of two views varies less than the
        function itself.
        """
        apart = (views[0] - views[1])[:, : self.lengths.size] / self.lengths
        features = along[:, : len(self.root)] @ self.root.T
        of_mean = 0.5 * (1.0 + np.exp(-0.5 * (apart**2).sum(1)))
        return np.asarray(np.maximum(of_mean - (features**2).sum(1), 0.0))

    def elsewhere(self, views: Array, along: Array, enough: float) -> Array:
        """Return features of what these bells lack, independent and of unit size, shape (k, n): of bells around n of the inputs.

        There are so many that the inputs lack `enough` of the function's variance on average, and none where they lack no more.
        Arguments as of `missed`.
        """
        (m, c), known = self.centres.shape, along[:, : len(self.centres)]
        added = spread_out(views[..., :c].mean(0) / self.lengths, SHAPES, enough, known @ self.root.T) * self.lengths
        bells = 0.5 * sum(bells_of(view[:, :c], added, self.lengths) for view in views)
        every = replace(self, centres=np.vstack([self.centres, added]))
        return np.asarray(np.hstack([known, bells]) @ every.root[m:].T)

    def slopes(self, inputs: Array) -> Array:
        """Return the derivatives of the function by its inputs, shape (k, c + r)."""
        c = self.lengths.size
        heights, lines = np.split(self.weights, [len(self.centres)])
        pulled = bells_of(inputs[:, :c], self.centres, self.lengths) * heights
        by_channel = (pulled @ self.centres - pulled.sum(1)[:, None] * inputs[:, :c]) / self.lengths**2
        slopes = np.hstack([by_channel, np.broadcast_to(lines, (len(inputs), lines.size))])
        return np.asarray(slopes * (np.abs(inputs) < FAR))


def _root(kernel: Array) -> Array:
    return np.asarray(np.linalg.inv(np.linalg.cholesky(kernel + RIDGE * np.eye(len(kernel)))))


def bells_of(x: Array, centres: Array, lengths: Array) -> Array:
    """Return exp(-|x - centre|^2 / 2) in units of the lengths, shape (k, m), of points of shape (k, c)."""
    x, centres = x / lengths, centres / lengths
    distance = (x**2).sum(1)[:, None] + (centres**2).sum(1)
    distance -= 2.0 * x @ centres.T
    return np.asarray(np.exp(-0.5 * np.maximum(distance, 0.0, out=distance), out=distance))


def shorter(bells: Array) -> Array:
    """Return the bells that reach less far, by which days differ, at the places of these."""
    root = np.sqrt(SHARPER)
    return np.asarray((bells**root) ** root)  # two squares: other powers take ten times as long


def spread_out(x: Array, most: int, enough: float, known: Array | None = None) -> Array:
    """Return points of x, shape (k, c), where bells of unit length stand: each where those before tell least.

    There are `most` at most, and no more once the points lack at most `enough` of the function's variance on average. `known` are
    the features, (k, m), of bells that stand already.
    """
    known = np.zeros((len(x), 0)) if known is None else known
    chosen: list[int] = []
    told, m = (known**2).sum(1), known.shape[1]
    rows = np.vstack([known.T, np.empty((most, len(x)))])
    while len(chosen) < most and (1.0 - told).sum() > enough * len(x):  # a Cholesky decomposition with pivots
        i, j = m + len(chosen), int(np.argmin(told))
        if 1.0 - told[j] < RIDGE:
            break
        row = np.exp(-0.5 * ((x - x[j]) ** 2).sum(1)) - rows[:i, j] @ rows[:i]
        rows[i] = row / np.sqrt(1.0 - told[j])
        told += rows[i] ** 2
        chosen.append(j)
    return x[chosen]
