"""The map in information form, with what the engine's constants owe it.

Along the log, with W_hat the flow that the balances agree on,

    z = W_maf - W_hat = Psi(v) theta + g beta + e,

theta being the map, beta the relative deviations of the engine's constants from the configuration, known within their stated
tolerance, and g = -dW_hat / dbeta. The map equation of the observer with the gain Gamma(t) = H(t)^-1, dH/dt = w Psi^T Psi, has the
solution theta = H^-1 h with H and h the integrals of w Psi^T Psi and w Psi^T z, which is what is computed here. The integrals of
several logs add up.

The constants are not fitted to the log: a disagreement of the balances of a few hundredths of a gram per second would move them
by percents along directions that hardly change it, and the map with them. Their tolerance is carried into the covariance instead
(the `consider` form of Schmidt): cov = H^-1 + J B J^T, J = H^-1 times the integral of w Psi^T g.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numba import njit
from numpy.typing import NDArray

from lpvobs.records import Array


@dataclass(frozen=True)
class Information:
    """Normal equations of p map nodes, and their coupling to q constants.

    Attributes
    ----------
    H : ndarray, shape (p, p)
        [s^2/kg^2], symmetric.
    h : ndarray, shape (p,)
        [s/kg]
    coupling : ndarray, shape (p, q)
        [s/kg], integral of w Psi^T g.
    """

    H: Array
    h: Array
    coupling: Array

    def __add__(self, other: "Information") -> "Information":
        """Return the information of two logs together."""
        return Information(self.H + other.H, self.h + other.h, self.coupling + other.coupling)


def empty(p: int, q: int) -> Information:
    """Return the information of no log at all."""
    return Information(np.zeros((p, p)), np.zeros(p), np.zeros((p, q)))


def assemble(p: int, regressors: tuple[NDArray[np.int64], Array], weight: Array, z: Array, g: Array) -> Information:
    """Return the information in N samples.

    Parameters
    ----------
    p : int
        Nodes of the map.
    regressors : tuple of ndarrays, shape (N, 4)
        Node numbers and weights Psi_l.
    weight : ndarray, shape (N,)
        [s^2/kg^2], time of the sample over the spectral density of the error of z.
    z : ndarray, shape (N,)
        [kg/s], sensor minus flow.
    g : ndarray, shape (q, N)
        [kg/s]
    """
    found = empty(p, g.shape[0])
    _assemble(*regressors, weight, z, np.ascontiguousarray(g.T), found.H, found.h, found.coupling)
    return found


@dataclass(frozen=True)
class Solution:
    """The map, how noise spreads it, and what it owes to the constants.

    Attributes
    ----------
    theta : ndarray, shape (p,)
        [kg/s]
    noise : ndarray, shape (p, p)
        [kg^2/s^2], covariance from noise alone.
    sensitivity : ndarray, shape (p, q)
        [kg/s], change of the map per relative change of each constant from the configured value to the true one.
    """

    theta: Array
    noise: Array
    sensitivity: Array

    def covariance(self, constants_variance: Array) -> Array:
        """Return the covariance of the map with constants of the given variances, shape (p, p), [kg^2/s^2]."""
        return self.noise + (self.sensitivity * constants_variance) @ self.sensitivity.T


def solve(information: Information, prior_map: float) -> Solution:
    """Return the map that the information determines.

    Parameters
    ----------
    information : Information
    prior_map : float
        [kg/s], standard deviation of a node before any data, far beyond any sensor; a node without data keeps it.
    """
    scaled = prior_map**2 * information.H + np.eye(information.h.size)
    inverse = scipy.linalg.inv(scaled, check_finite=False)
    noise = 0.5 * prior_map**2 * (inverse + inverse.T)
    return Solution(noise @ information.h, noise, noise @ information.coupling)


@njit(cache=True)
def _assemble(nodes, weights, weight, z, g, H, h, coupling):  # type: ignore[no-untyped-def]
    for k in range(z.size):
        for m in range(4):
            share = weight[k] * weights[k, m]
            if share == 0.0:  # a node that takes no part does not move
                continue
            node = nodes[k, m]
            h[node] += share * z[k]
            for other in range(4):
                H[node, nodes[k, other]] += share * weights[k, other]
            for i in range(g.shape[1]):
                coupling[node, i] += share * g[k, i]
