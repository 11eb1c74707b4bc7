"""Gauss-Newton on map, constants and effects together."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from lpvobs.discovery.linear import (
    Linear,
    Nodes,
    Term,
    bend_of,
    covariance_root,
    dot,
    map_along,
    map_normal,
    operating_nodes,
    residual_of,
    scatter,
    scene_with,
    views,
    whiten,
)
from lpvobs.discovery.residual import Problem
from lpvobs.engines.effects import Scene
from lpvobs.records import Array

STEP = 1e-4
"""Relative step of the difference quotients by constants."""
SHARE = 0.02
"""Step of the difference quotients by an effect, as a share of its noticeable size."""
WIDEST = 100.0
"""Prior standard deviation of an accepted effect in noticeable sizes: none to speak of."""
ANEW = 5
"""Steps after which the derivatives by the constants are taken anew: they change little, and are most of the work."""
MOST_STEPS = 12
"""Gauss-Newton steps between two sets of weights."""
STILL = 1.0
"""Gain, twice and in units of the noise, below which a further step is not worth taking."""
PIN = 1e6
"""Precision of a pinned constant in units of its prior's."""
FARTHEST = 2.0
"""A constant is sought within this many standard deviations of its prior, which is 15 % beyond its tolerance."""


def fit(problem: Problem, terms: Sequence[Term] = (), passes: int = 4, start: Linear | None = None) -> Linear:
    """Return the model with the given terms at its optimum, its weights made from its own residual."""
    theta = problem.prior.mean if start is None else start.theta
    beta = np.zeros(len(problem.names))
    whitener = None if start is None else start.whitener
    linear = linearised(problem, tuple(terms), theta, beta, whitener, near=start)
    for _ in range(passes):
        linear = converged(linear)
        nodes = linear.nodes
        root = covariance_root(problem, nodes, linear.raw[0])
        linear = linearised(problem, linear.terms, linear.theta, linear.beta, root, linear.pinned, linear)
    return _stepped(linear, None)  # near the stall of the compressor derivatives change fast, and tests follow


def linearised(
    problem: Problem,
    terms: tuple[Term, ...],
    theta: Array,
    beta: Array,
    whitener: Array | None,
    pinned: NDArray[np.bool_] | None = None,
    near: Linear | None = None,
) -> Linear:
    """Return the linear model at a point.

    Without a whitener every balance counts alike; with a model `near` by, its derivatives by the constants are used.
    """
    constants = _constants(problem, beta)
    scene = scene_with(problem, terms, constants)
    nodes = operating_nodes(problem, scene)
    each = problem.plant.imbalances(constants, scene.value, scene.rate, scene.lacks)
    raw = views(each)
    raw[0] -= problem.plant.mapped[:, None] * map_along(theta, nodes)
    if whitener is None:
        whitener = np.tile(np.eye(raw.shape[1]) / 1e-3, (problem.K, 1, 1))
    by_constants = _by_constants(problem, scene, beta, each) if near is None else near.by_constants
    known = near is not None and near.whitener is whitener and near.problem is problem
    white = near.columns[: beta.size] if near is not None and known else _whitened(problem, whitener, by_constants)
    if terms:
        white = np.concatenate(
            [white, _whitened(problem, whitener, _by_terms(problem, terms, constants, theta, nodes))]
        )
    straight = raw.copy()
    straight[0] += bend_of(problem, scene, constants, each)
    residual = whiten(whitener, problem.used, straight)
    pinned = np.zeros(beta.size, dtype=bool) if pinned is None else pinned
    prior = prior_precision(problem, terms)
    deviation = np.concatenate([theta - problem.prior.mean, beta, [t.size - t.effect.null for t in terms]])
    bare = Linear(
        problem,
        terms,
        theta,
        beta,
        scene,
        nodes,
        constants,
        pinned,
        whitener,
        raw,
        residual,
        by_constants,
        white,
        np.ascontiguousarray((whitener @ problem.plant.mapped).T) * problem.used,
        prior,
        prior,
        deviation,
        deviation,
    )
    normal = normal_of(bare) + prior + pins(problem, pinned, prior.shape[0])
    factor = cholesky(normal)
    gradient = bare.products(residual) + prior @ deviation
    pull = scipy.linalg.cho_solve((factor, True), gradient, check_finite=False)
    return replace(bare, normal=normal, factor=factor, gradient=gradient, pull=pull)


def _whitened(problem: Problem, whitener: Array, columns: Array) -> Array:
    return np.asarray(whiten(whitener, problem.used, columns.reshape(-1, *columns.shape[2:])).reshape(columns.shape))


def refit(linear: Linear, terms: Sequence[Term]) -> Linear:
    """Return a model with other terms at its optimum, with the weights of this one."""
    start = linear.theta, linear.beta, linear.whitener
    return converged(linearised(linear.problem, tuple(terms), *start, near=linear))


