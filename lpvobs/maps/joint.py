"""What several nodes say together: values at points, means over regions, differences of maps, with the full covariance.

All of them are sums of nodes with weights, so a matrix of weights W turns the map theta into W theta, and its covariance C into
W C W^T.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from lpvobs.errors import DataError
from lpvobs.records import Array

NORMAL_90 = 1.6448536269514722
SNAP = 1e-6  # share of a cell by which an axis of rounded numbers may miss the node that it means
DIRECTIONS = 1e-3
"""Share of the largest variance below which a direction of a covariance is rounding, or more detail than a bilinear map has."""


@dataclass(frozen=True)
class Joint:
    """Values that are known with an uncertainty."""

    values: Array  # (K,)
    covariance: Array  # (K, K) of their errors

    @property
    def standard_error(self) -> Array:
        """Standard errors, shape (K,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def ci90(self) -> Array:
        """90 % intervals, shape (K, 2)."""
        half = NORMAL_90 * self.standard_error
        return np.stack([self.values - half, self.values + half], axis=-1)

    def nothing(self) -> float:
        """Return how probable values as far from zero are if all are zero in truth: chi-square along the known directions."""
        variances, axes = np.linalg.eigh(self.covariance)
        kept = variances > DIRECTIONS * variances[-1]
        squares = (axes.T @ self.values)[kept] ** 2 / variances[kept]
        return float(scipy.special.chdtrc(kept.sum(), squares.sum()))


def combined(weights: Array, values: Array, covariance: Array) -> Joint:
    """Return sums of nodes, weights (K, p), values (p,), covariance (p, p); raises DataError where one is unknown."""
    used = np.flatnonzero(np.any(weights != 0.0, axis=0))
    unknown = int(np.count_nonzero(~np.isfinite(values[used])))
    if unknown:
        raise DataError(
            f"map: {unknown} of {used.size} nodes needed have no value; run `lpvobs extrapolate` to fill them"
        )
    W = weights[:, used]
    return Joint(W @ values[used], W @ covariance[np.ix_(used, used)] @ W.T)


def at_weights(nodes: Array, at: Array) -> Array:
    """Return how much each node of an axis counts at each place, shape (len(at), len(nodes)); a row of zeros outside."""
    cell = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, nodes.size - 2)
    share = (at - nodes[cell]) / (nodes[cell + 1] - nodes[cell])
    inside = (share >= -SNAP) & (share <= 1 + SNAP)
    share = np.where(np.abs(share) <= SNAP, 0.0, np.where(np.abs(share - 1) <= SNAP, 1.0, share))
    weights = np.zeros((at.size, nodes.size))
    rows = np.arange(at.size)
    weights[rows, cell] = np.where(inside, 1 - share, 0.0)
    weights[rows, cell + 1] += np.where(inside, share, 0.0)
    return weights


def mean_weights(nodes: Array, low: float, high: float) -> Array:
    """Return weights (len(nodes),) of a bilinear mean from `low` to `high`; raises DataError for an interval off the axis."""
    if not nodes[0] <= low < high <= nodes[-1]:
        raise DataError(
            f"region: the range is {low:g} to {high:g}, expected two rising values between {nodes[0]:g} and {nodes[-1]:g}"
        )
    places = np.unique(np.concatenate(([low, high], nodes[(nodes > low) & (nodes < high)])))
    steps = np.diff(places) / (high - low)
    share = 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps))  # the map is straight between the places
    return np.asarray(share @ at_weights(nodes, places))
