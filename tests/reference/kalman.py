"""The extended Kalman filter of n + p states as textbooks have it: full matrices, all outputs at once."""

import numpy as np
from reference.membership import psi


def run(trajectory, time, point, grid, R, Q, map_drift, prior_map, x_0):
    """Return the map and the covariance of states and map after one segment; theta starts at zero."""
    p, n = grid.size, len(x_0)
    x = np.concatenate((x_0, np.zeros(p)))
    P = np.zeros((n + p, n + p))
    P[:n, :n], P[n:, n:] = np.diag(Q), prior_map**2 * np.eye(p)
    for k in range(len(time)):
        h = time[k] - time[k - 1] if k else 0.0
        row = psi(grid.fuel, grid.speed, point[0][k], point[1][k])
        F = np.eye(n + p)
        F[:n, :n] = np.linalg.inv(np.eye(n) - h * trajectory.A[k])  # Eq. (4)
        drive = np.zeros(n + p)
        drive[:n] = F[:n, :n] @ (h * trajectory.E[k])
        W = np.diag(np.concatenate((h * Q, h * map_drift**2 * (row > 0))))  # only nodes that take part drift
        x, P = F @ x + drive, F @ P @ F.T + W
        H = np.zeros((len(R), n + p))
        H[:, :n] = trajectory.C[k]
        H[-1, n:] = row
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(R))
        x = x + K @ (trajectory.y[k] - H @ x)
        P = (np.eye(n + p) - K @ H) @ P
    return x[n:], P
