"""The joint fit of map, constants and effects by Gauss-Newton steps, with weights made from the residual; errors of the sizes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import imbalances
from lpvobs.discovery.linear import Linear, dot
from lpvobs.discovery.noise import Noise, first_noise, noise_of
from lpvobs.discovery.normal import cholesky, drawn, map_columns, normal_beside, normal_of, pins, prior_precision
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.thresholds import (
    ANEW,
    EFFECT_STEP,
    FARTHEST,
    MOST_HALVINGS,
    MOST_STEPS,
    RESPONSE,
    SETTLED,
    STILL,
)
from lpvobs.maps.excitation import cell_numbers
from lpvobs.records import Array


def fit(problem: Problem, terms: Sequence[Term] = (), passes: int = 4, start: Linear | None = None) -> Linear:
    """Return the model with the given terms at its optimum, its weights made from its own residual."""
    theta = problem.prior.mean if start is None else start.theta
    beta = np.zeros(problem.spread.size)
    noise = first_noise(problem) if start is None else start.noise.only(problem.used)
    linear = linearised(problem, tuple(terms), theta, beta, noise, near=start)
    for _ in range(passes):
        linear = converged(linear)
        noise = noise_of(problem, linear.nodes, linear.raw[0])
        now, then = linear.noise.whiten(linear.raw), noise.whiten(linear.raw)
        still = float(linear.newton_step @ linear.gradient) < STILL
        if still and np.linalg.norm(now - then) <= SETTLED * np.linalg.norm(now):
            break
        linear = linearised(problem, linear.terms, linear.theta, linear.beta, noise, linear.pinned, linear)
    # Tests rely on the derivatives, which change fast near the stall of the compressor: the last step takes them anew.
    return _stepped(linear, None)


def linearised(
    problem: Problem,
    terms: tuple[Term, ...],
    theta: Array,
    beta: Array,
    noise: Noise,
    pinned: NDArray[np.bool_] | None = None,
    near: Linear | None = None,
) -> Linear:
    """Return the linear model at a point; the derivatives by the unknowns are those of the model `near`, where one is given."""
    scenes = imbalances.scenes_with(problem, terms, beta)
    nodes = imbalances.operating_nodes(problem, scenes)
    made = imbalances.from_signals(problem, scenes)
    each = made + imbalances.standing(problem, beta)
    raw = imbalances.views(each, problem.K)
    raw[0] -= problem.by_reading * imbalances.map_along(theta, nodes)
    derivatives = imbalances.by_unknowns(problem, scenes, terms, beta, each) if near is None else near.by_unknowns
    # what a nearby model with the same weights has whitened is not whitened again, the map only at other operating points
    weighed = near if near is not None and near.noise is noise and near.problem is problem else None
    white = _told(noise.whiten(derivatives)) if weighed is None else weighed.columns[: len(derivatives)]
    same_map = weighed if weighed is not None and _equal(nodes, weighed.nodes) else None
    straight = raw.copy()
    straight[0] += imbalances.curvature_bias(problem, scenes, made)
    residual = noise.whiten(straight)
    pinned = np.zeros(beta.size + len(terms), dtype=bool) if pinned is None else pinned
    deviation = np.concatenate([theta - problem.prior.mean, beta, [t.size - t.effect.null for t in terms]])
    nothing = np.empty((0, 0))
    bare = Linear(
        problem=problem,
        terms=terms,
        theta=theta,
        beta=beta,
        scenes=scenes,
        nodes=nodes,
        pinned=pinned,
        noise=noise,
        raw=raw,
        from_signals=imbalances.views(made, problem.K),
        residual=residual,
        by_unknowns=derivatives,
        columns=white,
        mapped=noise.whiten(problem.by_reading) if weighed is None else weighed.mapped,
        dense=map_columns(problem, noise, nodes) if same_map is None else same_map.dense,
        normal=nothing,
        factor=nothing,
        gradient=deviation,
        newton_step=deviation,
    )
    if terms:
        bare = replace(bare, columns=np.concatenate([white, _by_terms(bare, weighed)]))
    if same_map is None:
        normal = normal_of(bare) + prior_precision(problem, terms) + np.diag(pins(bare))
        factor = cholesky(normal)
    else:
        normal, factor = normal_beside(bare, same_map)
    gradient = bare.products(residual) + drawn(problem, terms, deviation)
    newton_step = scipy.linalg.cho_solve((factor, True), gradient, check_finite=False)
    return replace(bare, normal=normal, factor=factor, gradient=gradient, newton_step=newton_step)


def _told(columns: Array) -> Array:
    """Return whitened derivatives by the unknowns, (u, 2, B, K), with zeros for those that are plainly noise.

    The two views of such a derivative differ by more than they have in common, so that its information would be negative.
    """
    noise = [dot(column, column) <= 0.0 for column in columns]
    return np.asarray(np.where(np.reshape(noise, (-1, 1, 1, 1)), 0.0, columns))


def _equal(one: imbalances.Nodes, other: imbalances.Nodes) -> bool:
    """Return whether two models have the same operating points."""
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def refit(linear: Linear, terms: Sequence[Term]) -> Linear:
    """Return a model with other terms at its optimum, with the weights of this one."""
    pinned = np.concatenate([linear.pinned[: linear.beta.size], np.zeros(len(terms), dtype=bool)])
    start = linear.theta, linear.beta, linear.noise, pinned
    return converged(linearised(linear.problem, tuple(terms), *start, near=linear))


def with_term(linear: Linear, index: int, term: Term) -> Linear:
    """Return the model with another term in one place, at its optimum, with the weights of this one."""
    return refit(linear, [*linear.terms[:index], term, *linear.terms[index + 1 :]])


def without(linear: Linear, index: int) -> Linear:
    """Return the model without one of its terms, at its optimum, with the weights of this one."""
    return refit(linear, [*linear.terms[:index], *linear.terms[index + 1 :]])


def objective(linear: Linear) -> float:
    """Return half the sum of squares of a model at its point, priors included."""
    problem = linear.problem
    sizes = [term.size - term.effect.null for term in linear.terms]
    deviation = np.concatenate([linear.theta - problem.prior.mean, linear.beta, sizes])
    known = drawn(problem, linear.terms, deviation) @ deviation
    return float(0.5 * (dot(linear.residual, linear.residual) + known))


def converged(linear: Linear) -> Linear:
    """Return the model with the weights that it has at its optimum, or where no length of a step lowers the sum of squares."""
    for step in range(1, MOST_STEPS + 1):
        free = np.concatenate([np.ones(linear.p, dtype=bool), ~linear.pinned])
        if float(linear.newton_step[free] @ linear.gradient[free]) < STILL and not linear.pinned_wrongly().any():
            break
        there = _downhill(linear, linear if step % ANEW else None)
        if there is None:
            break
        linear = there
    return linear


def _downhill(linear: Linear, near: Linear | None) -> Linear | None:
    """Return the model after a step, halved while it raises the sum of squares; None where every length raises it.

    A step that pins something, or lets it go, may raise it: only the next one is right for all others.
    """
    most = objective(linear) + STILL
    for halvings in range(MOST_HALVINGS):
        there = _stepped(linear, near, 0.5**halvings)
        if objective(there) <= most or not np.array_equal(there.pinned, linear.pinned):
            return there
    return None


def _stepped(linear: Linear, near: Linear | None, share: float = 1.0) -> Linear:
    """Return the model after a share of one step; what would leave its range stops at the end of it and is pinned there."""
    problem, p, q = linear.problem, linear.p, linear.beta.size
    bound = np.where(np.arange(q) < q - len(problem.patterns), FARTHEST * problem.spread, np.inf)
    low = np.concatenate([-bound, [t.effect.low for t in linear.terms]])
    high = np.concatenate([bound, [t.effect.high for t in linear.terms]])
    wanted = np.concatenate([linear.beta, [t.size for t in linear.terms]]) - share * linear.newton_step[p:]
    there = np.clip(wanted, low, high)
    terms = tuple(replace(t, size=float(size)) for t, size in zip(linear.terms, there[q:], strict=True))
    theta = linear.theta - share * linear.newton_step[:p]
    pinned = (wanted != there) | (linear.pinned & ~linear.pinned_wrongly())
    return linearised(problem, terms, theta, there[:q], linear.noise, pinned, near)


def _by_terms(linear: Linear, near: Linear | None) -> Array:
    """Return the whitened derivatives of the residual by the size of every term, shape (terms, 2, B, K).

    Those of the model `near`, which has the same weights, serve a straight effect whatever its size.
    """
    found = np.empty((len(linear.terms), *linear.raw.shape))
    for i, term in enumerate(linear.terms):
        straight, h = term.effect.straight, EFFECT_STEP * term.effect.size
        same = next((j for j, t in enumerate(near.terms) if _act_alike(term, t)), None) if near and straight else None
        if near is not None and same is not None:
            found[i] = near.columns[near.u + same]
        else:  # near the stall, or between two samples, an effect is not the same on both sides
            sides = (h,) if straight else (h, -h)
            each = [change_with(linear, i, replace(term, size=term.size + step)) / step for step in sides]
            found[i] = linear.whiten(np.mean(each, axis=0))
    return found


def _act_alike(term: Term, other: Term) -> bool:
    """Return whether two terms differ in their size alone."""
    return term.only is other.only and replace(other, size=term.size) == term


def change_with(linear: Linear, index: int, other: Term) -> Array:
    """Return how the residual changes with another term in one place, shape (2, B, K), not whitened."""
    problem, terms = linear.problem, [*linear.terms[:index], other, *linear.terms[index + 1 :]]
    scenes = imbalances.scenes_with(problem, terms, linear.beta)
    return imbalances.change_of_residual(
        problem, other.effect, linear.scenes, scenes, linear.theta, linear.from_signals
    )


def standard_errors(linear: Linear) -> Array:
    """Return the standard error of the size of every effect in a model, shape (terms,).

    Noise and model error show in how the sums of the size's score vary from stretch to stretch of the drive and from cell to cell
    of the map. Where they vary more than noise explains, the larger variance holds (a cluster-robust variance). The constants'
    tolerance enters through their prior. Pinned constants are included: a constant at the end of its tolerance is not known any
    better for that. Noise in curved balances and blur within the window both bias a size. One bias falls with the width of the
    window, the other grows. The same model is therefore fitted through windows of another width, and half the squared difference
    of the two sizes is the variance between windows, as for two draws of one random effect.

    Where healthy drives tell, how far their sizes vary is part of the variance. There, and where the engine's curves are learned, a
    size may be off by the share `RESPONSE` of its change, or by `Effect.unlearned` if that is more.

    The variance between windows has a single degree of freedom, the others have those of the stretches. The quantile is Student's
    with the degrees of freedom of the sum (Satterthwaite). The standard error is scaled so that the normal quantile gives the
    same interval.
    """
    if not linear.terms:
        return np.empty(0)
    prior = prior_precision(linear.problem, linear.terms)
    free = replace(linear, factor=cholesky(linear.normal - np.diag(pins(linear))))
    within = np.array([_variance(linear, free.row(i), prior, i) for i in range(len(linear.terms))])
    problem = linear.problem
    within += [
        own * sum(problem.seems(term, 1.0 / own, name) for name in problem.known_as(term))
        for term, own in zip(linear.terms, within, strict=True)
    ]
    learned = linear.problem.model.healthy is not None or len(linear.problem.patterns) > 0
    off = [max(RESPONSE, term.effect.unlearned) if learned else 0.0 for term in linear.terms]
    within += [(own * (term.size - term.effect.null)) ** 2 for own, term in zip(off, linear.terms, strict=True)]
    return np.sqrt(widened(within, max(linear.problem.coarse_blocks - 1.0, 1.0), 0.5 * between_windows(linear) ** 2))


def widened(within: Array, degrees: float, between: Array) -> Array:
    """Return the variance of a normal distribution whose 90 % interval is that of a sum of estimated variances.

    That within has some degrees of freedom, that between has one.
    """
    total = within + between
    effective = total**2 / np.maximum(within**2 / degrees + between**2, np.finfo(float).tiny)
    student, normal = scipy.special.stdtrit(effective, 0.95), scipy.special.ndtri(0.95)
    return np.asarray(total * (student / normal) ** 2)


def between_windows(linear: Linear) -> Array:
    """Return the difference of the sizes that wider windows give, shape (terms,)."""
    if linear.problem.blocks is not None:  # blocks take storage as a difference between edges, and no window blurs it
        return np.zeros(len(linear.terms))
    wider = linear.problem.wider()
    there = linearised(wider, linear.terms, linear.theta, linear.beta, linear.noise.only(wider.used), linear.pinned)
    return np.array([b.size - a.size for a, b in zip(linear.terms, converged(there).terms, strict=True)])


def _variance(linear: Linear, row: Array, prior: Array, index: int) -> float:
    """Return the variance of one size for a given window; `row` is its covariance with all unknowns without model error."""
    problem, plain = linear.problem, float(row[linear.p + linear.beta.size + index])
    left = linear.moved(linear.residual, linear.newton_step)
    along = -linear.moved(np.zeros_like(left), row)
    scores = (along[0] * left[0] - along[1] * left[1]).sum(0)
    known = float(row @ prior @ row)
    cells = cell_numbers(problem.grid, linear.nodes[0])
    return known + max(plain - known, spread_of_sums(scores, problem.coarse), spread_of_sums(scores, cells))


def spread_of_sums(scores: Array, group: NDArray[np.int64]) -> float:
    """Return the variance of a sum whose parts by group are independent, from those parts; the sum itself is zero."""
    sums = np.bincount(group, scores)
    sums = sums[np.bincount(group, scores != 0.0) > 0]
    return float(sums @ sums) * sums.size / max(sums.size - 1, 1)
