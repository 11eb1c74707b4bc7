"""One step of the adaptive observer as the paper prints it: Eq. (26) over the whole map, Eq. (36) over the nodes that take part.

    dx/dt = A x + E + L (y_m - C x - G Psi theta),    dtheta/dt = Gamma Psi^T (y_m2 - C_2 x - Psi theta)

Nothing here is made to be fast: it is what the compiled recursion is held against. The paper does not say how to discretise. Taken
is backward Euler, both rates at the end of the step: n + p linear equations, stable where L_11 = 1636 1/s and Gamma = 200 1/s meet
samples 10 ms apart. Departure from the paper: none in the equations.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array


@dataclass(frozen=True)
class Sample:
    """The system of Eq. (24) at one sample: n states, r outputs."""

    A: Array  # (n, n)
    E: Array  # (n,)
    C: Array  # (r, n) the last row is C_2
    # (r,) the readings y_m, NaN where one is missing; the last one, y_m2, is that of the sensor with the map
    y: Array


def rates(x: Array, theta: Array, sample: Sample, L: Array, Gamma: Array, Psi: Array) -> tuple[Array, Array]:
    """Return dx/dt (n,), dtheta/dt (p,) [kg/s^2] of Eq. (26); theta (p,), L (n, r), Gamma (p, p) [1/s], Psi (1, p)."""
    A, E, C, y = sample.A, sample.E, sample.C, sample.y
    G = _map_output(sample)
    C_2, y_2 = C[-1:], y[-1:]
    dx = A @ x + E + L @ (y - C @ x - G @ Psi @ theta)  # Eq. (26)
    dtheta = Gamma @ Psi.T @ (y_2 - C_2 @ x - Psi @ theta)  # Eq. (26)
    return np.asarray(dx), np.asarray(dtheta)


def error_matrix(sample: Sample, L: Array, Gamma: Array, Psi: Array) -> Array:
    """Return F of the error system dz/dt = F z with z = (x_hat - x, theta_hat - theta), shape (n + p, n + p)."""
    A, C, G = sample.A, sample.C, _map_output(sample)
    C_2 = C[-1:]
    return np.block([[A - L @ C, -L @ G @ Psi], [-Gamma @ Psi.T @ C_2, -Gamma @ Psi.T @ Psi]])  # Eq. (30)


def step(x: Array, theta: Array, h: float, sample: Sample, L: Array, Gamma: Array, Psi: Array) -> tuple[Array, Array]:
    """Return x and theta after a step of h [s] that ends at the sample, by backward Euler."""
    # An output without a reading corrects nothing: its column of L is taken for zero, and without the sensor's reading the
    # map stands still. Other arguments as for `rates`.
    missing = np.isnan(sample.y)
    if missing.any():
        L, Gamma = np.where(missing, 0.0, L), np.where(missing[-1], 0.0, Gamma)
        sample = replace(sample, y=np.where(missing, 0.0, sample.y))
    F, n = error_matrix(sample, L, Gamma, Psi), x.size
    f = np.concatenate((sample.E + L @ sample.y, Gamma @ Psi.T @ sample.y[-1:]))
    z = np.asarray(np.linalg.solve(np.eye(F.shape[0]) - h * F, np.concatenate((x, theta)) + h * f), dtype=np.float64)
    return z[:n], z[n:]


def local_step(
    x: Array, theta: Array, h: float, sample: Sample, L: Array, gamma: float, nodes: NDArray[np.int64], Psi_l: Array
) -> tuple[Array, Array]:
    """Return x and theta after the same step where only the nodes around the operating point move.

    The nodes, shape (4,), are numbers, Psi_l, shape (4,), their weights of Eq. (34), and Gamma_l = gamma I, gamma in 1/s.
    """
    moved = theta.copy()
    x, moved[nodes] = step(x, theta[nodes], h, sample, L, gamma * np.eye(nodes.size), Psi_l[None, :])  # Eq. (36)
    return x, moved


def _map_output(sample: Sample) -> Array:
    """Return G of Eq. (25), shape (r, 1): the map is in the last output."""
    return np.eye(sample.y.size)[:, -1:]  # Eq. (25)
