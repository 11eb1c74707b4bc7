"""The joint model of map, constants and effects, linear around where it stands, in units of its own noise.

Every quantity is kept as the mean and half the difference of two views with independent noise. Products are taken across the
views, which in these terms is mean times mean minus difference times difference: noise that a regressor shares with the residual
drops out of every sum, so that a regressor built from noisy signals is not attenuated and a clean log shows no lag.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.ndimage
from numba import njit
from numpy.typing import NDArray

from lpvobs.discovery.residual import HASTE, Problem
from lpvobs.engines.effects import Effect, Scene
from lpvobs.observer.balance_errors import cell_numbers
from lpvobs.records import Array

Nodes = tuple[NDArray[np.int64], Array]
LEAST_TIME = 5.0
"""Instants of the average cell that every cell is given."""


@dataclass(frozen=True)
class Term:
    """An effect with the size and the interval that it has in a model."""

    effect: Effect
    size: float
    begin: float = -np.inf
    end: float = np.inf

    def put(self, scene: Scene) -> Scene:
        """Return the scene with the effect accounted for."""
        return scene.between(self.effect.apply(scene, self.size), self.begin, self.end)


@dataclass(frozen=True)
class Linear:
    """A model at one point, and the directions in which it can move.

    n = p + q + terms unknowns; B balances; two views as mean and half difference.

    Attributes
    ----------
    problem : Problem
    terms : tuple of Term
    theta, beta : ndarray, shapes (p,), (q,)
    scene : Scene
    nodes : tuple of ndarrays, shape (K, 4)
    constants : named tuple
    pinned : ndarray of bool, shape (q,)
        Constants at the end of their tolerance that would leave it if they could.
    whitener : ndarray, shape (K, B, B)
        C with C^T C the inverse covariance of the residual, at all instants; what is whitened is zero where none is used.
    raw, residual : ndarray, shape (2, B, K)
        [kg/s], and whitened, there with what `bend_of` adds.
    by_constants : ndarray, shape (q, 2, B, K)
        [kg/s], derivatives of the residual by the constants; from a nearby point where the model has moved little since.
    columns : ndarray, shape (q + terms, 2, B, K)
        Whitened derivatives of the residual by constants and effects.
    mapped : ndarray, shape (B, K)
        Whitened derivative of the residual by a shift of the map, with opposite sign.
    normal : ndarray, shape (n, n)
        Products of all columns with each other, and priors.
    factor : ndarray, shape (n, n)
        Its lower Cholesky factor.
    gradient : ndarray, shape (n,)
        Of half the sum of squares with priors.
    pull : ndarray, shape (n,)
        Negative of the step to the optimum of this linear model.
    """

    problem: Problem
    terms: tuple[Term, ...]
    theta: Array
    beta: Array
    scene: Scene
    nodes: Nodes
    constants: object
    pinned: NDArray[np.bool_]
    whitener: Array
    raw: Array
    residual: Array
    by_constants: Array
    columns: Array
    mapped: Array
    normal: Array
    factor: Array
    gradient: Array
    pull: Array

    @property
    def p(self) -> int:
        """The number of map nodes."""
        return self.theta.size

    def pinned_wrongly(self) -> NDArray[np.bool_]:
        """Return which pinned constants would now rather go back into their tolerance, shape (q,)."""
        along = self.gradient[self.p : self.p + self.beta.size] * np.sign(self.beta)
        return np.asarray(self.pinned & (along > 0.0), dtype=bool)

    def whiten(self, values: Array) -> Array:
        """Return values of shape (2, B, K) in units of their noise, zero where they are kept back."""
        return np.asarray(whiten(self.whitener, self.problem.used, values))

    def project(self, products: Array) -> Array:
        """Return the step of map, constants and terms that answers a gradient, shape (n,)."""
        return np.asarray(scipy.linalg.cho_solve((self.factor, True), products, check_finite=False), dtype=float)

    def products(self, y: Array) -> Array:
        """Return the products of a whitened vector with every unknown's column, shape (n,)."""
        one = np.zeros(self.problem.K, dtype=np.int64)
        return np.asarray(_products(self, y, one, one[:1])[0])

    def products_by_block(self, y: Array) -> Array:
        """Return the same, block by block, shape (blocks, n)."""
        return _products(self, y, self.problem.block, self.problem.first)

    def by_block(self, a: Array, b: Array) -> Array:
        """Return the product across views of two whitened vectors in each block, shape (blocks,)."""
        return np.asarray(np.add.reduceat((a[0] * b[0] - a[1] * b[1]).sum(0), self.problem.first))

    def moved(self, y: Array, step: Array) -> Array:
        """Return a whitened residual after a step of all unknowns."""
        out = y - np.tensordot(step[self.p :], self.columns, 1)
        shift = np.einsum("km,km->k", self.nodes[1], step[: self.p][self.nodes[0]])
        out[0] += self.mapped * shift
        return np.asarray(out)


