"""The error of two models on logs that neither has seen. Map, constants and effects stay as they are."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.held_out import Losses
from lpvobs.discovery.imbalances import Nodes, by_unknowns, imbalances_at, operating_nodes, residual_of, scenes_with
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.residual import Problem, Term
from lpvobs.discovery.thresholds import LEVEL_PASSES, LEVEL_SHARE, NOTHING, SUPPORT, UNKNOWN
from lpvobs.records import Array

HOW_WHOLE = (
    "whole logs that no decision saw: map, constants and effects as they are, each balance weighted by its mean noise"
)


def losses_on_unseen(
    models: tuple[Linear, Linear], terms: tuple[Sequence[Term], Sequence[Term]], unseen: Problem
) -> Losses:
    """Return the losses of the model before and after on an unseen log.

    `terms` are the effects of either model as they act on this log. Only the levels of its day are fitted, where days differ.
    """
    after = models[1]
    root = after.noise.pointwise().root
    weight = np.sqrt(np.mean((root**2).sum(1), axis=0))[:, None] * unseen.shown
    time: Array = np.bincount(after.nodes[0].ravel(), after.nodes[1].ravel(), minlength=after.p).astype(float)
    known, losses = np.ones(unseen.K, dtype=bool), []
    for linear, acting in zip(models, terms, strict=True):
        raw, nodes = _with_its_levels(linear, acting, unseen, weight)
        losses.append(((weight * raw) ** 2).sum(0))
        known &= _informed(time, nodes, after)
    before, left = (np.where(known, loss, 0.0) for loss in losses)
    scale = float(unseen.flow / np.sqrt(np.mean((weight**2).sum(0))))
    return Losses(before, left, known, unseen.block // unseen.per_coarse, scale)


def _with_its_levels(linear: Linear, terms: Sequence[Term], unseen: Problem, weight: Array) -> tuple[Array, Nodes]:
    """Return the residual of a model on another log, shape (B, K), with the fitted levels of its day, and the map's nodes."""
    q = len(unseen.model.names)
    beta = np.concatenate([linear.beta[:q], np.zeros(unseen.spread.size - q)])
    for _ in range(LEVEL_PASSES if unseen.levels else 0):
        scenes = scenes_with(unseen, terms, beta)
        nodes = operating_nodes(unseen, scenes)
        each = imbalances_at(unseen, scenes, beta)
        columns = (weight * by_unknowns(unseen, scenes, terms, beta, each)[q:, 0]).reshape(beta.size - q, -1)
        raw = (weight * residual_of(unseen, scenes, beta, linear.theta, nodes)[0]).ravel()
        prior = np.diag(unseen.spread[q:] ** -2.0)
        shared = LEVEL_SHARE  # neighbouring places share their errors
        step = np.linalg.solve(shared * columns @ columns.T + prior, shared * columns @ raw + prior @ beta[q:])
        beta[q:] -= step
    scenes = scenes_with(unseen, terms, beta)
    nodes = operating_nodes(unseen, scenes)
    return residual_of(unseen, scenes, beta, linear.theta, nodes)[0], nodes


def pooled_losses(parts: Sequence[Losses]) -> Losses:
    """Return the losses along several logs as one."""
    offsets = np.cumsum([0, *(int(part.coarse.max()) + 1 for part in parts[:-1])])
    return Losses(
        np.concatenate([part.before for part in parts]),
        np.concatenate([part.after for part in parts]),
        np.concatenate([part.counted for part in parts]),
        np.concatenate([part.coarse + shift for part, shift in zip(parts, offsets, strict=True)]),
        parts[0].scale,
    )


def _informed(time: Array, nodes: tuple[NDArray[np.int64], Array], after: Linear) -> NDArray[np.bool_]:
    """Return where the map along a log is interpolated between nodes that the model knows, shape (K,)."""
    prior = after.problem.prior
    stands = np.zeros(after.p, dtype=bool) if prior.free else np.diag(prior.precision) > UNKNOWN * prior.precision.max()
    informed = (time >= SUPPORT) | stands
    return np.asarray(np.all(informed[nodes[0]] | (nodes[1] < NOTHING), axis=1), dtype=bool)
