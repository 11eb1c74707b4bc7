"""The error of a model on data that it was not fitted to.

Choices are made by leaving out blocks in turn. The error before and after that is reported comes from other data: stretches that
are kept from every fit and every choice, or whole logs that took no part.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import imbalances, thresholds
from lpvobs.discovery.evidence import possible_edges
from lpvobs.discovery.fit import without
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.normal import cholesky, normal_of
from lpvobs.discovery.patterns import Patterns
from lpvobs.discovery.residual import Problem, Term
from lpvobs.records import Array, Item

MEASURE = "rmse of the held-out residual"
HOW = (
    f"every {thresholds.EVERY}th stretch of {thresholds.STRETCH:g} s was kept out of all fits and choices; {thresholds.GUARD:g} s "
    f"at either end of it do not count, nor does a stretch in which an effect begins or ends; all balances count, each weighted "
    f"by its own noise"
)
HOW_WHOLE = (
    "whole logs that took part in no fit and no choice: map, constants and effects come from the other logs, and each balance is "
    "weighted by its mean noise"
)


@dataclass(frozen=True)
class Comparison:
    """Root mean square of a residual before and after."""

    before: Annotated[float, Item("kg/s", "rmse of the held-out residual, before the refinement", gaps=True)]
    after: Annotated[float, Item("kg/s", "rmse of the held-out residual, after the refinement", gaps=True)]
    ratio: Annotated[float, Item("1", "rmse after over rmse before", gaps=True)]
    ratio_ci90: Annotated[
        tuple[float, float],
        Item("1", "90 % interval of the ratio, from a bootstrap of blocks", ("quantile",), gaps=True),
    ]


@dataclass(frozen=True)
class Losses:
    """Squared weighted residual of two models, K instants."""

    before: Array  # (K,)
    after: Array  # (K,)
    counted: NDArray[np.bool_]  # (K,) instants that are judged; both losses are zero at the others
    coarse: NDArray[np.int64]  # (K,) stretches that are taken as independent
    scale: float  # [kg/s], turns them into a flow

    def comparison(self) -> Comparison:
        """Return the root mean squares and their ratio, NaN where no instant is judged."""
        if not self.counted.any():
            return Comparison(np.nan, np.nan, np.nan, (np.nan, np.nan))
        sums = np.stack([np.bincount(self.coarse, values) for values in (self.before, self.after)])
        sums = sums[:, sums.any(0)] if sums.any() else sums[:, :1]
        before, after = (float(self.scale * np.sqrt(total / self.counted.sum())) for total in sums.sum(1))
        draws = np.random.default_rng(0).integers(0, sums.shape[1], (thresholds.DRAWS, sums.shape[1]))
        picked = sums[:, draws].sum(-1)
        low, high = np.quantile(np.sqrt(picked[1] / np.maximum(picked[0], 1e-300)), [0.05, 0.95])
        return Comparison(before, after, after / max(before, 1e-300), (float(low), float(high)))

    def part(self, on: NDArray[np.bool_]) -> "Losses":
        """Return the same for some of the instants."""
        return Losses(
            self.before[on], self.after[on], self.counted[on], self.coarse[on] - self.coarse[on][0], self.scale
        )


def held_out_losses(linear: Linear) -> tuple[Array, NDArray[np.bool_]]:
    """Return the squared whitened residual at every instant, predicted from other blocks, and which of them count.

    Map, constants and sizes are estimated anew without the blocks, by one step of the linear model from where it stands.
    """
    problem = linear.problem
    fold = problem.coarse % thresholds.FOLDS
    losses, counted = np.zeros(problem.K), np.zeros(problem.K, dtype=bool)
    for each in range(thresholds.FOLDS):
        out = fold == each
        own = np.where(out, linear.residual, 0.0)
        factor = cholesky(linear.normal - normal_of(linear, np.flatnonzero(out)))
        step = scipy.linalg.cho_solve((factor, True), linear.gradient - linear.products(own), check_finite=False)
        left = linear.moved(linear.residual, step)[0]
        losses[out] = (left[:, out] ** 2).sum(0)
        counted[out] = informed(linear, ~out)[out]
    return losses, counted & problem.used


def noise_power(linear: Linear) -> Array:
    """Return what noise alone adds to the squares of the residual at every place, shape (K,); two views show it."""
    if linear.problem.blocks is not None:
        return np.asarray(linear.problem.shown.sum(0), dtype=float)
    return np.asarray((linear.residual[1] ** 2).sum(0))


def informed(linear: Linear, by: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which instants read the map where some of the instants inform it, or it was known before, shape (K,)."""
    known = linear.problem.prior.standard_error < thresholds.KNOWN
    return imbalances.rests_on(_told_by(linear, by) | known, linear.nodes)


def _told_by(linear: Linear, by: NDArray[np.bool_] | slice = slice(None)) -> NDArray[np.bool_]:
    """Return which nodes some of the instants inform, shape (p,)."""
    nodes, weights = linear.nodes
    time = np.bincount(nodes[by].ravel(), weights[by].ravel(), minlength=linear.p)
    return np.asarray(time >= thresholds.SUPPORT)


def compare(before: Linear, after: Linear) -> Losses:
    """Return the losses of two models of the same logs on the stretches that neither saw, weighted as the second one is.

    Stretches in which an effect begins or ends are left out: a model that has not seen the onset cannot be judged there. Where no
    stretch is left that reads the map at nodes known from the rest, blocks are left out in turn instead.
    """
    problem = after.problem
    use = problem.judged & informed(after, problem.used) & ~undated(after)
    if not use.any():
        return cross_validated(before, after)
    noise = after.noise.pointwise().only(use)
    lost, left = ((noise.whiten(linear.raw)[0] ** 2).sum(0) for linear in (before, after))
    return Losses(lost, left, use, problem.coarse, _scale(after))


