"""How much better a log is explained with an effect from some block on: all sizes, all onsets.

With r the imbalances, z(x) their change when an effect of size x is undone everywhere, m the blocks where it acts and P the inverse
covariance, half the weighted sum of squares falls by  -(P r)' m z - z' m P m z / 2.  For all onsets at once the second term is one
product with the triangle of P and a sum from the end.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from lpvobs.records import Array


@dataclass(frozen=True)
class Weighing:
    """The inverse covariance of n entries in the order of time.

    Attributes
    ----------
    P : ndarray, shape (n, n)
    upper : ndarray, shape (n, n)
        P above its diagonal.
    first : ndarray of int, shape (onsets,)
        The first entry that each onset touches.
    onsets : ndarray, shape (onsets,)
        [s], begin of the block; the first stands for always.
    """

    P: Array
    upper: Array
    first: NDArray[np.int64]
    onsets: Array


@dataclass(frozen=True)
class Fit:
    """An effect at its best size and interval.

    Attributes
    ----------
    id : str
    size : float
    begin, end : float
        [s] since the start of the log; infinite where it acts from the first or to the last block.
    gain : float
        By how much it lowers half the weighted sum of squares.
    cost : float
        What of it the search over onsets and ends gives by chance.
    change : ndarray, shape (blocks, 4)
        Of the imbalances where it acts, zero elsewhere.
    spread : float
        Standard deviation of the size.
    """

    id: str
    size: float
    begin: float
    end: float
    gain: float
    cost: float
    change: Array
    spread: float

    @property
    def score(self) -> float:
        """The gain less its cost."""
        return self.gain - self.cost


def weighing(covariance: Array, time: Array, length: float) -> Weighing:
    """Return the weighing of entries whose blocks have these middles [s], shape (n,), not falling."""
    factor, _ = scipy.linalg.cho_factor(covariance, lower=True, check_finite=False)
    half, _ = scipy.linalg.lapack.dpotri(factor, lower=1)
    P = np.tril(half) + np.tril(half, -1).T
    middles = np.unique(time)
    return Weighing(P, np.triu(P, 1), np.searchsorted(time, middles), middles - 0.5 * length)


def gains_by_onset(weights: Weighing, pulled: Array, z: Array) -> Array:
    """Return the gains of changes from every onset to the end, shape (onsets, m).

    Parameters
    ----------
    pulled : ndarray, shape (n,)
        P r.
    z : ndarray, shape (n, m)
        The change of the entries by each of m sizes.
    """
    own = z * (np.diag(weights.P)[:, None] * z + 2.0 * (weights.upper @ z))
    total = np.cumsum((pulled[:, None] * z + 0.5 * own)[::-1], axis=0)[::-1]
    return np.asarray(-total[weights.first])


def gains_by_end(weights: Weighing, pulled: Array, z: Array) -> Array:
    """Return the gain of a change until the begin of every block, shape (onsets,); z is zero before its onset."""
    own = z * (np.diag(weights.P) * z + 2.0 * (z @ weights.upper))
    total = np.concatenate([[0.0], np.cumsum(pulled * z + 0.5 * own)])
    return np.asarray(-total[weights.first])


def best_interval(
    weights: Weighing, pulled: Array, direction: Array, every: int, least: int
) -> tuple[float, int, int, float]:
    """Return the largest gain of a direction on an interval that begins and ends inside, its ends, and how far it goes.

    Parameters
    ----------
    pulled, direction : ndarray, shape (n,)
        P r, and the change of the entries per unit of size.
    every : int
        Onsets between two ends that are tried.
    least : int
        Such steps that the interval must last, and must leave before and after it.

    Returns
    -------
    gain : float
        Zero where there is no such interval.
    begin, end : int
        Numbers of onsets.
    size : float
    """
    edges = np.arange(0, weights.onsets.size, every)
    first = weights.first[edges]
    rows = np.add.reduceat(weights.P * direction, first, axis=1) * direction[:, None]
    power = np.zeros((edges.size + 1, edges.size + 1))
    power[1:, 1:] = np.cumsum(np.cumsum(np.add.reduceat(rows, first, axis=0), axis=0), axis=1)
    slope = np.concatenate([[0.0], np.cumsum(np.add.reduceat(pulled * direction, first))])
    own = np.diag(power)
    inside = own[None] + own[:, None] - power - power.T
    i, j = np.triu_indices(edges.size + 1, least)
    fits = (i >= least) & (j <= edges.size - least) & (inside[i, j] > 1e-9 * max(float(own[-1]), 1e-300))
    if not fits.any():
        return 0.0, 0, 0, 0.0
    i, j = i[fits], j[fits]
    score = slope[j] - slope[i]
    gains = 0.5 * score**2 / inside[i, j]
    k = int(np.argmax(gains))
    return float(gains[k]), int(edges[i[k]]), int(edges[j[k]]), float(-score[k] / inside[i[k], j[k]])


def parabola(x: Array, g: Array) -> tuple[float, float, float]:
    """Return where a parabola through three points is highest, its value there, and its curvature, positive for a maximum.

    Where it has no maximum between the outer points, the best of the three is returned, and no curvature.
    """
    a, b = x[0] - x[1], x[2] - x[1]
    down_a, down_b = g[0] - g[1], g[2] - g[1]
    second = (down_b / b - down_a / a) / (b - a)
    slope = down_a / a - a * second
    at = -0.5 * slope / second if second < 0.0 else np.inf
    if not a <= at <= b:
        k = int(np.argmax(g))
        return float(x[k]), float(g[k]), 0.0
    return float(x[1] + at), float(g[1] + slope * at + second * at * at), float(-2.0 * second)


def best_size(sizes: Sequence[float], gains: Array) -> tuple[float, float]:
    """Return the size with the largest gain and that gain, from a parabola through the best and its neighbours."""
    k = int(np.argmax(gains))
    if k in (0, len(sizes) - 1):
        return float(sizes[k]), float(gains[k])
    x, g, _ = parabola(np.array(sizes[k - 1 : k + 2]), gains[k - 1 : k + 2])
    return x, g


def refined_size(
    gain_at: Callable[[float], float], sizes: Sequence[float], start: float, rounds: int = 3
) -> tuple[float, float, float]:
    """Return best size, its gain, and the size's standard deviation: parabolas through three ever closer points."""
    low, high = float(sizes[0]), float(sizes[-1])
    k = int(np.argmin(np.abs(np.array(sizes) - start)))
    step = 0.25 * float(sizes[min(k + 1, len(sizes) - 1)] - sizes[max(k - 1, 0)])
    x, best, curvature = start, gain_at(start), 0.0
    for _ in range(rounds):
        points = np.array([max(x - step, low), x, min(x + step, high)])
        if not points[0] < x < points[2]:
            points[1] = 0.5 * (points[0] + points[2])
        gains = np.array([best if point == x else gain_at(float(point)) for point in points])
        at, _, bend = parabola(points, gains)
        if bend:
            curvature = bend
            points, gains = np.append(points, at), np.append(gains, gain_at(at))
        x, best = float(points[np.argmax(gains)]), float(gains.max())
        step *= 0.35 if bend else 1.0
    return x, best, float(1.0 / np.sqrt(curvature)) if curvature > 0.0 else float("inf")
