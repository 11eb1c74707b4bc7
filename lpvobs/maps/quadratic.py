"""Extrapolation to operating points that nobody drove (Remark 3, Eq. 37).

The quadratic is fitted to the estimated nodes by generalised least squares: nodes are weighted by their covariance, to which the
lack of fit of the quadratic is added as a variance of its own, found from the residuals. In raw units (u about 50, n about 3000)
the normal matrix is hopeless, so the fit is made in coordinates scaled to [-1, 1] and transformed back exactly.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.special
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.maps.grid import Grid
from lpvobs.records import Array

COEFFICIENTS = ("a2", "a1", "b2", "b1", "c2", "c1")
"""Order of Eq. (37): u^2, u, n^2, n, u n, 1."""

PAPER = {
    "ETC part 1, Eq. (39)": (9.12e-6, -4.39e-4, 1.30e-9, -5.74e-6, -5.37e-8, 0.0012887),
    "FTP75 cold transient, Eq. (40)": (2.10e-5, -8.62e-4, 1.46e-9, -6.40e-6, -1.84e-8, 0.0032316),
}


@dataclass(frozen=True)
class QuadraticFit:
    """Eq. (37) fitted to the estimated part of a map.

    Attributes
    ----------
    coefficients, standard_error : ndarray, shape (6,)
        a2, a1, b2, b1, c2, c1 in kg/s per powers of the axes' units.
    lack_of_fit : float
        [kg/s], standard deviation of the surface around the quadratic beyond what the nodes' own errors explain.
    nodes : int
        Nodes that took part.
    delta_W_c : ndarray, shape (p_2, p_1)
        Every node: estimated ones as they are, the others from the quadratic.
    map_standard_error : ndarray, shape (p_2, p_1)
        Of estimated nodes as given; of the others the standard deviation of prediction, lack of fit included.
    support : ndarray of int8, shape (p_2, p_1)
        1 estimated, 2 extrapolated.
    """

    coefficients: Array
    standard_error: Array
    lack_of_fit: float
    nodes: int
    delta_W_c: Array
    map_standard_error: Array
    support: NDArray[np.int8]


def terms(u: Array, n: Array) -> Array:
    """Return the regressors u^2, u, n^2, n, u n, 1 of Eq. (37), shape (..., 6)."""
    return np.stack([u * u, u, n * n, n, u * n, np.ones_like(u)], axis=-1)


def evaluate(coefficients: Array, u: Array, n: Array) -> Array:
    """Return Eq. (37), [kg/s], in the shape of u and n."""
    return np.asarray(terms(np.asarray(u, dtype=float), np.asarray(n, dtype=float)) @ coefficients)


def fit(grid: Grid, theta: Array, covariance: Array, supported: NDArray[np.bool_]) -> QuadraticFit:
    """Fit Eq. (37) to the supported nodes and fill the others.

    Parameters
    ----------
    grid : Grid
    theta : ndarray, shape (p_2, p_1)
        [kg/s]
    covariance : ndarray, shape (p, p)
        Of theta, [kg^2/s^2]; read at supported nodes only.
    supported : ndarray of bool, shape (p_2, p_1)

    Raises
    ------
    DataError
        If fewer than seven nodes are supported, or they lie on a conic so that the six coefficients are not determined.
    """
    n, u = np.meshgrid(grid.n_e, grid.u_delta, indexing="ij")
    (u_0, u_s), (n_0, n_s) = _scale(grid.u_delta), _scale(grid.n_e)
    X_all = terms((u - u_0) / u_s, (n - n_0) / n_s).reshape(-1, 6)
    chosen = np.flatnonzero(np.asarray(supported).reshape(-1))
    X, z = X_all[chosen], np.asarray(theta).reshape(-1)[chosen]
    if chosen.size < 7 or np.linalg.matrix_rank(X) < 6:
        raise DataError(
            f"/map: {chosen.size} estimated nodes do not determine the six coefficients of Eq. (37), expected at least seven "
            f"that vary in both axes; estimate from logs that visit more operating points"
        )
    eigenvalues, vectors = scipy.linalg.eigh(covariance[np.ix_(chosen, chosen)])
    X_w, z_w, variances = vectors.T @ X, vectors.T @ z, np.maximum(eigenvalues, 0.0)
    lack = _lack_of_fit(X_w, z_w, variances)
    c, cov = _weighted(X_w, z_w, variances + lack)
    back = _to_raw(u_0, u_s, n_0, n_s)
    filled = (X_all @ c).reshape(grid.shape)
    spread = np.sqrt(np.einsum("ij,jk,ik->i", X_all, cov, X_all) + lack).reshape(grid.shape)
    own = np.sqrt(np.maximum(np.diag(covariance), 0.0)).reshape(grid.shape)
    return QuadraticFit(
        coefficients=back @ c,
        standard_error=np.sqrt(np.diag(back @ cov @ back.T)),
        lack_of_fit=float(np.sqrt(lack)),
        nodes=int(chosen.size),
        delta_W_c=np.where(supported, theta, filled),
        map_standard_error=np.where(supported, own, spread),
        support=np.where(supported, 1, 2).astype(np.int8),
    )


def interval_factor(nodes: int, level: float) -> float:
    """Return how many standard deviations of prediction make an interval of the given level: Student's t."""
    return float(scipy.special.stdtrit(max(nodes - 6, 1), 0.5 + level / 2.0))


