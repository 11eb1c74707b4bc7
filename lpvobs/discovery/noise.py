"""How a residual is weighted: by its own scatter, or by what a healthy engine leaves.

There are two strategies, because two kinds of error dominate. Where an engine's constants are known, the noise of the sensors
dominates: it is new at every instant, and the residual itself shows its size in every cell of the map (`Scatter`). Where curves are
learned, the error of the model dominates: it lasts for seconds and minutes, and only a healthy log shows its size (`Remembered`).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.discovery.residual import Problem
from lpvobs.discovery.thresholds import (
    AT_ONCE,
    FIRST_NOISE,
    LEAST_IN_CELL,
    MOST_STRETCHED,
    OUTLIER,
    SHORT,
    SLOW,
    TRANSIENT,
)
from lpvobs.engines.healthy import TAIL
from lpvobs.maps.excitation import cell_numbers
from lpvobs.records import Array

Nodes = tuple[NDArray[np.int64], Array]


@dataclass(frozen=True)
class Scatter:
    """Noise that is new at every place."""

    root: Array  # (K, B, B) C with C^T C the inverse covariance, at all places
    used: NDArray[np.bool_]  # (K,)

    def whiten(self, values: Array) -> Array:
        """Return values of shape (..., B, K) in units of their noise."""
        flat = np.ascontiguousarray(values).reshape(-1, *values.shape[-2:])
        return np.asarray(_times(self.root, self.used, flat).reshape(values.shape))

    def only(self, used: NDArray[np.bool_]) -> "Scatter":
        """Return the same noise with other places that count."""
        return self if used is self.used else replace(self, used=used)

    def pointwise(self) -> "Scatter":
        """Return itself."""
        return self

    def ranges(self, direction: Array, whitened: Array, first: NDArray[np.int64]) -> Array:
        """Return differences of the power up to each stretch."""
        power = np.add.reduceat((whitened[0] ** 2 - whitened[1] ** 2).sum(0), first)
        total = np.concatenate([[0.0], np.cumsum(power)])
        return np.asarray(total[None] - total[:, None])

    def powers(self, direction: Array, whitened: Array, first: NDArray[np.int64], shares: Array) -> Array:
        """Return the power of a direction with each of m shares by stretch, (m, stretches), shape (m,)."""
        return shares**2 @ np.add.reduceat((whitened[0] ** 2 - whitened[1] ** 2).sum(0), first)

    def dual(self, whitened: Array) -> Array:
        """Return the product of whitened values with the transposed root."""
        return np.asarray(np.einsum("kab,...ak->...bk", self.root, whitened))

    @cached_property
    def precision(self) -> Array:
        """Inverse covariance of the balances at every place, zero where it does not count, shape (B, B, K)."""
        return np.asarray(np.einsum("kab,kac->bck", self.root, self.root) * self.used)


@dataclass(frozen=True)
class Remembered:
    """Noise that is correlated in time; m entries (place, balance) in the order of time."""

    order: NDArray[np.int64]  # (m,) place * B + balance
    covariance: Array  # (m, m)
    shape: tuple[int, int]  # B and K
    used: NDArray[np.bool_]  # (K,)

    @cached_property
    def _entries(self) -> tuple[NDArray[np.int64], Array]:
        """Entries that count, and the lower Cholesky factor of their covariance."""
        on = np.flatnonzero(self.used[self.order // self.shape[0]])
        covariance = self.covariance if on.size == self.order.size else self.covariance[np.ix_(on, on)]
        return self.order[on], scipy.linalg.cholesky(covariance, lower=True, check_finite=False)

    @cached_property
    def precision(self) -> Array:
        """Inverse covariance of the entries that count."""
        _, factor = self._entries
        half, _ = scipy.linalg.lapack.dpotri(factor, lower=1)
        return np.asarray(np.tril(half) + np.tril(half, -1).T)

    def whiten(self, values: Array) -> Array:
        """Return innovations of the first view: what an entry adds to all before it, in units of its noise."""
        return self._solved(values, transposed=0)

    def dual(self, whitened: Array) -> Array:
        """Return the transposed whitening: what turns whitened values into factors for a direction that is not whitened."""
        return self._solved(whitened, transposed=1)

    def _solved(self, values: Array, transposed: int) -> Array:
        """Return what the factor of the covariance, or its transpose, takes to the first view of values, shape (..., B, K)."""
        entries, factor = self._entries
        B, K = self.shape
        flat = values.reshape(-1, *values.shape[-3:])[:, 0] if values.ndim > 2 else values[None]
        along = flat.transpose(0, 2, 1).reshape(flat.shape[0], -1)[:, entries]
        new = scipy.linalg.solve_triangular(factor, along.T, lower=True, trans=transposed, check_finite=False)
        out = np.zeros((new.shape[1], K * B))
        out[:, entries] = new.T
        first = out.reshape(-1, K, B).transpose(0, 2, 1)
        if values.ndim == 2:
            return np.asarray(first[0])
        both = np.zeros((first.shape[0], *values.shape[-3:]))
        both[:, 0] = first
        return both.reshape(values.shape)

    def only(self, used: NDArray[np.bool_]) -> "Remembered":
        """Return the same noise with other places that count."""
        return self if used is self.used else replace(self, used=used)

    def pointwise(self) -> Scatter:
        """Return the noise of every entry alone; zero weight where a balance does not count."""
        B, K = self.shape
        root = np.zeros(K * B)
        root[self.order] = 1.0 / np.sqrt(np.diag(self.covariance))
        return Scatter(root.reshape(K, B)[:, :, None] * np.eye(B), self.used)

    def ranges(self, direction: Array, whitened: Array, first: NDArray[np.int64]) -> Array:
        """Return the quadratic form of the precision with a direction, summed over square parts of the matrix."""
        power = np.zeros((first.size + 1, first.size + 1))
        power[1:, 1:] = np.cumsum(np.cumsum(self._power(direction, first), axis=0), axis=1)
        own = np.diag(power)
        return np.asarray(own[None] + own[:, None] - 2.0 * power)

    def powers(self, direction: Array, whitened: Array, first: NDArray[np.int64], shares: Array) -> Array:
        """Return the power of a direction with each of m shares by stretch, (m, stretches), shape (m,)."""
        return np.asarray(np.einsum("ms,ms->m", shares @ self._power(direction, first), shares))

    def _power(self, direction: Array, first: NDArray[np.int64]) -> Array:
        """Return the products of a direction in any two stretches, shape (stretches, stretches)."""
        entries, _ = self._entries
        along = direction[0].T.ravel()[entries]
        begin = np.searchsorted(entries, first * self.shape[0])
        return _sums(_sums(self.precision * along, begin, 1) * along[:, None], begin, 0)


Noise = Scatter | Remembered  # what the residual of a problem is weighted by


def _sums(values: Array, begin: NDArray[np.int64], axis: int) -> Array:
    """Return sums from each begin to the next; an empty range has the sum zero."""
    size = values.shape[axis]
    total = np.add.reduceat(values, np.minimum(begin, size - 1), axis=axis)
    empty = np.diff(np.append(begin, size)) == 0
    total[(slice(None),) * axis + (empty,)] = 0.0
    return np.asarray(total)


def first_noise(problem: Problem) -> Noise:
    """Return the noise before any residual is known."""
    if problem.model.healthy is not None:
        return _remembered(problem, 1.0)
    return Scatter(np.tile(np.eye(len(problem.model.balances)) / FIRST_NOISE, (problem.K, 1, 1)), problem.used)


def noise_of(problem: Problem, nodes: Nodes, raw: Array) -> Noise:
    """Return the noise as the residual of a model at its optimum shows it, shape (B, K)."""
    healthy = problem.model.healthy
    if healthy is None:
        root = _own_scatter(problem, nodes, raw)
        if problem.bounded:
            z = np.einsum("kab,bk->ak", root, np.where(problem.shown, raw, 0.0))
            root /= beyond_usual(z).max(0)[:, None, None]
        return Scatter(root, problem.used)
    z = raw / healthy.scales(problem.transience)
    return _remembered(problem, np.clip(np.sqrt((TAIL + z**2) / (TAIL + 1.0)), 1.0, MOST_STRETCHED))


def beyond_usual(z: Array) -> Array:
    """Return the factor on the scale of residuals, in units of their noise, that are larger than noise alone would make them.

    It is one for all others: weights that depend on the noise bias the product of two views.
    """
    return np.maximum(np.abs(z) / OUTLIER, 1.0)


def _remembered(problem: Problem, stretch: Array | float) -> Remembered:
    """Return the noise of a healthy engine, its scale stretched where outliers are (Student's distribution), shape (B, K)."""
    model, healthy = problem.model, problem.model.healthy
    if healthy is None:
        raise ValueError("correlated noise needs the errors of a healthy engine")
    B, K = len(model.balances), problem.K
    order = np.flatnonzero(problem.shown.T.ravel())
    place, balance = np.divmod(order, B)
    scale = (healthy.scales(problem.transience) * stretch).T.ravel()[order]
    pairs, distance = np.ix_(place, place), np.abs(problem.clock[:, None] - problem.clock[None])
    memory = (1.0 - AT_ONCE) * np.exp(-distance / SHORT)
    np.fill_diagonal(memory, 1.0)
    covariance = healthy.together[np.ix_(balance, balance)] * np.outer(scale, scale) * memory[pairs]
    lasting = np.where(problem.of_log[:, None] == problem.of_log[None], np.exp(-distance / SLOW), 0.0)
    for each in range(B):
        one = np.flatnonzero(balance == each)
        covariance[np.ix_(one, one)] += healthy.slow[each] ** 2 * lasting[np.ix_(place[one], place[one])]
    if model.blur is not None:
        more = model.blur(model.constants, problem.signals, problem.blocks).T.ravel()[order]
        covariance[np.arange(order.size), np.arange(order.size)] += more**2
    return Remembered(order, covariance, (B, K), problem.used)


def _own_scatter(problem: Problem, nodes: Nodes, raw: Array) -> Array:
    """Return the root of the inverse covariance, shape (K, B, B): by cell of the map, times a spread by class of transience.

    A balance counts with the places where it is shown. Beside balances that are not, it stands alone. The correlation of two
    balances shrinks with the share of places that both are shown at: a few places may show any correlation.
    """
    shape = (problem.grid.speed.size - 1, problem.grid.fuel.size - 1)
    everywhere = cell_numbers(problem.grid, nodes[0])
    classes = problem.transience.astype(np.int64)
    used = problem.used
    cells, fast, raw, shown = everywhere[used], classes[used], raw[:, used], problem.shown[:, used].astype(float)
    B = raw.shape[0]
    spread = np.ones((len(TRANSIENT) + 1, B))
    silent = np.flatnonzero(~raw.any(axis=1))  # a balance that the logs never tell anything of
    visits = np.stack([np.bincount(cells, on, minlength=shape[0] * shape[1]) for on in shown], axis=1).astype(float)
    root = np.sqrt(_pool(visits, shape) + LEAST_IN_CELL)  # of the instants of a balance in a cell
    share = LEAST_IN_CELL / np.maximum(np.sqrt(np.outer(visits.sum(0), visits.sum(0))), 1.0)
    often = np.stack([np.bincount(fast, on, minlength=len(spread)) for on in shown], axis=1)
    for _ in range(3):
        x = raw / spread[fast].T
        sums = np.zeros((len(root), B, B))
        for a in range(B):
            for b in range(a + 1):
                sums[:, a, b] = sums[:, b, a] = np.bincount(cells, x[a] * x[b], minlength=len(root))
        noise = (_pool(sums, shape) + share * sums.sum(0)) / root[:, :, None] / root[:, None, :]
        noise[:, silent, silent] = 1.0
        y = raw / np.sqrt(np.einsum("cbb->cb", noise))[cells].T
        power = np.stack([np.bincount(fast, row**2, minlength=len(spread)) for row in y], axis=1)
        spread = np.sqrt(power / np.maximum(often, 1))
        spread = np.maximum.accumulate(np.maximum(spread, 1e-3), axis=0)
    roots = np.empty((everywhere.size, B, B))
    for some in np.unique(problem.shown, axis=1).T:
        here = (some == problem.shown.T).all(axis=1)
        alone = noise * np.outer(some, some) + np.diag(~some)
        roots[here] = np.linalg.inv(np.linalg.cholesky(alone))[everywhere[here]]
    return np.asarray(roots / spread[classes][:, None, :] / np.sqrt(problem.lasting).T[:, None, :])


def _pool(values: Array, shape: tuple[int, int]) -> Array:
    spread = values.reshape(*shape, *values.shape[1:])
    sigma = (1.0, 1.0, *[0.0] * (values.ndim - 1))
    return np.asarray(scipy.ndimage.gaussian_filter(spread, sigma, mode="constant", truncate=3.0).reshape(values.shape))


@njit(cache=True)
def _times(root, used, values):  # type: ignore[no-untyped-def]
    """Return root, lower triangular, times values at every place that is used, zero at others, shape (n, B, K)."""
    out = np.zeros_like(values)
    for k in np.flatnonzero(used):
        for i in range(values.shape[0]):
            for a in range(values.shape[1]):
                total = 0.0
                for b in range(a + 1):
                    total += root[k, a, b] * values[i, b, k]
                out[i, a, k] = total
    return out