def objective(linear: Linear) -> float:
    """Return half the sum of squares where a model stands, what is known beforehand included."""
    problem = linear.problem
    sizes = [term.size - term.effect.null for term in linear.terms]
    deviation = np.concatenate([linear.theta - problem.prior.mean, linear.beta, sizes])
    prior = prior_precision(problem, linear.terms)
    return float(0.5 * (dot(linear.residual, linear.residual) + deviation @ prior @ deviation))


def converged(linear: Linear) -> Linear:
    """Return the model after as many steps as it takes to stand still, with the weights that it has."""
    for step in range(1, MOST_STEPS + 1):
        if float(linear.pull @ linear.normal @ linear.pull) < STILL and not linear.pinned_wrongly().any():
            break
        linear = _stepped(linear, linear if step % ANEW else None)
    return linear


def _stepped(linear: Linear, near: Linear | None) -> Linear:
    problem, p, q = linear.problem, linear.p, linear.beta.size
    bound = FARTHEST * problem.spread
    wanted = linear.beta - linear.pull[p : p + q]
    beta = np.clip(wanted, -bound, bound)
    terms = tuple(
        replace(t, size=float(np.clip(t.size - d, t.effect.low, t.effect.high)))
        for t, d in zip(linear.terms, linear.pull[p + q :], strict=True)
    )
    theta = linear.theta - linear.pull[:p]
    pinned = (np.abs(wanted) > bound) | (linear.pinned & ~linear.pinned_wrongly())
    return linearised(problem, terms, theta, beta, linear.whitener, pinned, near)


def _constants(problem: Problem, beta: Array) -> object:
    base = problem.plant.constants
    return base._replace(**{n: getattr(base, n) * (1.0 + b) for n, b in zip(problem.names, beta, strict=True)})


def _by_constants(problem: Problem, scene: Scene, beta: Array, at: Array) -> Array:
    plant = problem.plant
    found = np.empty((beta.size, 2, len(plant.balances), problem.K))
    for i in range(beta.size):
        moved = beta.copy()
        moved[i] += STEP
        found[i] = views(
            (plant.imbalances(_constants(problem, moved), scene.value, scene.rate, scene.lacks) - at) / STEP
        )
    return found


def _by_terms(problem: Problem, terms: tuple[Term, ...], constants: object, theta: Array, nodes: Nodes) -> Array:
    found = np.empty((len(terms), 2, len(problem.plant.balances), problem.K))
    for i, term in enumerate(terms):
        h = SHARE * term.effect.size
        ends = []
        for shift in (h, -h):
            moved = [replace(t, size=t.size + shift) if j == i else t for j, t in enumerate(terms)]
            scene = scene_with(problem, moved, constants)
            at = operating_nodes(problem, scene) if term.effect.moves_point else nodes
            ends.append(residual_of(problem, scene, constants, theta, at))
        found[i] = (ends[0] - ends[1]) / (2.0 * h)
    return found


def prior_precision(problem: Problem, terms: tuple[Term, ...]) -> Array:
    """Return the precision of what is known beforehand, shape (n, n)."""
    P, S = problem.prior.precision, problem.prior.sensitivity
    known = np.block([[P, -P @ S], [-S.T @ P, S.T @ P @ S + np.diag(problem.spread**-2.0)]])
    own = np.array([(WIDEST * t.effect.size) ** -2.0 for t in terms])
    return np.asarray(scipy.linalg.block_diag(known, np.diag(own)))


def pins(problem: Problem, pinned: NDArray[np.bool_], n: int) -> Array:
    """Return what holds pinned constants where they are, shape (n, n)."""
    held = np.zeros(n)
    p = problem.grid.size
    held[p : p + pinned.size] = np.where(pinned, PIN * problem.spread**-2.0, 0.0)
    return np.diag(held)


def normal_of(linear: Linear, instants: NDArray[np.int64] | slice = slice(None)) -> Array:
    """Return the products of all columns with each other over some instants, shape (n, n)."""
    column = linear.mapped[:, instants]
    nodes = linear.nodes[0][instants], linear.nodes[1][instants]
    H = map_normal(linear.p, *nodes, (column**2).sum(0))
    J = np.ascontiguousarray(linear.columns[..., instants]).reshape(linear.columns.shape[0], 2, -1)
    between = np.zeros((J.shape[0], linear.p))
    one = np.zeros(column.shape[1], dtype=np.int64)
    for i in range(J.shape[0]):
        scatter(between[i : i + 1], one, *nodes, -(column * linear.columns[i, 0][:, instants]).sum(0))
    dense = J[:, 0] @ J[:, 0].T - J[:, 1] @ J[:, 1].T
    return np.block([[H, between.T], [between, dense]])


def cholesky(matrix: Array) -> Array:
    """Return the lower Cholesky factor; a matrix that noise made indefinite gets the smallest ridge that mends it."""
    scale = np.diag(np.abs(np.diag(matrix)))
    for ridge in (0.0, 1e-8, 1e-4, 1e-2, 1e-1):
        try:
            return np.asarray(scipy.linalg.cholesky(matrix + ridge * scale, lower=True, check_finite=False))
        except np.linalg.LinAlgError:
            continue
    return np.asarray(np.sqrt(scale))