def _scale(nodes: Array) -> tuple[float, float]:
    return 0.5 * float(nodes[0] + nodes[-1]), 0.5 * float(nodes[-1] - nodes[0])


def _weighted(X: Array, z: Array, variances: Array) -> tuple[Array, Array]:
    """Return the weighted least-squares solution and its covariance."""
    W = X / variances[:, None]
    cov = scipy.linalg.inv(X.T @ W)
    return cov @ (W.T @ z), cov


def _lack_of_fit(X: Array, z: Array, variances: Array) -> float:
    """Return the variance to add to every node so that the weighted residual sum equals its degrees of freedom.

    The estimate of Paule and Mandel, J. Res. NBS 87 (1982), for the variance between groups; zero if the nodes' own errors
    already explain the residuals.
    """
    from scipy.optimize import brentq  # noqa: PLC0415 slow to import, and only this function needs it

    floor = 1e-12 * float(z @ z) / z.size + np.finfo(float).tiny
    freedom = z.size - 6

    def excess(lack: float) -> float:
        c, _ = _weighted(X, z, variances + lack)
        return float(np.sum((z - X @ c) ** 2 / (variances + lack))) - freedom

    if excess(floor) <= 0.0:
        return floor
    high = floor
    while excess(high) > 0.0:
        high *= 4.0
    return float(brentq(excess, high / 4.0, high, rtol=1e-6))


def _to_raw(u_0: float, u_s: float, n_0: float, n_s: float) -> Array:
    """Return the matrix that turns coefficients in (u - u_0) / u_s, (n - n_0) / n_s into those in u, n."""
    T = np.zeros((6, 6))
    T[0] = [1 / u_s**2, 0, 0, 0, 0, 0]
    T[1] = [-2 * u_0 / u_s**2, 1 / u_s, 0, 0, -n_0 / (u_s * n_s), 0]
    T[2] = [0, 0, 1 / n_s**2, 0, 0, 0]
    T[3] = [0, 0, -2 * n_0 / n_s**2, 1 / n_s, -u_0 / (u_s * n_s), 0]
    T[4] = [0, 0, 0, 0, 1 / (u_s * n_s), 0]
    T[5] = [u_0**2 / u_s**2, -u_0 / u_s, n_0**2 / n_s**2, -n_0 / n_s, u_0 * n_0 / (u_s * n_s), 1]
    return T
