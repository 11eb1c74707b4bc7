"""The error of two models on logs that neither has seen: map, constants and effects as they are, nothing fitted, nothing chosen."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.held_out import NOTHING, SUPPORT, Losses
from lpvobs.discovery.linear import Linear, Term, operating_nodes, residual_of, scene_with
from lpvobs.discovery.residual import Problem
from lpvobs.records import Array

HOW_WHOLE = (
    "whole logs that no decision saw: map, constants and effects as they are, each balance weighted by its mean noise"
)


def carried(models: tuple[Linear, Linear], terms: tuple[Sequence[Term], Sequence[Term]], unseen: Problem) -> Losses:
    """Return the losses of the model before and after on an unseen log.

    `terms` are the effects of either model as they act on this log.
    """
    after = models[1]
    weight = np.sqrt(np.mean((after.whitener**2).sum(1), axis=0))[:, None]
    time: Array = np.bincount(after.nodes[0].ravel(), after.nodes[1].ravel(), minlength=after.p).astype(float)
    known, losses = np.ones(unseen.K, dtype=bool), []
    for linear, acting in zip(models, terms, strict=True):
        scene = scene_with(unseen, acting)
        nodes = operating_nodes(unseen, scene)
        raw = residual_of(unseen, scene, linear.constants, linear.theta, nodes)[0]
        losses.append(((weight * raw) ** 2).sum(0))
        known &= _told(time, nodes, after)
    before, left = (np.where(known, loss, 0.0) for loss in losses)
    scale = float(1.0 / np.sqrt(np.sum(weight**2)))
    return Losses(before, left, known, unseen.block // unseen.per_coarse, scale)


def together(parts: Sequence[Losses]) -> Losses:
    """Return the losses along several logs as one."""
    offsets = np.cumsum([0, *(int(part.coarse.max()) + 1 for part in parts[:-1])])
    return Losses(
        np.concatenate([part.before for part in parts]),
        np.concatenate([part.after for part in parts]),
        np.concatenate([part.counted for part in parts]),
        np.concatenate([part.coarse + shift for part, shift in zip(parts, offsets, strict=True)]),
        parts[0].scale,
    )


def _told(time: Array, nodes: tuple[NDArray[np.int64], Array], after: Linear) -> NDArray[np.bool_]:
    """Return where the map along a log stands on nodes that the model knows."""
    prior = after.problem.prior
    stands = np.zeros(after.p, dtype=bool) if prior.free else np.diag(prior.precision) > UNKNOWN * prior.precision.max()
    informed = (time >= SUPPORT) | stands
    return np.asarray(np.all(informed[nodes[0]] | (nodes[1] < NOTHING), axis=1), dtype=bool)


UNKNOWN = 1e-3
"""Of the largest precision of a nominal map: nodes under it were not estimated."""
