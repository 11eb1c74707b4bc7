"""The normal matrix of a linear model: products of all columns, what is known before the data, what is pinned, and its factor."""

from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import imbalances
from lpvobs.discovery.linear import Linear, on_nodes
from lpvobs.discovery.noise import Noise, Scatter
from lpvobs.discovery.patterns import Patterns
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.thresholds import PIN, WIDEST
from lpvobs.records import Array


def normal_of(linear: Linear, instants: NDArray[np.int64] | slice = slice(None)) -> Array:
    """Return the products of all columns with each other over some instants, shape (n, n)."""
    J = linear.columns[..., instants]
    J = np.ascontiguousarray(J).reshape(*J.shape[:2], J.shape[2] * J.shape[3])
    if linear.dense is not None:
        D = -np.ascontiguousarray(linear.dense[..., instants]).reshape(linear.p, -1)
        both = np.vstack([D, J[:, 0]])
        return np.asarray(both @ both.T)
    column, nodes = linear.mapped[:, instants], (linear.nodes[0][instants], linear.nodes[1][instants])
    H = map_normal(linear.p, nodes, (column**2).sum(0))
    between = on_nodes(nodes, -(column * linear.columns[:, 0][..., instants]).sum(1), linear.p)
    own = np.block([[H, between.T], [between, J[:, 0] @ J[:, 0].T - J[:, 1] @ J[:, 1].T]])
    if not isinstance(linear.noise, Scatter) or not len(linear.problem.patterns):
        return own
    every, back = isinstance(instants, slice), linear.noise.dual
    patterns = linear.problem.patterns if every else linear.problem.patterns.at(instants)
    on_map = on_nodes(nodes, patterns.times(back(linear.mapped)[:, instants]), linear.p)
    with_own = -patterns.sums(back(linear.columns[:, 0])[..., instants])
    across = np.hstack([on_map, with_own.T])
    # steps of one fit have the same noise at all instants, and the products of patterns cost most
    gram = gram_of(patterns, linear.noise) if every else patterns.gram(linear.noise.precision[..., instants])
    whole = np.block([[own, across.T], [across, gram]])
    begin, end = linear.p + linear.u, len(own)
    order = np.r_[:begin, end : len(whole), begin:end]  # effects come last
    return np.asarray(whole[np.ix_(order, order)])


@lru_cache(maxsize=1)
def gram_of(patterns: Patterns, noise: Scatter) -> Array:
    """Return the products of patterns at all instants, in units of a noise."""
    return patterns.gram(noise.precision)


def map_normal(p: int, nodes: imbalances.Nodes, information: Array) -> Array:
    """Return the normal matrix of the map, shape (p, p)."""
    pairs = nodes[0][:, :, None] * p + nodes[0][:, None, :]
    shares = (information[:, None] * nodes[1])[:, :, None] * nodes[1][:, None, :]
    return np.asarray(np.bincount(pairs.ravel(), shares.ravel(), minlength=p * p).reshape(p, p), dtype=float)


def normal_beside(bare: Linear, near: Linear) -> tuple[Array, Array]:
    """Return the normal matrix and its factor; the part of map and unknowns is that of a nearby model, but for what is pinned."""
    known, n, held = bare.p + bare.beta.size, bare.newton_step.size, pins(bare)
    freed = held[:known] - pins(near)[:known]
    normal = np.empty((n, n))
    normal[:known, :known] = near.normal[:known, :known]
    normal[known:] = bare.products(bare.columns[bare.u :])
    normal[:, known:] = normal[known:].T
    normal[range(n), range(n)] += np.concatenate([freed, _own_precision(bare.terms) + held[known:]])
    if freed.any() or not _is_factor(near.factor[:known, :known], normal[:known, :known]):
        return normal, cholesky(normal)
    # A lower factor grows by rows at its end.
    right = np.zeros((len(near.normal), n - known))
    right[:known] = normal[:known, known:]
    across = scipy.linalg.solve_triangular(near.factor, right, lower=True, check_finite=False)[:known]
    left = normal[known:, known:] - across.T @ across
    factor = np.zeros((n, n), order="F")
    factor[:known, :known], factor[known:, :known] = near.factor[:known, :known], across.T
    try:
        factor[known:, known:] = np.linalg.cholesky(left)
    except np.linalg.LinAlgError:
        return normal, cholesky(normal)
    return normal, factor


def _is_factor(factor: Array, matrix: Array) -> bool:
    """Return whether a factor has no ridge, and is no mere diagonal: by the diagonal and by one product."""
    one = np.ones(len(matrix))
    product, wanted = factor @ (factor.T @ one), matrix @ one
    own = np.allclose((factor**2).sum(1), np.diag(matrix), rtol=1e-9)
    return own and np.allclose(product, wanted, rtol=1e-6, atol=1e-9 * float(np.abs(wanted).max()))


def cholesky(matrix: Array) -> Array:
    """Return the lower Cholesky factor; noise may make the matrix indefinite, and the smallest ridge mends it."""
    scale = np.diag(np.abs(np.diag(matrix)))
    for ridge in (0.0, 1e-8, 1e-4, 1e-2, 1e-1):
        try:
            return np.asarray(scipy.linalg.cholesky(matrix + ridge * scale, lower=True, check_finite=False))
        except np.linalg.LinAlgError:
            continue
    return np.asarray(np.sqrt(scale))


def prior_precision(problem: Problem, terms: tuple[Term, ...]) -> Array:
    """Return the prior precision of all unknowns, shape (n, n)."""
    return np.asarray(scipy.linalg.block_diag(problem.precision_with_map, np.diag(_own_precision(terms))))


def _own_precision(terms: tuple[Term, ...]) -> Array:
    """Return that of the sizes of effects, shape (terms,)."""
    return np.array([(WIDEST * t.effect.size) ** -2.0 for t in terms])


def drawn(problem: Problem, terms: tuple[Term, ...], deviation: Array) -> Array:
    """Return the product of the prior precision and a deviation from the prior, shape (n,)."""
    known = len(problem.precision_with_map)
    return np.concatenate([problem.precision_with_map @ deviation[:known], _own_precision(terms) * deviation[known:]])


def pins(linear: Linear) -> Array:
    """Return the precision that holds each unknown, if it is pinned, at its value, shape (n,)."""
    usual = np.concatenate([linear.problem.spread, [t.effect.size for t in linear.terms]])
    return np.concatenate([np.zeros(linear.p), np.where(linear.pinned, PIN * usual**-2.0, 0.0)])


def map_columns(problem: Problem, noise: Noise, nodes: imbalances.Nodes) -> Array | None:
    """Return the whitened trace of every node of the map, shape (p, B, K); none where noise is independent from place to place."""
    if isinstance(noise, Scatter):
        return None
    weights = np.zeros((problem.grid.size, problem.K))
    for m in range(4):
        np.add.at(weights, (nodes[0][:, m], np.arange(problem.K)), nodes[1][:, m])
    traces = np.zeros((problem.grid.size, 2, *problem.by_reading.shape))
    traces[:, 0] = weights[:, None] * problem.by_reading
    return noise.whiten(traces)[:, 0]
