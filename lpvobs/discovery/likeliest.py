"""How far the bells of a healthy engine's function reach, and how large its errors are: what makes its drives likeliest.

Means over some seconds of what a balance leaves are a Gaussian process: fast errors, the function, which is the same on all drives,
errors that last for minutes, and what differs from day to day. That is a level and a function of shorter bells: on one day an
engine breathes otherwise at idle, on another at full load.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import thresholds
from lpvobs.discovery.bells import bells_of, shorter
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


def likeliest(
    problem: Problem,
    inputs: Array,
    shown: NDArray[np.bool_],
    left: Array,
    scale: Array,
    start: Likeliest,
    other_lengths: bool = True,
) -> Likeliest:
    """Return lengths and variances of largest likelihood, and the function at the places, from those of a start.

    `inputs` are c channels and r rates, shape (K, c + r), in which the lengths are. `left` and `scale` have K rows, `shown` says
    where the balance counts. The variances are in usual scales squared. Without `other_lengths` those of the start stay. The
    process is that at the means of the channels: what is fast within `PIECE` seems to be noise.
    """
    first, c = pieces(problem, shown), start.lengths.size
    if first.size < LEAST_PIECES:
        return start._replace(function=np.zeros(shown.size))
    weight, usual = scale[shown] ** -2.0, float(np.median(scale[shown]))
    total = np.add.reduceat(weight, first)
    y, x, minutes, log = (
        (np.add.reduceat(weight * values[shown].T, first, axis=-1) / total).T
        for values in (left / usual, inputs, minutes_of(problem), problem.of_log.astype(float))
    )
    x, rates, day = x[:, :c], x[:, c:], _same(log, log)
    parts = np.diag(1.0 / (total * usual**2)), rates @ rates.T, day, minutes @ minutes.T
    before, usually = -np.log(start.lengths), -np.log(usual_lengths(c))
    shortest, longest = np.log(thresholds.BELL_LENGTHS)
    bounds = np.array([usually - longest, usually - shortest] if other_lengths else [before, before]).T
    of_days = _BOUNDS[2] if np.ptp(log) > 0.0 else (_SLOW, _SLOW)  # one drive does not tell how much days differ
    best = scipy.optimize.minimize(
        unlikely, np.append(np.log(start.variances), before), (y, x, parts), jac=True, method="L-BFGS-B", tol=1e-4,
        bounds=[*_BOUNDS[:2], of_days, _BOUNDS[3], *bounds],
    )  # fmt: skip
    variances, lengths = np.exp(best.x[:4]), np.exp(-best.x[4:])
    alpha = scipy.linalg.cho_solve((_covariance(best.x, x, parts)[0], True), y)
    function = variances[1] * inputs[:, c:] @ (rates.T @ alpha)
    for on in np.array_split(np.arange(shown.size), first.size // LEAST_PIECES):  # not all at once: an hour has 100 MB
        bells, same = bells_of(inputs[on, :c], x, lengths), _same(problem.of_log[on].astype(float), log)
        function[on] += (variances[1] * bells + variances[2] * same * (1.0 + shorter(bells))) @ alpha
    return Likeliest(lengths, variances, usual * function)


def unlikely(z: Array, y: Array, x: Array, parts: tuple[Array, ...]) -> tuple[float, Array]:
    """Return the negative logarithm of the likelihood of P means y, (P,), and its derivatives by z, (4 + c,).

    z are the logarithms of four variances, and of the inverse lengths along c channels x, (P, c). `parts` are the covariances,
    (P, P), of unit variance, of noise, lines, and the errors of a day and of minutes.
    """
    factor, bells, of_days, every = _covariance(z, x, parts)
    variance, steep = np.exp(z[:4]), np.exp(2.0 * z[4:])
    below = scipy.linalg.lapack.dpotri(factor, lower=True)[0]
    inverse = np.tril(below) + np.tril(below, -1).T
    alpha = inverse @ y
    # the derivative of the likelihood by the covariance C is tr((C^-1 - alpha alpha') dC) / 2, with alpha = C^-1 y
    by_covariance = inverse - np.outer(alpha, alpha)
    by_bells = (variance[1] * bells + thresholds.SHARPER * variance[2] * of_days) * by_covariance
    by_length = steep * ((x * (by_bells @ x)).sum(0) - by_bells.sum(1) @ x**2)
    by_variance = 0.5 * variance * [(by_covariance * part).sum() for part in every]
    # before any data most channels tell as much as the others, a few nothing (Cauchy)
    away = (z[1:4] - _SLOW) / thresholds.SLOW_SPREAD
    other = (z[4:] + np.log(usual_lengths(x.shape[1]))) / thresholds.LENGTH_SPREAD
    by_variance[1:] += away / thresholds.SLOW_SPREAD
    by_length += 2.0 * other / (1.0 + other**2) / thresholds.LENGTH_SPREAD
    own = 0.5 * (y @ alpha + away @ away) + np.log(np.diag(factor)).sum() + np.log1p(other**2).sum()
    return float(own), np.append(by_variance, by_length)


def _covariance(z: Array, x: Array, parts: tuple[Array, ...]) -> tuple[Array, Array, Array, tuple[Array, ...]]:
    """Return the lower factor of the covariance, the bells, the shorter ones of the same day, and its four parts, all (P, P)."""
    noise, lines, day, minutes = parts
    bells = bells_of(x, x, np.exp(-z[4:]))
    of_days = day * shorter(bells)
    every = noise, bells + lines, day + of_days, minutes
    return scipy.linalg.cholesky(np.tensordot(np.exp(z[:4]), every, 1), lower=True), bells, of_days, every


def _same(log: Array, other: Array) -> Array:
    """Return one where a log is another one, (K, P)."""
    return np.asarray(np.abs(log[:, None] - other) < 0.5, dtype=float)
