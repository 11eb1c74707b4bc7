"""The joint model of map, unknowns and effects, linearised at one point, in units of its noise.

Every quantity is kept as the mean and half the difference of two views with independent noise. Products are taken across the
views: mean times mean minus difference times difference. The noise that a regressor shares with the residual drops out of such a
sum. A regressor built from noisy signals is therefore not attenuated, and a clean log shows no lag.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.discovery.imbalances import Nodes, Scene, map_along, operating_nodes, residual_of, scenes_with
from lpvobs.discovery.noise import Noise
from lpvobs.discovery.residual import Problem, Term
from lpvobs.records import Array


@dataclass(frozen=True, eq=False)
class Linear:
    """A model at one point, and its derivatives there.

    n = p + q + terms unknowns; B balances; two views as mean and half difference.
    """

    problem: Problem
    terms: tuple[Term, ...]
    theta: Array  # (p,)
    beta: Array  # (q,)
    scenes: tuple[Scene, ...]
    nodes: Nodes  # (K, 4)
    # (q + terms,) constants and sizes at an end of their range that would leave it if they could
    pinned: NDArray[np.bool_]
    noise: Noise  # whitened values are zero at places that are not used
    raw: Array  # (2, B, K) in the model's unit
    from_signals: Array  # (2, B, K) what the signals make of it
    residual: Array  # (2, B, K) whitened, with what `curvature_bias` adds
    # (u, 2, B, K) derivatives of the residual by the u unknowns that are no errors of a healthy engine, perhaps taken nearby
    by_unknowns: Array
    columns: Array  # (u + terms, 2, B, K) whitened derivatives of the residual by these and by effects
    mapped: Array  # (B, K) whitened derivative of the residual by a shift of the map, with opposite sign
    # (p, B, K) The same for every node. It is needed where noise that is correlated in time spreads a node over all
    # places; None where a place sees the nodes of its cell alone.
    dense: Array | None
    normal: Array  # (n, n) products of all columns with each other, with priors
    factor: Array  # (n, n) its lower Cholesky factor
    gradient: Array  # (n,) of half the sum of squares with priors
    newton_step: Array  # (n,) what the unknowns exceed the optimum of this linear model by: it is subtracted from them

    @property
    def p(self) -> int:
        """The number of map nodes."""
        return self.theta.size

    @property
    def u(self) -> int:
        """The number of unknowns that are neither nodes nor errors of a healthy engine."""
        return len(self.by_unknowns)

    def pinned_wrongly(self) -> NDArray[np.bool_]:
        """Return which pinned constants and sizes the gradient now pushes back into their range, shape (q + terms,)."""
        from_middle = [t.size - 0.5 * (t.effect.low + t.effect.high) for t in self.terms]
        along = self.gradient[self.p :] * np.sign(np.concatenate([self.beta, from_middle]))
        return np.asarray(self.pinned & (along > 0.0), dtype=bool)

    def whiten(self, values: Array) -> Array:
        """Return values of shape (2, B, K) in units of their noise, zero where they are kept back."""
        return self.noise.whiten(values)

    def project(self, products: Array) -> Array:
        """Return the step of map, constants and terms that answers a gradient, shape (n,)."""
        return np.asarray(scipy.linalg.cho_solve((self.factor, True), products, check_finite=False), dtype=float)

    @property
    def covariance(self) -> Array:
        """The covariance of all unknowns, shape (n, n)."""
        return self.project(np.eye(self.gradient.size))

    def row(self, index: int) -> Array:
        """Return the covariance of a term's size with all unknowns, itself in place `p + q + index`, shape (n,)."""
        return self.project(np.eye(1, self.gradient.size, self.p + self.beta.size + index)[0])

    def beside(self, columns: Array) -> tuple[Array, Array]:
        """Return the products of m whitened directions with the residual and with each other, (m, m), unknowns projected out."""
        products = self.products(columns)
        mean, difference = columns.reshape(len(columns), 2, -1).swapaxes(0, 1)
        gradient = np.array([dot(column, self.residual) for column in columns]) - products @ self.newton_step
        white = scipy.linalg.solve_triangular(self.factor, products.T, lower=True, check_finite=False)
        return gradient, mean @ mean.T - difference @ difference.T - white.T @ white

    def products(self, y: Array) -> Array:
        """Return the products of whitened vectors, shape (..., 2, B, K), with every unknown's column, shape (..., n)."""
        flat = y.reshape(-1, 2, self.mapped.size)
        mean, difference = self.columns.reshape(-1, 2, self.mapped.size).swapaxes(0, 1)
        own = flat[:, 0] @ mean.T - flat[:, 1] @ difference.T
        if self.dense is not None:
            on_map = -flat[:, 0] @ self.dense.reshape(self.p, -1).T
        else:
            first = flat[:, 0].reshape(-1, *self.mapped.shape)
            on_map = on_nodes(self.nodes, -(self.mapped * first).sum(1), self.p)
        healthy = self._of_healthy(self.problem.patterns.sums, y).reshape(len(flat), len(self.problem.patterns))
        found = np.concatenate([on_map, own[:, : self.u], healthy, own[:, self.u :]], axis=1)
        return np.asarray(found.reshape(*y.shape[:-3], found.shape[1]))

    def products_by_block(self, y: Array) -> Array:
        """Return the same of one vector, block by block, shape (blocks, n)."""
        first = self.problem.first
        if self.dense is not None:
            on_map = -np.add.reduceat(np.einsum("pbk,bk->pk", self.dense, y[0]), first, axis=1).T
        else:
            nodes = self.problem.block[:, None] * self.p + self.nodes[0], self.nodes[1]
            on_map = on_nodes(nodes, -(self.mapped * y[0]).sum(0)[None], first.size * self.p).reshape(-1, self.p)
        own = np.add.reduceat(self._own_along(y), first, axis=1).T
        healthy = self._of_healthy(lambda values: self.problem.patterns.by_block(values, first), y)
        return np.concatenate([on_map, own[:, : self.u], healthy, own[:, self.u :]], axis=1)

    def along(self, y: Array) -> Array:
        """Return the same at every place, without those of the map, shape (q + terms, K)."""
        own, healthy = self._own_along(y), self._of_healthy(self.problem.patterns.times, y)
        return np.concatenate([own[: self.u], healthy, own[self.u :]])

    def _own_along(self, y: Array) -> Array:
        own = np.einsum("ibk,bk->ik", self.columns[:, 0], y[0]) - np.einsum("ibk,bk->ik", self.columns[:, 1], y[1])
        return np.asarray(own)

    def _of_healthy(self, products: Callable[[Array], Array], y: Array) -> Array:
        """Return the products with the errors of a healthy engine, as `Patterns` makes them of the first view."""
        return -products(self.noise.dual(y[..., 0, :, :]) if len(self.problem.patterns) else y[..., 0, :, :])

    def along_stretches(self, direction: Array, whitened: Array) -> tuple[Array, Array]:
        """Return the products of a direction, stretch by stretch, with every column, (stretches, n), and with the residual.

        Where noise is correlated in time, whitening mixes the stretches. The direction then stays as it is, and the other factor is
        multiplied by the inverse covariance.
        """
        if self.dense is None:
            return self.products_by_block(whitened), self.by_block(whitened, self.residual)
        first, back = self.problem.first, self.noise.dual
        one_view = np.stack([self.dense, np.zeros_like(self.dense)], axis=1)
        dense, columns, residual = (back(x)[:, 0] for x in (one_view, self.columns, self.residual[None]))
        along = np.concatenate([-dense, columns, residual])
        sums = np.add.reduceat(np.einsum("nbk,bk->nk", along, direction[0]), first, axis=1).T
        return sums[:, :-1], sums[:, -1]

    def by_block(self, a: Array, b: Array) -> Array:
        """Return the product across views of two whitened vectors in each block, shape (blocks,)."""
        return np.asarray(np.add.reduceat((a[0] * b[0] - a[1] * b[1]).sum(0), self.problem.first))

    def moved(self, y: Array, step: Array) -> Array:
        """Return a whitened residual after a step of all unknowns."""
        begin, end = self.p + self.u, self.p + self.beta.size
        out = y - np.tensordot(np.concatenate([step[self.p : begin], step[end:]]), self.columns, 1)
        if end > begin:
            out[0] += self.whiten(self.problem.patterns.along(step[begin:end]))
        if self.dense is None:
            out[0] += self.mapped * map_along(step[: self.p], self.nodes)
        else:
            out[0] += np.tensordot(step[: self.p], self.dense, 1)
        return np.asarray(out)


