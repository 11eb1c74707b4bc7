"""How a residual is weighted: by its own scatter, or by what a healthy engine leaves.

There are two strategies, because two kinds of error dominate. Where an engine's constants are known, the noise of the sensors
dominates: it is new at every instant, and the residual itself shows its size in every cell of the map (`Scatter`). Where curves are
learned, the error of the model dominates: it lasts for seconds and minutes, and only a healthy log shows its size (`Remembered`).
"""

from collections.abc import Callable
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


@dataclass(frozen=True, eq=False)
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
        flat = np.ascontiguousarray(whitened).reshape(-1, *whitened.shape[-2:])
        return np.asarray(_times_transposed(self.root, flat).reshape(whitened.shape))

    @cached_property
    def precision(self) -> Array:
        """Inverse covariance of the balances at every place, zero where it does not count, shape (B, B, K)."""
        return np.asarray(np.einsum("kab,kac->bck", self.root, self.root) * self.used)


@dataclass(frozen=True)
class Remembered:
    """Noise that is correlated in time: y_b(k) = scale_b(k) (u_b(k) + w_b(k)) + v_b(k) + e_b(k) in balance b at place k.

    u decays with `SHORT`, and w is new at every place. Balances are correlated in both by `together`, which they share as
    1 - `AT_ONCE` to `AT_ONCE`. v decays with `SLOW` and begins anew with every log. e is new in every entry. u, v, w are the 3 B
    states x of a Kalman filter. Its innovations are the values times the inverse Cholesky factor of their whole covariance, in K
    steps.
    """

    clock: Array  # (K,) [s] rising
    of_log: NDArray[np.int64]  # (K,)
    shown: NDArray[np.bool_]  # (B, K)
    scale: Array  # (B, K)
    own: Array  # (B, K) variance of e
    together: Array  # (B, B) covariance of u + w at one place
    slow: Array  # (B,) standard deviation of v
    used: NDArray[np.bool_]  # (K,)

    @cached_property
    def _filter(self) -> tuple[NDArray[np.bool_], Array, Array, Array, Array]:
        """Entries that count, (B, K); decay of the state up to a place, (K, 3 B); scale; what `_gains` returns."""
        on = self.shown & self.used
        places = np.flatnonzero(on.any(0))
        passed, same = np.diff(self.clock[places]), np.diff(self.of_log[places]) == 0
        B = len(on)
        decay = np.zeros((on.shape[1], 3 * B))
        decay[places[1:], :B] = np.exp(-passed / SHORT)[:, None]
        decay[places[1:], B : 2 * B] = np.where(same, np.exp(-passed / SLOW), 0.0)[:, None]
        at_rest = scipy.linalg.block_diag(
            (1.0 - AT_ONCE) * self.together, np.diag(self.slow**2), AT_ONCE * self.together
        )
        return on, decay, self.scale, *_gains(on, decay, self.scale, self.own, at_rest)

    def whiten(self, values: Array) -> Array:
        """Return innovations of the first view: what an entry adds to all before it, in units of its noise."""
        return self._of_first_view(_innovations, values)

    def dual(self, whitened: Array) -> Array:
        """Return the transposed whitening: what turns whitened values into factors for a direction that is not whitened."""
        return self._of_first_view(_transposed, whitened)

    def _of_first_view(self, function: Callable[..., Array], values: Array) -> Array:
        """Return what a function makes of the first view of values, shape (..., B, K)."""
        views = values.reshape(-1, *values.shape[-3:]) if values.ndim > 2 else values[None, None]
        out = np.zeros_like(views)
        out[:, 0] = function(*self._filter, np.ascontiguousarray(views[:, 0]))
        return out.reshape(values.shape)

    def only(self, used: NDArray[np.bool_]) -> "Remembered":
        """Return the same noise with other places that count."""
        return self if used is self.used else replace(self, used=used)

    def pointwise(self) -> Scatter:
        """Return the noise of every entry alone; zero weight where a balance does not count."""
        variance = self.scale**2 * np.diag(self.together)[:, None] + self.slow[:, None] ** 2 + self.own
        return Scatter(np.where(self.shown, variance**-0.5, 0.0).T[:, :, None] * np.eye(len(self.shown)), self.used)

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
        stretch = np.searchsorted(first, np.arange(direction.shape[-1]), side="right") - 1
        alone = np.where(stretch == np.arange(first.size)[:, None], direction[0][:, None], 0.0).swapaxes(0, 1)
        white = self.whiten(alone[:, None]).reshape(first.size, -1)
        return np.asarray(white @ white.T)


Noise = Scatter | Remembered  # what the residual of a problem is weighted by


def first_noise(problem: Problem) -> Noise:
    """Return the noise before any residual is known."""
    if problem.model.healthy is not None:
        return _remembered(problem, 1.0)
    each = np.eye(len(problem.model.balances)) * problem.shown.T[:, :, None]
    return Scatter(each / FIRST_NOISE, problem.used)


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
    blur = 0.0 if model.blur is None else model.blur(model.constants, problem.signals, problem.blocks)
    return Remembered(
        clock=problem.clock,
        of_log=problem.of_log,
        shown=problem.shown,
        scale=healthy.scales(problem.transience) * stretch,
        own=np.broadcast_to(blur, problem.shown.shape) ** 2,
        together=healthy.together,
        slow=healthy.slow,
        used=problem.used,
    )