def undated(linear: Linear) -> NDArray[np.bool_]:
    """Return the kept stretches that an onset or end may fall into, or beside, as seen from the rest, shape (K,)."""
    problem = linear.problem
    clock = problem.clock
    number = np.cumsum(np.diff(problem.used.astype(np.int64), prepend=0) != 0)  # of the stretch, kept or used
    out = np.zeros(problem.K, dtype=bool)
    for low, high in (span for i in range(len(linear.terms)) for span in _edges(linear, i)):
        beside = ~problem.used & (clock >= low - thresholds.BLOCK) & (clock <= high + thresholds.BLOCK)
        out |= ~problem.used & np.isin(number, number[beside])
    return out


def _edges(linear: Linear, index: int) -> Sequence[tuple[float, float]]:
    """Return the spans [s] that onset and end of a term may lie in; those of a course are taken as they are."""
    term = linear.terms[index]
    if term.whole or term.course is not None:
        return [(edge, edge) for edge in term.edges if np.isfinite(edge)]
    return possible_edges(without(linear, index), term)


def cross_validated(before: Linear, after: Linear) -> Losses:
    """Return the same for blocks that are left out in turn of the instants that are used."""
    lost, counted = held_out_losses(before)
    left, also = held_out_losses(after)
    use = counted & also
    lost, left = (np.where(use, loss, 0.0) for loss in (lost, left))
    return Losses(lost, left, use, after.problem.coarse, _scale(after))


def _scale(linear: Linear) -> float:
    """Return what turns whitened residuals into a flow [kg/s]."""
    root = linear.noise.pointwise().root
    return float(linear.problem.flow * np.sqrt(1.0 / np.mean((root**2).sum((1, 2)))))


def losses_on_unseen(models: tuple[Linear, Linear], terms: Sequence[Sequence[Term]], unseen: Problem) -> Losses:
    """Return the losses of the model before and after on an unseen log.

    `terms` are the effects of either model as they act on this log. Only the levels of its day are fitted, where days differ.
    """
    after = models[1]
    root = after.noise.pointwise().root
    weight = np.sqrt(np.mean((root**2).sum(1), axis=0))[:, None] * unseen.shown
    known, losses = np.ones(unseen.K, dtype=bool), []
    for linear, acting in zip(models, terms, strict=True):
        raw, nodes = _with_its_levels(linear, acting, unseen, weight)
        losses.append(((weight * raw) ** 2).sum(0))
        known &= imbalances.rests_on(_told_by(after) | after.problem.prior.estimated, nodes)
    before, left = (np.where(known, loss, 0.0) for loss in losses)
    scale = float(unseen.flow / np.sqrt(np.mean((weight**2).sum(0))))
    return Losses(before, left, known, unseen.coarse, scale)


def _with_its_levels(
    linear: Linear, terms: Sequence[Term], unseen: Problem, weight: Array
) -> tuple[Array, imbalances.Nodes]:
    """Return the residual of a model on another log, shape (B, K), with the fitted levels of its day, and the map's nodes."""
    q = len(unseen.model.names)
    beta = np.concatenate([linear.beta[:q], np.zeros(unseen.spread.size - q)])
    passes = thresholds.PASSES if unseen.spread.size > q else 0
    for left in range(passes, -1, -1):
        scenes = imbalances.scenes_with(unseen, terms, beta)
        nodes = imbalances.operating_nodes(unseen, scenes)
        raw = imbalances.residual_of(unseen, scenes, beta, linear.theta, nodes)[0]
        if left == 0:
            break
        each = imbalances.imbalances_at(unseen, scenes, beta)
        columns = weight * imbalances.by_unknowns(unseen, scenes, terms, beta, each)[q:, 0]
        gram, product = _with_patterns(columns, weight * raw, weight, unseen.patterns)
        prior = np.diag(unseen.spread[q:] ** -2.0)
        shared = thresholds.LEVEL_SHARE  # neighbouring places share their errors
        beta[q:] -= np.linalg.solve(shared * gram + prior, shared * product + prior @ beta[q:])
    return raw, nodes


def _with_patterns(columns: Array, raw: Array, weight: Array, patterns: Patterns) -> tuple[Array, Array]:
    """Return the products of weighted columns, shape (n, B, K), and of patterns, (n + m, n + m), and theirs with a residual."""
    flat = columns.reshape(-1, raw.size)
    across = -patterns.sums(weight * columns)
    own = patterns.gram(np.eye(len(weight))[:, :, None] * weight**2)
    gram = np.block([[flat @ flat.T, across], [across.T, own]])
    return gram, np.concatenate([flat @ raw.ravel(), -patterns.sums(weight * raw)])


def pooled_losses(parts: Sequence[Losses]) -> Losses:
    """Return the losses along several logs as one."""
    offsets = np.cumsum([0, *(int(part.coarse.max()) + 1 for part in parts[:-1])])
    coarse = np.concatenate([part.coarse + shift for part, shift in zip(parts, offsets, strict=True)])
    before, after, counted = map(np.concatenate, zip(*((p.before, p.after, p.counted) for p in parts), strict=True))
    return Losses(before, after, counted, coarse, parts[0].scale)
