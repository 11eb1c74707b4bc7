"""Eq. (26) with the full Psi and Gamma, one dense step after the other."""

import numpy as np
from reference.membership import psi

from lpvobs.observer.step import Sample, step


def sample_of(trajectory, k):
    """Return the system at one sample of a trajectory."""
    return Sample(*(part[k] for part in (trajectory.A, trajectory.E, trajectory.C, trajectory.y)))


def observe(trajectory, time, point, grid, L, gamma, x_0, theta_0):
    """Return states (N, n), the last map and the innovations (N,) along one segment."""
    x, theta = np.array(x_0, dtype=float), np.array(theta_0, dtype=float)
    states, innovations = [], []
    for k in range(len(time)):
        h = time[k] - time[k - 1] if k else 0.0
        row = psi(grid.fuel, grid.speed, point[0][k], point[1][k])
        x, theta = step(x, theta, h, sample_of(trajectory, k), L, gamma * np.eye(grid.size), row[None, :])
        states.append(x)
        innovations.append(trajectory.y[k, -1] - trajectory.C[k, -1] @ x - row @ theta)
    return np.array(states), theta, np.array(innovations)
