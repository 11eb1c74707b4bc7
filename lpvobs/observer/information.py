"""The map equation of the default method: weighted least squares over the whole drive, in information form.

Along the log, with W_hat the flow that the balances agree on,

    z = W_maf - W_hat = Psi(v) theta + g beta + e,

theta being the map, beta what the map is not told of (the relative errors of the engine's configured constants, known to lie within
their stated tolerance, with g = -dW_hat / dbeta), and e noise. The map is theta = H^-1 h, with H and h the integrals of w Psi^T Psi
and w Psi^T z; those of several logs add up.

How this departs from Eq. (26) and (36), whose map equation is dtheta/dt = Gamma Psi^T (y_m2 - C_2 x - Psi theta):

- Gamma is no constant diagonal matrix. Least squares solves the same equation with w in front of Psi^T and Gamma(t) = H(t)^-1,
  dH/dt = w Psi^T Psi. So a node is the average over all its visits; with Gamma = 200 I it is the last visit, noise included.
- The flow is not C_2 x alone but a mixture of all balances of the engine, of which C_2 x is one (see `balance_errors`).
- The map does not act back on the state: the gain is a cascade, its last column is zero. The state error decays as the certificate
  says, whatever the map is, and enters here as an error of z.

The constants are not fitted to the log: a disagreement of the balances of a few hundredths of a gram per second would move them
by percents along directions that hardly change it, and the map with them. Their tolerance is carried into the covariance instead
(the `consider` form of Schmidt): cov = H^-1 + J B J^T, J = H^-1 times the integral of w Psi^T g.
"""

from dataclasses import dataclass

import numpy as np

from lpvobs.records import Array


@dataclass(frozen=True)
class Information:
    """Normal equations of p map nodes, and their coupling to q other influences on z.

    Attributes
    ----------
    H : ndarray, shape (p, p)
        [s^2/kg^2], symmetric.
    h : ndarray, shape (p,)
        [s/kg]
    coupling : ndarray, shape (p, q)
        Integral of w Psi^T g.
    """

    H: Array
    h: Array
    coupling: Array


@dataclass(frozen=True)
class Solution:
    """The map, how noise spreads it, and how it answers to what it is not told of.

    Attributes
    ----------
    theta : ndarray, shape (p,)
        [kg/s]
    noise : ndarray, shape (p, p)
        [kg^2/s^2], covariance from noise alone.
    response : ndarray, shape (p, q)
        How the map answers to each influence: the node values it would find if z were g alone.
    """

    theta: Array
    noise: Array
    response: Array

    def covariance(self, variance: Array) -> Array:
        """Return the covariance of the map, shape (p, p) [kg^2/s^2], with influences of the given variances, shape (q,)."""
        return self.noise + (self.response * variance) @ self.response.T


def solve(information: Information, prior_map: float) -> Solution:
    """Return the map that the information determines.

    Parameters
    ----------
    information : Information
    prior_map : float
        [kg/s], standard deviation of a node before any data, far beyond any sensor; a node without data keeps it.
    """
    scaled = prior_map**2 * information.H + np.eye(information.h.size)
    inverse = np.linalg.inv(scaled)
    noise = 0.5 * prior_map**2 * (inverse + inverse.T)
    return Solution(noise @ information.h, noise, noise @ information.coupling)
