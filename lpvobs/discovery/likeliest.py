"""How far the bells of a healthy engine's function reach, and how large its errors are: what makes its drives likeliest.

Means over some seconds of what a balance leaves are a Gaussian process: fast errors, the function, which is the same on all drives,
errors that last for minutes, and what differs from day to day. That is a level and a function of shorter bells: on one day an
engine breathes otherwise at idle, on another at full load.

The lengths are sought with the function at the mean of the channels, where it has all bells. What that misses within some seconds
would count as fast error: a turbine's function changes in them by many times its noise. So the variances are sought anew with the
mean of the function itself, by the bells that stand for it.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import thresholds
from lpvobs.discovery.bells import Bells, bells_of, shorter
from lpvobs.discovery.healthy_drive import minutes_of
from lpvobs.discovery.residual import Problem
from lpvobs.records import Array

_SLOW = float(np.log(thresholds.SLOW_SHARE))
START = np.array([1.0, 0.0, _SLOW, _SLOW])
"""Logarithms of the variances of the fast error, the function, and the slow ones, before any data."""
LEAST_PIECES = 10  # pieces below which nothing is learned of a balance
_BOUNDS = ((0.0, 6.0), (-9.0, 12.0), (-9.0, 4.0), (-9.0, 4.0))  # of the logarithms of the four variances


class Likeliest(NamedTuple):
    """What makes the drives likeliest, of a balance along K places."""

    lengths: Array  # (c,) of the bells along each channel
    variances: Array  # (4,) of the fast error, the function, what differs from day to day, and what lasts for minutes
    function: Array  # (K,) what the balance leaves on all drives, and on that day


def at_first(c: int, K: int) -> Likeliest:
    """Return what is known before any data: c channels tell the same, and there is no function."""
    return Likeliest(usual_lengths(c), np.exp(START), np.zeros(K))


def usual_lengths(c: int) -> Array:
    """Return the lengths of bells before any data, (c,), in standard deviations of c channels that all tell the same."""
    return np.full(c, np.sqrt(c))


def pieces(problem: Problem, shown: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return where a new stretch of `PIECE` begins among the places where a balance counts."""
    return np.flatnonzero(np.diff((problem.clock[shown] // thresholds.PIECE).astype(np.int64), prepend=-1))


@dataclass(frozen=True, eq=False)
class _Means:
    """P means over `PIECE` where a balance counts, each instant by its weight; variances are in usual scales squared."""

    problem: Problem
    shown: NDArray[np.bool_]
    first: NDArray[np.int64]
    weight: Array
    usual: float

    def of(self, values: Array) -> Array:
        """Return the means of K rows, shape (P, ...)."""
        rows = values[self.shown].T * self.weight
        return np.asarray((np.add.reduceat(rows, self.first, axis=-1) / np.add.reduceat(self.weight, self.first)).T)

    def errors(self) -> tuple[Array, Array, Array]:
        """Return the covariances, (P, P), of noise, of a level that each day has, and of what lasts for minutes."""
        noise = np.diag(1.0 / (np.add.reduceat(self.weight, self.first) * self.usual**2))
        day, minutes = self.of(self.days), self.of(minutes_of(self.problem))
        return noise, day @ day.T, minutes @ minutes.T

    @property
    def days(self) -> Array:
        """One where a place is of a log, (K, logs)."""
        return np.asarray(self.problem.of_log[:, None] == np.arange(self.problem.of_log[-1] + 1), dtype=float)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of the logarithms of the four variances; one drive does not tell how much days differ."""
        return [*_BOUNDS[:2], _BOUNDS[2] if np.ptp(self.problem.of_log) else (_SLOW, _SLOW), _BOUNDS[3]]


def _means(problem: Problem, shown: NDArray[np.bool_], scale: Array) -> _Means:
    return _Means(problem, shown, pieces(problem, shown), scale[shown] ** -2.0, float(np.median(scale[shown])))


def likeliest_lengths(
    problem: Problem, inputs: Array, shown: NDArray[np.bool_], left: Array, scale: Array, start: Likeliest
) -> Likeliest:
    """Return lengths and variances of largest likelihood, with the function at the mean of its inputs, from those of a start.

    `inputs` are c channels and r rates, shape (K, c + r), in which the lengths are. `left` and `scale` have K rows, `shown` says
    where the balance counts. The function stays that of the start.
    """
    c = start.lengths.size
    if pieces(problem, shown).size < LEAST_PIECES:
        return start
    means = _means(problem, shown, scale)
    x, (noise, day, minutes) = means.of(inputs), means.errors()
    parts, usually = (noise, x[:, c:] @ x[:, c:].T, day, minutes), -np.log(usual_lengths(c))
    shortest, longest = np.log(thresholds.BELL_LENGTHS)
    best = _minimum(
        unlikely_lengths, np.append(np.log(start.variances), -np.log(start.lengths)),
        (means.of(left / means.usual), x[:, :c], parts), [*means.bounds, *zip(usually - longest, usually - shortest, strict=True)],
    )  # fmt: skip
    return Likeliest(np.exp(-best[4:]), np.exp(best[:4]), start.function)


def likeliest(
    problem: Problem,
    along: Array,
    bells: Bells,
    shown: NDArray[np.bool_],
    left: Array,
    scale: Array,
    start: Likeliest,
) -> Likeliest:
    """Return variances of largest likelihood, and the function for them at the places, with the mean of bells and lines.

    `along` are the bells and lines at the places, shape (K, f); the rest is as above.
    """
    if pieces(problem, shown).size < LEAST_PIECES:
        return start._replace(function=np.zeros(shown.size))
    means, root = _means(problem, shown, scale), bells.root_with_lines(along.shape[1])
    features, of_day = means.of(along) @ root.T, bells.of_day(along)
    y, same, differs, (noise, day, minutes) = means.of(left / means.usual), means.days, means.of(of_day), means.errors()
    parts = noise, features @ features.T, day * (differs @ differs.T), minutes
    z = _minimum(unlikely, np.log(start.variances), (y, parts), means.bounds)
    variances = np.exp(z)
    alpha = scipy.linalg.cho_solve((_factor(z, parts), True), y)
    by_day = (means.of(same).T * alpha) @ differs
    function = variances[1] * along @ (root.T @ (features.T @ alpha)) + variances[2] * ((same @ by_day) * of_day).sum(1)
    return Likeliest(start.lengths, variances, means.usual * function)


def _minimum(of: Any, start: Array, given: tuple[Any, ...], bounds: list[tuple[float, float]]) -> Array:
    best = scipy.optimize.minimize(of, start, given, jac=True, method="L-BFGS-B", tol=1e-4, bounds=bounds)
    return np.asarray(best.x)


def unlikely_lengths(z: Array, y: Array, x: Array, parts: tuple[Array, ...]) -> tuple[float, Array]:
    """Return the negative logarithm of the likelihood of P means y, (P,), and its derivatives by z, (4 + c,).

    z are the logarithms of four variances, and of the inverse lengths along c channels x, (P, c). `parts` are the covariances,
    (P, P), of unit variance, of noise, lines, and the errors of a day and of minutes.
    """
    noise, lines, day, minutes = parts
    bells = bells_of(x, x, np.exp(-z[4:]))
    of_days = day * shorter(bells)
    value, by_variance, by_covariance = _unlikely(z[:4], y, (noise, bells + lines, day + of_days, minutes))
    steep, by_bells = np.exp(2.0 * z[4:]), np.exp(z[1]) * bells + thresholds.SHARPER * np.exp(z[2]) * of_days
    by_bells *= by_covariance
    by_length = steep * ((x * (by_bells @ x)).sum(0) - by_bells.sum(1) @ x**2)
    # before any data most channels tell as much as the others, a few nothing (Cauchy)
    other = (z[4:] + np.log(usual_lengths(x.shape[1]))) / thresholds.LENGTH_SPREAD
    by_length += 2.0 * other / (1.0 + other**2) / thresholds.LENGTH_SPREAD
    return value + float(np.log1p(other**2).sum()), np.append(by_variance, by_length)


def unlikely(z: Array, y: Array, parts: tuple[Array, ...]) -> tuple[float, Array]:
    """Return the same of four variances alone, and its derivatives by their logarithms z, (4,).

    `parts` are the covariances of noise, the function, and the errors of a day and of minutes.
    """
    return _unlikely(z, y, parts)[:2]


def _unlikely(z: Array, y: Array, parts: tuple[Array, ...]) -> tuple[float, Array, Array]:
    """Return the value, its derivatives by the logarithms of the variances, and by the covariance: tr(D dC) / 2 for each dC."""
    factor = _factor(z, parts)
    below = scipy.linalg.lapack.dpotri(factor, lower=True)[0]
    inverse = np.tril(below) + np.tril(below, -1).T
    alpha = inverse @ y
    by_covariance = inverse - np.outer(alpha, alpha)
    away = (z[1:] - _SLOW) / thresholds.SLOW_SPREAD
    by_variance = 0.5 * np.exp(z) * [np.vdot(by_covariance, part) for part in parts]
    by_variance[1:] += away / thresholds.SLOW_SPREAD
    return float(0.5 * (y @ alpha + away @ away) + np.log(np.diag(factor)).sum()), by_variance, by_covariance


def _factor(z: Array, parts: tuple[Array, ...]) -> Array:
    """Return the lower factor of the covariance of means, (P, P)."""
    return np.asarray(scipy.linalg.cholesky(np.tensordot(np.exp(z), parts, 1), lower=True))