def scene_with(problem: Problem, terms: Sequence[Term], constants: object = None) -> Scene:
    """Return the scene with all effects accounted for, in the order of the catalogue, channels last."""
    order = {effect.id: i for i, effect in enumerate(problem.plant.catalogue)}
    scene = problem.scene if constants is None else replace(problem.scene, constants=constants)
    for term in sorted(terms, key=lambda term: order.get(term.effect.id, len(order))):
        scene = term.put(scene)
    return scene


def dot(a: Array, b: Array) -> float:
    """Return the product across views of two whitened vectors."""
    return float(np.vdot(a[0], b[0]) - np.vdot(a[1], b[1]))


def views(values: Array) -> Array:
    """Return mean and half difference, shape (2, B, K), of values at 2K columns."""
    K = values.shape[1] // 2
    return np.stack([0.5 * (values[:, :K] + values[:, K:]), 0.5 * (values[:, :K] - values[:, K:])])


def operating_nodes(problem: Problem, scene: Scene) -> Nodes:
    """Return node numbers and weights of the map along the instants."""
    fuel, speed = (views(scene[name][None])[0, 0] for name in (problem.plant.fuel, problem.plant.speed))
    return problem.grid.regressors(fuel, speed)


def residual_of(problem: Problem, scene: Scene, constants: object, theta: Array, nodes: Nodes) -> Array:
    """Return what is left of every balance, shape (2, B, K) [kg/s]."""
    left = views(problem.plant.imbalances(constants, scene.value, scene.rate, scene.lacks))
    left[0] -= problem.plant.mapped[:, None] * map_along(theta, nodes)
    return left


def bend_of(problem: Problem, scene: Scene, constants: object, each: Array) -> Array:
    """Return the balances of the mean of both views less the mean of their balances `each`, shape (B, K) [kg/s].

    A balance that bends moves with the noise of its signals, and the mean of the views has half the noise of either. (Near its
    stall the compressor bends so much that the noise of p_im was worth ten pascals of offset; so it is worth one.) Twice
    as much would take out all that a parabola bends, but where a root ends, it overshoots. Residuals have it and no regressor: the
    product of two would not be one across views any more.
    """
    imbalances, K = problem.plant.imbalances, problem.K
    middle = (0.5 * (x[:, :K] + x[:, K:]) for x in (scene.value, scene.rate, scene.lacks))
    return np.asarray(imbalances(constants, *middle) - 0.5 * (each[:, :K] + each[:, K:]))


def map_along(theta: Array, nodes: Nodes) -> Array:
    """Return the map's value at every instant, shape (K,) [kg/s]."""
    return np.asarray(np.einsum("km,km->k", nodes[1], theta[nodes[0]]))


