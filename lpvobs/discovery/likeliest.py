"""How far the bells of a healthy engine's function reach, and how large its errors are: what makes its drives likeliest.

Both see means over some seconds of what a balance leaves: cov = fast error + function + errors that last all day, and for minutes.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import thresholds
from lpvobs.discovery.healthy_drive import logs_of, minutes_of
from lpvobs.discovery.residual import Problem
from lpvobs.records import Array

_SLOW = float(np.log(thresholds.SLOW_SHARE))
# logarithms of the variances of the fast error, the function, and the slow ones
START = np.array([1.0, 0.0, _SLOW, _SLOW])
LEAST_PIECES = 10  # pieces below which nothing is learned of a balance
_BOUNDS = ((0.0, 6.0), (-9.0, 12.0), (-9.0, 4.0), (-9.0, 4.0))  # of the logarithms of the four variances


class _Means(NamedTuple):
    """The places where a balance counts, as P means over `PIECE`."""

    of: "scipy.sparse.csr_array"  # (P, K) what takes the means of values along the places; a search does not load it
    total: Array  # (P,) weight of each
    usual: float  # scale of the residual


def pieces(problem: Problem, shown: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return where a new stretch of `PIECE` begins among the places where a balance counts."""
    return np.flatnonzero(np.diff((problem.clock[shown] // thresholds.PIECE).astype(np.int64), prepend=-1))


def usual_lengths(c: int) -> Array:
    """Return the lengths of bells before any data, (c,), in standard deviations of c channels that all tell the same."""
    return np.full(c, np.sqrt(c))


def likeliest_lengths(
    problem: Problem, channels: Array, rates: Array, shown: NDArray[np.bool_], left: Array, scale: Array, start: Array
) -> tuple[Array, Array]:
    """Return the length of a balance's bells along every channel, (c,), and the logarithms of the variances beside them, (4,).

    The lengths are in the units of `channels`, where the balance counts. `channels` have shape (K, c), `rates` (K, r), `left` and
    `scale` have K rows. `start` are the variances that `likeliest` returns. The covariance is that of a Gaussian process with a
    length of its own for every channel, at the means of the channels: what is fast within `PIECE` seems to be noise.
    """
    c = channels.shape[1]
    means = _means(problem, shown, scale)
    if means is None:
        return usual_lengths(c), start
    y, x, lines, t, log = (
        means.of @ z for z in (left / means.usual, channels, rates, problem.clock, problem.of_log.astype(float))
    )
    day = (np.abs(log[:, None] - log) < 0.5).astype(float)
    minutes = day * np.exp(-np.abs(t[:, None] - t) / thresholds.MEMORY)
    noise, usual = np.diag(1.0 / (means.total * means.usual**2)), -np.log(usual_lengths(c))
    shortest, longest = np.log(thresholds.BELL_LENGTHS)
    best = scipy.optimize.minimize(
        unlikely_lengths, np.append(start, usual), (y, x, (noise, lines @ lines.T, day, minutes)), jac=True, method="L-BFGS-B",
        bounds=[*_BOUNDS, *zip(usual - longest, usual - shortest, strict=True)], tol=1e-4,
    )  # fmt: skip
    return np.exp(-best.x[4:]), best.x[:4]


def unlikely_lengths(z: Array, y: Array, x: Array, parts: tuple[Array, ...]) -> tuple[float, Array]:
    """Return the negative logarithm of the likelihood of P means y, (P,), and its derivatives by z, (4 + c,).

    z are the logarithms of four variances, and of the inverse lengths along c channels x, (P, c). `parts` are the covariances,
    (P, P), of unit variance, of noise, lines, and the errors of a day and of minutes.
    """
    variance, steep = np.exp(z[:4]), np.exp(2.0 * z[4:])
    scaled = x * np.sqrt(steep)
    distance = (scaled**2).sum(1)[:, None] + (scaled**2).sum(1) - 2.0 * scaled @ scaled.T
    bells = np.exp(-0.5 * np.maximum(distance, 0.0))
    noise, lines, *slow = parts
    parts = (noise, bells + lines, *slow)
    factor = scipy.linalg.cholesky(np.tensordot(variance, parts, 1), lower=True)
    below = scipy.linalg.lapack.dpotri(factor, lower=True)[0]
    inverse = np.tril(below) + np.tril(below, -1).T
    alpha = inverse @ y
    # the derivative of the likelihood by the covariance C is tr((C^-1 - alpha alpha') dC) / 2, with alpha = C^-1 y
    by_covariance = inverse - np.outer(alpha, alpha)
    by_bells = variance[1] * by_covariance * bells
    by_length = steep * ((x * (by_bells @ x)).sum(0) - by_bells.sum(1) @ x**2)
    by_variance = 0.5 * variance * [(by_covariance * part).sum() for part in parts]
    # before any data: the variances as in `likeliest`; most channels tell as much as the others, a few nothing (Cauchy)
    away = (z[1:4] - _SLOW) / thresholds.SLOW_SPREAD
    other = (z[4:] + np.log(usual_lengths(x.shape[1]))) / thresholds.LENGTH_SPREAD
    by_variance[1:] += away / thresholds.SLOW_SPREAD
    by_length += 2.0 * other / (1.0 + other**2) / thresholds.LENGTH_SPREAD
    own = 0.5 * (y @ alpha + away @ away) + np.log(np.diag(factor)).sum() + np.log1p(other**2).sum()
    return float(own), np.append(by_variance, by_length)


def likeliest(
    problem: Problem,
    along: Array,
    root: Array,
    shown: NDArray[np.bool_],
    left: Array,
    scale: Array,
    start: Array = START,
) -> tuple[Array, Array]:
    """Return the logarithms of the variances of largest likelihood, and the weights of the function, (m,), of a balance.

    The variances are those of the fast error, the function, and the slow ones, where the balance counts. `along`, bells and lines,
    `left` and `scale` have K rows, one a place; `root`, (m, m), makes independent features of bells and lines.
    """
    means, m = _means(problem, shown, scale), along.shape[1]
    if means is None:
        return start, np.zeros(m)
    slow, total = [means.of @ each for each in (logs_of(problem), minutes_of(problem))], means.total
    y, columns = means.of @ left, means.usual * np.hstack([(means.of @ along) @ root.T, *slow])
    of = np.repeat([0, 1, 2], [m, *(each.shape[1] for each in slow)])
    gram, seen, alone = columns.T @ (total[:, None] * columns), columns.T @ (total * y), float(y @ (total * y))

    def posterior(x: Array) -> tuple[Array, Array, Array]:
        # cov(y) = e^x_0 / total + M S^2 M', where S has e^(x_i / 2) for the columns of kind i. By Woodbury, in as many
        # dimensions as there are columns: B = 1 + e^-x_0 S M' total M S, and B^-1 is the covariance of their sizes.
        S = np.exp(0.5 * x[1:])[of]
        factor = scipy.linalg.cholesky(np.eye(of.size) + np.exp(-x[0]) * np.outer(S, S) * gram, lower=True)
        return S, factor, np.exp(-x[0]) * scipy.linalg.cho_solve((factor, True), S * seen)

    def unlikely(x: Array) -> tuple[float, Array]:
        S, factor, sizes = posterior(x)
        known = 1.0 - (scipy.linalg.solve_triangular(factor, np.eye(of.size), lower=True) ** 2).sum(0)
        misfit = np.exp(-x[0]) * float(alone - sizes @ (S * seen))
        away = (x[1:] - _SLOW) / thresholds.SLOW_SPREAD
        own = misfit + y.size * x[0] - np.log(total).sum() + 2.0 * np.log(np.diag(factor)).sum() + away @ away
        fast = y.size - known.sum() - misfit + sizes @ sizes
        others = np.bincount(of, known - sizes**2, minlength=3) + 2.0 * away / thresholds.SLOW_SPREAD
        return 0.5 * float(own), 0.5 * np.array([fast, *others])

    best = scipy.optimize.minimize(unlikely, start, jac=True, method="L-BFGS-B", bounds=_BOUNDS)
    S, _, sizes = posterior(best.x)
    return best.x, means.usual * root.T @ (S * sizes)[:m]


def _means(problem: Problem, shown: NDArray[np.bool_], scale: Array) -> _Means | None:
    """Return the means where a balance counts, shape (K,); None where there are too few."""
    first = pieces(problem, shown)
    if first.size < LEAST_PIECES:
        return None
    weight = scale[shown] ** -2.0
    total = np.add.reduceat(weight, first)
    share = weight / np.repeat(total, np.diff(first, append=weight.size))
    mean = scipy.sparse.csr_array(
        (share, np.flatnonzero(shown), np.append(first, share.size)), (first.size, shown.size)
    )
    return _Means(mean, total, float(np.median(scale[shown])))
