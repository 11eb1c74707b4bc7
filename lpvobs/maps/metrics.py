"""How far a map is from a known error surface, and how close any map on the same grid could come."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.maps.excitation import node_values
from lpvobs.maps.grid import Grid
from lpvobs.records import Array

NEGLIGIBLE = 0.01
"""Samples whose reference is under this share of its maximum are left out of the mean relative error."""


@dataclass(frozen=True)
class Metrics:
    """Errors of a map along one log, over the samples whose nodes were all estimated.

    The paper does not define the mean relative error behind its 10.41 % and 5.28 %. Here: the mean of
    |estimate - reference| / |reference|, without samples whose |reference| is under 1 % of its maximum.

    Attributes
    ----------
    samples : int
        Samples compared.
    mean_relative_error : float
        [-]
    share_left_out : float
        [-], share of the compared samples that the mean relative error leaves out.
    rms_ratio : float
        [-], rmse / rms(reference).
    rmse, bias : float
        [kg/s], of estimate - reference.
    visited_cells : int
        Cells of the grid with a compared sample.
    floor_mean_relative_error, floor_rms_ratio : float
        The same of the best bilinear fit to the reference itself, on the same samples.
    """

    samples: int
    mean_relative_error: float
    share_left_out: float
    rms_ratio: float
    rmse: float
    bias: float
    visited_cells: int
    floor_mean_relative_error: float
    floor_rms_ratio: float


def compare(grid: Grid, theta: Array, u_delta: Array, n_e: Array, reference: Array) -> Metrics:
    """Return the errors of a map along N operating points.

    Parameters
    ----------
    grid : Grid
    theta : ndarray, shape (p_2, p_1)
        [kg/s], NaN where not estimated.
    u_delta, n_e, reference : ndarray, shape (N,)
    """
    estimate = grid.interpolate(theta, u_delta, n_e)
    compared = np.isfinite(estimate) & np.isfinite(reference)
    nodes, weights = grid.regressors(u_delta[compared], n_e[compared])
    truth, error = reference[compared], (estimate - reference)[compared]
    if truth.size == 0:
        nan = float("nan")
        return Metrics(0, nan, nan, nan, nan, nan, 0, nan, nan)
    best = best_fit(grid, nodes, weights, truth)
    floor = np.einsum("km,km->k", weights, best[nodes]) - truth
    relative, left_out = _mean_relative(error, truth)
    return Metrics(
        samples=int(truth.size),
        mean_relative_error=relative,
        share_left_out=left_out,
        rms_ratio=_ratio(error, truth),
        rmse=_rms(error),
        bias=float(np.mean(error)),
        visited_cells=int(np.unique(nodes[:, 0]).size),
        floor_mean_relative_error=_mean_relative(floor, truth)[0],
        floor_rms_ratio=_ratio(floor, truth),
    )


def best_fit(grid: Grid, nodes: NDArray[np.int64], weights: Array, values: Array) -> Array:
    """Return the node values, shape (p,), whose bilinear map fits N values best; zero where no sample went."""
    p = grid.size
    pairs = (nodes[:, :, None] * p + nodes[:, None, :]).ravel()
    gram = np.bincount(pairs, (weights[:, :, None] * weights[:, None, :]).ravel(), minlength=p * p).reshape(p, p)
    right = np.bincount(nodes.ravel(), (weights * values[:, None]).ravel(), minlength=p)
    return node_values(gram.astype(float), right.astype(float))


def _mean_relative(error: Array, truth: Array) -> tuple[float, float]:
    counted = np.abs(truth) >= NEGLIGIBLE * np.max(np.abs(truth))
    counted &= truth != 0.0
    if not counted.any():
        return float("nan"), 1.0
    return float(np.mean(np.abs(error[counted] / truth[counted]))), float(1.0 - np.mean(counted))


def _ratio(error: Array, truth: Array) -> float:
    size = _rms(truth)
    return _rms(error) / size if size > 0 else float("nan")


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
