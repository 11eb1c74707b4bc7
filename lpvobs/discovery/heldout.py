"""The residual on data that did not make the model: blocks left out in turn, or whole logs."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from lpvobs.discovery.fit import cholesky, normal_of
from lpvobs.discovery.linear import Linear
from lpvobs.records import Array

FOLDS = 5
SUPPORT = 10.0
"""Instants that must inform a node for what it predicts elsewhere to count."""
NOTHING = 0.02
"""Weight of a node in an interpolation that does not count."""
DRAWS = 1000
MEASURE = "rmse of the held-out residual"
HOW = f"every {FOLDS}th block of about 10 s in turn; all balances, each weighted by its own noise"


@dataclass(frozen=True)
class Comparison:
    """Root mean square of a residual before and after.

    Attributes
    ----------
    before, after, ratio : float
        [kg/s], and after over before.
    ratio_ci90 : tuple of float
        90 % interval of the ratio, from a bootstrap of blocks.
    """

    before: float
    after: float
    ratio: float
    ratio_ci90: tuple[float, float]


def held_out_losses(linear: Linear) -> tuple[Array, NDArray[np.bool_]]:
    """Return the squared whitened residual at every instant, predicted from other blocks, and which of them count.

    Map, constants and sizes are estimated anew without the blocks, by one step of the linear model from where it stands.
    """
    problem = linear.problem
    fold = problem.block // problem.per_coarse % FOLDS
    losses, counted = np.zeros(problem.K), np.zeros(problem.K, dtype=bool)
    for each in range(FOLDS):
        out = fold == each
        own = np.where(out, linear.residual, 0.0)
        factor = cholesky(linear.normal - normal_of(linear, np.flatnonzero(out)))
        step = scipy.linalg.cho_solve((factor, True), linear.gradient - linear.products(own), check_finite=False)
        left = linear.moved(linear.residual, step)[0]
        losses[out] = (left[:, out] ** 2).sum(0)
        counted[out] = informed(linear, ~out)[out] | (not problem.prior.free)
    return losses, counted


def informed(linear: Linear, by: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which instants read the map where some of the instants inform it, shape (K,)."""
    nodes, weights = linear.nodes
    time = np.bincount(nodes[by].ravel(), weights[by].ravel(), minlength=linear.p)
    return np.asarray(np.all((time[nodes] >= SUPPORT) | (weights < NOTHING), axis=1), dtype=bool)


def compare(before: Linear, after: Linear) -> Comparison:
    """Return the held-out error of two models of the same logs that share their weights."""
    lost, counted = held_out_losses(before)
    left, also = held_out_losses(after)
    use = counted & also
    coarse = after.problem.block // after.problem.per_coarse
    scale = float(np.sqrt(1.0 / np.mean((after.whitener**2).sum((1, 2)))))
    return compared(coarse, scale, np.where(use, lost, 0.0), np.where(use, left, 0.0), int(use.sum()))


def compared(coarse: NDArray[np.int64], scale: float, lost: Array, left: Array, count: int) -> Comparison:
    """Return the comparison of two losses per instant; `scale` [kg/s] turns them into a flow."""
    sums = np.stack([np.bincount(coarse, values) for values in (lost, left)])
    before, after = (float(scale * np.sqrt(total / max(count, 1))) for total in sums.sum(1))
    draws = np.random.default_rng(0).integers(0, sums.shape[1], (DRAWS, sums.shape[1]))
    picked = sums[:, draws].sum(-1)
    low, high = np.quantile(np.sqrt(picked[1] / np.maximum(picked[0], 1e-300)), [0.05, 0.95])
    return Comparison(before, after, after / max(before, 1e-300), (float(low), float(high)))
