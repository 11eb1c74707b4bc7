"""Extrapolation to operating points that nobody drove (Remark 3, Eq. 37).

The quadratic is fitted to the estimated nodes by least squares, each node weighted by its variance and the lack of fit of the
quadratic, a variance of its own that is found from the residuals. The full covariance of the nodes is then carried through that
fit. It does not make the weights: nodes share the errors of a few engine constants, and generalised least squares would use the
shape of these errors to solve for them, with a confidence that the bilinear map does not deserve (half of the intervals missed).
In raw units (u about 50, n about 3000) the normal matrix is hopeless, so the fit is made in coordinates scaled to [-1, 1] and
transformed back exactly.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Item

OUTER_SHARE = 0.2  # of the estimated nodes, taken away on one side to see whether the others predict them
LACK_PASSES = 3
"""Weights and lack of fit depend on each other; after three rounds the latter moves by less than its own uncertainty."""
COEFFICIENTS = ("a2", "a1", "b2", "b1", "c2", "c1")
"""Order of Eq. (37): u^2, u, n^2, n, u n, 1."""
BOTH, NODES = ("speed", "fuel"), ("node", "other_node")

ESTIMATED, EXTRAPOLATED, SMOOTHED = 1, 2, 4
"""Where a node comes from, as files number it; 3 is what an export keeps of an old map."""
SUPPORT = {ESTIMATED: "estimated", EXTRAPOLATED: "extrapolated", SMOOTHED: "smoothed"}


@dataclass(frozen=True)
class Filled:
    """A map with every node filled, and Eq. (37), which is the whole of it or its trend."""

    method: str  # quadratic or kriging
    # a2, a1, b2, b1, c2, c1 in kg/s per powers of the axes' units
    coefficients: Annotated[Array, Item("1", "coefficients of Eq. (37), units in coefficient_units", ("coefficient",))]
    standard_error: Annotated[
        Array, Item("1", "standard errors of the coefficients", ("coefficient",), "coefficients_standard_error")
    ]
    # beyond what the nodes' own errors explain
    lack_of_fit: Annotated[float, Item("kg/s", "standard deviation of the surface around the quadratic")]
    # zero for a quadratic
    lengths: Annotated[Array, Item("1", "correlation lengths around the quadratic, in the axes' units", ("axis",))]
    nodes: Annotated[int, Item("1", "number of estimated nodes that were fitted")]
    delta_W_c: Annotated[Array, Item("kg/s", "sensor error at every node", BOTH)]
    # of prediction, lack of fit included, where extrapolated
    covariance: Annotated[Array, Item("kg^2/s^2", "covariance of the nodes' errors", NODES, stored="f4")]
    map_standard_error: Annotated[
        Array, Item("kg/s", "standard error; where extrapolated, of the prediction", BOTH, "standard_error")
    ]
    support: Annotated[NDArray[np.int8], Item("1", "origin of the node's value", BOTH, meanings=SUPPORT)]


def terms(u: Array, n: Array) -> Array:
    """Return the regressors u^2, u, n^2, n, u n, 1 of Eq. (37), shape (..., 6)."""
    return np.stack([u * u, u, n * n, n, u * n, np.ones_like(u)], axis=-1)  # Eq. (37)


def evaluate(coefficients: Array, u: Array, n: Array) -> Array:
    """Return Eq. (37), [kg/s], in the shape of u and n."""
    return np.asarray(terms(np.asarray(u, dtype=float), np.asarray(n, dtype=float)) @ coefficients)


def scaled_terms(grid: Grid, u: Array, n: Array) -> Array:
    """Return the regressors of Eq. (37) in coordinates that run from -1 to 1 over the grid, shape (..., 6)."""
    (u_0, u_s), (n_0, n_s) = _scale(grid.fuel), _scale(grid.speed)
    return terms((u - u_0) / u_s, (n - n_0) / n_s)


def terms_at_nodes(grid: Grid) -> Array:
    """Return `scaled_terms` at every node, shape (p, 6)."""
    return scaled_terms(grid, *np.meshgrid(grid.fuel, grid.speed)).reshape(-1, 6)


def fit(
    grid: Grid,
    theta: Array,
    covariance: Array,
    supported: NDArray[np.bool_],
    noise: Array | None = None,
    design: Array | None = None,
) -> Filled:
    """Fit Eq. (37) to the supported nodes and fill the others.

    The map theta, shape (p_2, p_1) [kg/s], and its covariance, shape (p, p) [kg^2/s^2], are read at supported nodes only. `noise`,
    shape (p, p), is the part of the covariance that nodes do not share through the engine's constants, by default all of it: what
    the residuals have beyond it counts as lack of fit. `design`, shape (p, 6), has the node values that the estimator would find if
    the surface were each of `scaled_terms`, by default `terms_at_nodes`; they differ by the curvature of u^2 and n^2
    within a cell, up to 0.1 g/s for Eq. (40). Raises DataError if fewer than seven nodes are supported, or they lie on a conic so
    that the six coefficients are not determined.
    """
    X_all = terms_at_nodes(grid)
    chosen = np.flatnonzero(np.asarray(supported).reshape(-1))
    X, z = (X_all if design is None else design)[chosen], np.asarray(theta).reshape(-1)[chosen]
    refuse_too_few(X)
    Sigma = covariance[np.ix_(chosen, chosen)]
    own_noise = Sigma if noise is None else noise[np.ix_(chosen, chosen)]
    lack, A = 0.0, _fit_operator(X, np.diag(Sigma))
    for _ in range(LACK_PASSES):
        lack = _lack_of_fit(X, z, own_noise, A, np.diag(Sigma) + lack)
        A = _fit_operator(X, np.diag(Sigma) + lack)
    c = A @ z
    cov = A @ (Sigma + lack * np.eye(z.size)) @ A.T
    back = to_raw(grid)
    shared = X_all @ A @ Sigma
    whole = X_all @ cov @ X_all.T + lack * np.eye(grid.size)
    whole[:, chosen], whole[chosen] = shared, shared.T
    whole[np.ix_(chosen, chosen)] = Sigma
    return Filled(
        method="quadratic",
        coefficients=back @ c,
        standard_error=np.sqrt(np.diag(back @ cov @ back.T)),
        lack_of_fit=float(np.sqrt(lack)),
        lengths=np.zeros(2),
        nodes=int(chosen.size),
        delta_W_c=np.where(supported, theta, (X_all @ c).reshape(grid.shape)),
        covariance=whole,
        map_standard_error=standard_errors(grid, whole),
        support=np.where(supported, ESTIMATED, EXTRAPOLATED).astype(np.int8),
    )


def standard_errors(grid: Grid, covariance: Array) -> Array:
    """Return the standard error of every node, shape (p_2, p_1)."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(grid.shape))