def residual_with(linear: Linear, terms: Sequence[Term]) -> Array:
    """Return the whitened residual with other terms, map and constants as they are, shape (2, B, K)."""
    problem, scene = linear.problem, scene_with(linear.problem, terms, linear.constants)
    nodes = operating_nodes(problem, scene)
    return linear.whiten(residual_of(problem, scene, linear.constants, linear.theta, nodes))


def covariance_root(problem: Problem, nodes: Nodes, raw: Array) -> Array:
    """Return the whitener, shape (K, B, B): covariance per cell of the map, spread per class of haste."""
    shape = (problem.grid.speed.size - 1, problem.grid.fuel.size - 1)
    everywhere = cell_numbers(problem.grid, nodes[0])
    cells, haste, raw = everywhere[problem.used], problem.haste[problem.used], raw[:, problem.used]
    B = raw.shape[0]
    spread = np.ones((len(HASTE) + 1, B))
    time = _pool(np.bincount(cells, minlength=shape[0] * shape[1]).astype(float), shape) + LEAST_TIME
    for _ in range(3):
        x = raw / spread[haste].T
        sums = np.zeros((time.size, B, B))
        for a in range(B):
            for b in range(a + 1):
                sums[:, a, b] = sums[:, b, a] = np.bincount(cells, x[a] * x[b], minlength=time.size)
        noise = (_pool(sums, shape) + LEAST_TIME * sums.sum(0) / cells.size) / time[:, None, None]
        y = raw / np.sqrt(np.einsum("cbb->cb", noise))[cells].T
        power = np.stack([np.bincount(haste, row**2, minlength=len(spread)) for row in y], axis=1)
        spread = np.sqrt(power / np.maximum(np.bincount(haste, minlength=len(spread)), 1)[:, None])
        spread = np.maximum.accumulate(np.maximum(spread, 1e-3), axis=0)
    roots = np.linalg.inv(np.linalg.cholesky(noise))
    return np.asarray(roots[everywhere] / spread[problem.haste][:, None, :])


def _pool(values: Array, shape: tuple[int, int]) -> Array:
    spread = values.reshape(*shape, *values.shape[1:])
    sigma = (1.0, 1.0, *[0.0] * (values.ndim - 1))
    return np.asarray(scipy.ndimage.gaussian_filter(spread, sigma, mode="constant", truncate=3.0).reshape(values.shape))


def _products(linear: Linear, y: Array, block: NDArray[np.int64], first: NDArray[np.int64]) -> Array:
    on_map = np.zeros((first.size, linear.p))
    scatter(on_map, block, *linear.nodes, -(linear.mapped * y[0]).sum(0))
    if first.size == 1:
        flat = linear.columns.reshape(linear.columns.shape[0], -1)
        dense = (flat @ np.concatenate([y[0].ravel(), -y[1].ravel()]))[None]
    else:
        each = np.einsum("ibk,bk->ik", linear.columns[:, 0], y[0]) - np.einsum("ibk,bk->ik", linear.columns[:, 1], y[1])
        dense = np.add.reduceat(each, first, axis=1).T
    return np.hstack([on_map, dense])


@njit(cache=True)
def whiten(root, used, values):  # type: ignore[no-untyped-def]
    """Return root, lower triangular, times values at every instant that is used, zero at others, shape (n, B, K)."""
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
def scatter(out, block, nodes, weights, values):  # type: ignore[no-untyped-def]
    """Add values to the nodes of their cells, block by block."""
    for k in range(values.size):
        for m in range(4):
            out[block[k], nodes[k, m]] += weights[k, m] * values[k]


@njit(cache=True)
def map_normal(p, nodes, weights, information):  # type: ignore[no-untyped-def]
    """Return the normal matrix of the map, shape (p, p)."""
    H = np.zeros((p, p))
    for k in range(information.size):
        for a in range(4):
            share = information[k] * weights[k, a]
            if share != 0.0:
                for b in range(4):
                    H[nodes[k, a], nodes[k, b]] += share * weights[k, b]
    return H