def dot(a: Array, b: Array) -> float:
    """Return the product across views of two whitened vectors."""
    return float(np.vdot(a[0], b[0]) - np.vdot(a[1], b[1]))


def residual_with(linear: Linear, terms: Sequence[Term]) -> Array:
    """Return the residual with other terms, map and unknowns as they are, shape (2, B, K), not whitened."""
    problem, scenes = linear.problem, scenes_with(linear.problem, terms, linear.beta)
    return residual_of(problem, scenes, linear.beta, linear.theta, operating_nodes(problem, scenes))


def changed_by(linear: Linear, index: int) -> Array:
    """Return how one of the terms changes the residual, shape (2, B, K), not whitened."""
    terms = linear.terms
    return residual_with(linear, terms) - residual_with(linear, [*terms[:index], *terms[index + 1 :]])


def cancels(linear: Linear, one: int, other: int) -> bool:
    """Return whether two terms together, while the first one acts, change the residual less than either of them alone."""
    a, b = (linear.whiten(changed_by(linear, i)) for i in (one, other))
    b = b * np.any(a != 0.0, axis=(0, 1))
    return dot(a, b) < -0.5 * max(dot(a, a), dot(b, b), 0.0)


@njit(cache=True)
def on_nodes(nodes, values, p):  # type: ignore[no-untyped-def]
    """Return the sums of values along the places, shape (n, K), over the nodes of their cells, shape (n, p)."""
    at, share = nodes
    sums = np.zeros((len(values), p))
    for i in range(len(values)):
        for k in range(len(at)):
            for m in range(4):
                sums[i, at[k, m]] += share[k, m] * values[i, k]
    return sums
