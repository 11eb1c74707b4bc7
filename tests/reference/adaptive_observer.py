"""Eq. (26) with the full Psi and Gamma, and Eq. (30) as one matrix: dense, slow, as printed."""

import numpy as np
from reference.membership import psi


def step(x, theta, h, A, E, C, y, L, gamma, row):
    """Return x and theta after one backward-Euler step of Eq. (26): 3 + p unknowns in one linear system."""
    n, p, r = len(x), len(theta), len(y)
    G = np.zeros((r, 1))
    G[r - 1] = 1.0
    Psi, Gamma, C_2 = row[None, :], gamma * np.eye(p), C[r - 1][None, :]
    left = np.block(
        [
            [np.eye(n) - h * (A - L @ C), h * L @ G @ Psi],
            [h * Gamma @ Psi.T @ C_2, np.eye(p) + h * Gamma @ Psi.T @ Psi],
        ]
    )
    right = np.concatenate((x + h * (E + L @ y), theta + h * (Gamma @ Psi.T)[:, 0] * y[r - 1]))
    found = np.linalg.solve(left, right)
    return found[:n], found[n:]


def observe(trajectory, time, point, grid, L, gamma, x_0, theta_0):
    """Return states (N, 3), the last map and the innovations (N,) along one segment."""
    x, theta = np.array(x_0, dtype=float), np.array(theta_0, dtype=float)
    states, innovations = [], []
    for k in range(len(time)):
        h = time[k] - time[k - 1] if k else 0.0
        A, E, C, y = (part[k] for part in (trajectory.A, trajectory.E, trajectory.C, trajectory.y))
        row = psi(grid.fuel, grid.speed, point[0][k], point[1][k])
        x, theta = step(x, theta, h, A, E, C, y, L, gamma, row)
        states.append(x)
        innovations.append(y[-1] - C[-1] @ x - row @ theta)
    return np.array(states), theta, np.array(innovations)


def error_matrix(A, C, L, gamma, row):
    """Return F of the error system dz/dt = F z, Eq. (30), z = (x_hat - x, theta_hat - theta)."""
    G = np.zeros((len(C), 1))
    G[-1] = 1.0
    Psi, C_2 = row[None, :], C[-1][None, :]
    return np.block([[A - L @ C, -L @ G @ Psi], [-gamma * Psi.T @ C_2, -gamma * Psi.T @ Psi]])