def refuse_too_few(X: Array) -> None:
    """Raise DataError for rows of Eq. (37), one an estimated node, that do not determine its coefficients."""
    if X.shape[0] < 7 or np.linalg.matrix_rank(X) < 6:
        raise DataError(
            f"/map: {X.shape[0]} estimated nodes do not determine the six coefficients of the quadratic Eq. (37), expected at "
            f"least seven nodes that vary along both axes; estimate from logs that visit more operating points"
        )


def outer_coverage(
    fill: Callable[[NDArray[np.bool_]], Filled], grid: Grid, theta: Array, noise: Array, supported: NDArray[np.bool_]
) -> float:
    """Return how often the 90 % interval of prediction holds where it can be checked: at the outer estimated nodes.

    On each of the four sides in turn the outermost nodes are taken away, the map is filled from the others, and the nodes are
    predicted. A share well under 0.9 says that the surface does not go on as it is taken to. The constants of the engine move
    both sides of the comparison alike and are left out of its intervals. NaN where no side leaves enough nodes. `fill` takes the
    nodes that may be used, shape (p_2, p_1), and fills the map from them under `noise`; the others are as for `fit`.
    """
    n, u = np.meshgrid(grid.speed, grid.fuel, indexing="ij")
    inside: list[NDArray[np.bool_]] = []
    for axis in (u, -u, n, -n):
        outer = supported & (axis > np.quantile(axis[supported], 1.0 - OUTER_SHARE))
        try:
            inner = fill(supported & ~outer)
        except DataError:
            continue
        own = np.diag(noise).reshape(grid.shape)[outer]
        half = interval_factor(inner.nodes, 0.9) * np.sqrt(inner.map_standard_error[outer] ** 2 + own)
        inside.append(np.abs(inner.delta_W_c - theta)[outer] <= half)
    held = np.concatenate(inside) if inside else np.empty(0, dtype=bool)
    return float(held.mean()) if held.size else float("nan")


def interval_factor(nodes: int, level: float) -> float:
    """Return how many standard deviations of prediction make an interval of the given level: Student's t."""
    return float(scipy.special.stdtrit(max(nodes - 6, 1), 0.5 + level / 2.0))


def _scale(nodes: Array) -> tuple[float, float]:
    return 0.5 * float(nodes[0] + nodes[-1]), 0.5 * float(nodes[-1] - nodes[0])


def _fit_operator(X: Array, variances: Array) -> Array:
    """Return the matrix that turns node values into weighted least-squares coefficients, shape (6, nodes)."""
    weights = 1.0 / variances if np.all(variances > 0) else np.ones_like(variances)
    return np.asarray(scipy.linalg.solve(X.T @ (weights[:, None] * X), X.T * weights, assume_a="pos"))


def _lack_of_fit(X: Array, z: Array, noise: Array, A: Array, variances: Array) -> float:
    """Return the variance, the same at every node, that the residuals have beyond what noise explains."""
    # The expected weighted sum of squared residuals is tr(W M (noise + lack I) M^T), M = I - X A; solved for lack, not
    # below zero.
    weights = 1.0 / variances if np.all(variances > 0) else np.ones_like(variances)
    M = np.eye(z.size) - X @ A
    residual = M @ z
    excess = float(weights @ residual**2) - float(np.einsum("i,ij,jk,ik->", weights, M, noise, M, optimize=True))
    return max(excess / float(np.einsum("i,ij,ij->", weights, M, M)), 0.0)


def to_raw(grid: Grid) -> Array:
    """Return the matrix that turns coefficients of `scaled_terms` into those of Eq. (37), shape (6, 6)."""
    (u_0, u_s), (n_0, n_s) = _scale(grid.fuel), _scale(grid.speed)
    T = np.zeros((6, 6))
    T[0] = [1 / u_s**2, 0, 0, 0, 0, 0]
    T[1] = [-2 * u_0 / u_s**2, 1 / u_s, 0, 0, -n_0 / (u_s * n_s), 0]
    T[2] = [0, 0, 1 / n_s**2, 0, 0, 0]
    T[3] = [0, 0, -2 * n_0 / n_s**2, 1 / n_s, -u_0 / (u_s * n_s), 0]
    T[4] = [0, 0, 0, 0, 1 / (u_s * n_s), 0]
    T[5] = [u_0**2 / u_s**2, -u_0 / u_s, n_0**2 / n_s**2, -n_0 / n_s, u_0 * n_0 / (u_s * n_s), 1]
    return T