def usual_sizes(problem: Problem, nodes: Nodes, raw: Array) -> Array:
    """Return the standard deviation of every balance at every place, shape (B, K), as `_own_scatter` has it of each alone."""
    noise, spread, everywhere, classes = _by_class(problem, nodes, raw)
    return np.asarray((np.sqrt(np.einsum("cbb->cb", noise))[everywhere] * spread[classes]).T)


def _own_scatter(problem: Problem, nodes: Nodes, raw: Array) -> Array:
    """Return the root of the inverse covariance, shape (K, B, B): by cell of the map, times a spread by class of transience.

    A balance counts with the places where it is shown. Beside balances that are not, it stands alone. The correlation of two
    balances shrinks with the share of places that both are shown at: a few places may show any correlation.
    """
    noise, spread, everywhere, classes = _by_class(problem, nodes, raw)
    B = len(raw)
    roots = np.empty((everywhere.size, B, B))
    for some in np.unique(problem.shown, axis=1).T:
        here = (some == problem.shown.T).all(axis=1)
        alone = noise * np.outer(some, some) + np.diag(~some)
        roots[here] = (some[:, None] * np.linalg.inv(np.linalg.cholesky(alone)))[everywhere[here]]
    return np.asarray(roots / spread[classes][:, None, :] / np.sqrt(problem.lasting).T[:, None, :])


def _by_class(problem: Problem, nodes: Nodes, raw: Array) -> tuple[Array, Array, NDArray[np.int64], NDArray[np.int64]]:
    """Return covariances by cell, (cells, B, B), spreads by class, (classes, B), and cell and class of every place."""
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
    return noise, spread, everywhere, classes


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


@njit(cache=True)
def _times_transposed(root, values):  # type: ignore[no-untyped-def]
    """Return the transposed root times values, shape (n, B, K)."""
    out = np.zeros_like(values)
    for k in range(values.shape[2]):
        for i in range(values.shape[0]):
            for a in range(values.shape[1]):
                for b in range(a + 1):
                    out[i, b, k] += root[k, a, b] * values[i, a, k]
    return out


@njit(cache=True)
def _gains(on, decay, scale, own, at_rest):  # type: ignore[no-untyped-def]
    """Return the gains of a Kalman filter that takes one balance after the other, (K, B, 3 B), and 1 / deviation, (B, K)."""
    B, K = on.shape
    gain, root = np.zeros((K, B, 3 * B)), np.zeros((B, K))
    P = at_rest.copy()
    for k in range(K):
        if not on[:, k].any():
            continue
        P = at_rest + (P - at_rest) * np.outer(decay[k], decay[k])
        for b in range(B):
            if on[b, k]:
                together = scale[b, k] * (P[b] + P[2 * B + b]) + P[B + b]
                variance = scale[b, k] * (together[b] + together[2 * B + b]) + together[B + b] + own[b, k]
                gain[k, b] = together / variance
                P -= np.outer(gain[k, b], together)
                root[b, k] = 1.0 / np.sqrt(variance)
    return gain, root


@njit(cache=True)
def _innovations(on, decay, scale, gain, root, values):  # type: ignore[no-untyped-def]
    """Return the innovations of values, shape (n, B, K), in units of their deviation; zero where nothing counts."""
    B = len(on)
    places = np.flatnonzero(on.sum(axis=0))
    out = np.zeros_like(values)
    for i in range(len(values)):
        x = np.zeros(3 * B)
        for k in places:
            for s in range(3 * B):
                x[s] *= decay[k, s]
            for b in range(B):
                if on[b, k]:
                    e = values[i, b, k] - scale[b, k] * (x[b] + x[2 * B + b]) - x[B + b]
                    for s in range(3 * B):
                        x[s] += gain[k, b, s] * e
                    out[i, b, k] = e * root[b, k]
    return out


@njit(cache=True)
def _transposed(on, decay, scale, gain, root, values):  # type: ignore[no-untyped-def]
    """Return the transposed map of `_innovations`, which runs backwards, shape (n, B, K)."""
    B = len(on)
    places = np.flatnonzero(on.sum(axis=0))
    out = np.zeros_like(values)
    for i in range(len(values)):
        x = np.zeros(3 * B)
        for k in places[::-1]:
            for b in range(B - 1, -1, -1):
                if on[b, k]:
                    e = root[b, k] * values[i, b, k]
                    for s in range(3 * B):
                        e += gain[k, b, s] * x[s]
                    x[b] -= scale[b, k] * e
                    x[B + b] -= e
                    x[2 * B + b] -= scale[b, k] * e
                    out[i, b, k] = e
            for s in range(3 * B):
                x[s] *= decay[k, s]
    return out
