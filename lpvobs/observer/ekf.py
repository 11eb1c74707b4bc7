"""The rival: map adaptation by an extended Kalman filter (the paper's references 9 to 11), 3 + p states.

The augmented state is (x, theta). The model of Eq. (24) is discretised by backward Euler like the observer's, theta is a random
walk. Nodes that take no part in the interpolation are not observable, and with process noise everywhere their variance grows
without bound; as in the references this growth is limited, here by giving process noise only to the nodes that take part.

Outputs are processed one after the other, so an update is one rank-one change of the covariance. Rows whose gain is exactly zero
(nodes that are not correlated with anything measured yet) are skipped, which changes no value.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from lpvobs.airpath.base import Trajectory
from lpvobs.maps.grid import Grid, local
from lpvobs.records import Array


@dataclass(frozen=True)
class KalmanSettings:
    """Tuning of the filter: the configuration's `[ekf]`.

    Attributes
    ----------
    measurement_noise : mapping of str to float
        Standard deviation of each output, sensor included, in its unit.
    process_noise : mapping of str to float
        Standard deviation of the drift of each state, per square root of a second.
    map_drift : float
        [kg/s per square root of a second], the same for a node that takes part.
    prior_map : float
        [kg/s], standard deviation of every node at the start.
    """

    measurement_noise: dict[str, float]
    process_noise: dict[str, float]
    map_drift: float
    prior_map: float

    def __post_init__(self) -> None:
        if not all(value > 0 for value in (*self.measurement_noise.values(), *self.process_noise.values())):
            raise ValueError("every measurement and process noise must be positive")
        if not (self.map_drift >= 0 and self.prior_map > 0):
            raise ValueError("map_drift must not be negative and prior_map must be positive")


@dataclass(frozen=True)
class KalmanState:
    """Map and covariance, carried from log to log.

    Attributes
    ----------
    theta : ndarray, shape (p,)
        [kg/s]
    P : ndarray, shape (3 + p, 3 + p)
        Covariance of states and nodes.
    """

    theta: Array
    P: Array


def start(grid: Grid, settings: KalmanSettings) -> KalmanState:
    """Return the state before any data."""
    P = np.zeros((3 + grid.size, 3 + grid.size))
    P[3:, 3:] = settings.prior_map**2 * np.eye(grid.size)
    return KalmanState(np.zeros(grid.size), P)


def adapt(
    state: KalmanState,
    trajectory: Trajectory,
    time: Array,
    segments: tuple[tuple[int, int], ...],
    operating_point: tuple[Array, Array],
    grid: Grid,
    measurement_variance: Array,
    process_variance: Array,
    map_drift: float,
    x_0: Array,
) -> KalmanState:
    """Return the filter's state after a log.

    Parameters
    ----------
    state : KalmanState
        Before the log.
    trajectory, time, segments, operating_point, grid
        As for `lpvobs.observer.recursion.observe`.
    measurement_variance : ndarray, shape (r,)
    process_variance : ndarray, shape (3,)
        Per second.
    map_drift : float
        [kg/s per square root of a second]
    x_0 : ndarray, shape (S, 3)
        States at the first sample of each segment; their variance there is one second of process noise.
    """
    theta, P = state.theta.copy(), state.P.copy()
    u_delta, n_e = operating_point
    for (begin, end), first in zip(segments, x_0, strict=True):
        part = slice(begin, end)
        P[:3, :] = 0.0
        P[:, :3] = 0.0
        P[:3, :3] = np.diag(process_variance)
        _filter(
            time[part],
            trajectory.A[part],
            trajectory.E[part],
            trajectory.C[part],
            trajectory.y[part],
            u_delta[part],
            n_e[part],
            grid.u_delta,
            grid.n_e,
            measurement_variance,
            process_variance,
            map_drift**2,
            first.copy(),
            theta,
            P,
        )
    return KalmanState(theta, P)


@njit(cache=True)
def _filter(  # type: ignore[no-untyped-def]
    time, A, E, C, y, u_delta, n_e, u_nodes, n_nodes, R, Q, q_map, x, theta, P
):
    N, r = y.shape
    nodes, weights, none = np.empty(4, dtype=np.int64), np.empty(4), np.zeros(4)
    PH, row = np.empty(P.shape[0]), np.empty((3, P.shape[0]))
    for k in range(N):
        h = time[k] - time[k - 1] if k > 0 else 0.0
        local(u_nodes, n_nodes, u_delta[k], n_e[k], nodes, weights)
        if h > 0.0:
            F = np.linalg.inv(np.eye(3) - h * A[k])
            x[:] = F @ (x + h * E[k])
            _predict(F, P, row)
            _drift(P, h, Q, q_map, nodes, weights)
        for o in range(r):
            _correct(x, theta, P, PH, C[k, o], nodes, weights if o == r - 1 else none, y[k, o], R[o])


@njit(cache=True)
def _drift(P, h, Q, q_map, nodes, weights):  # type: ignore[no-untyped-def]
    """Add the process noise of the states and of the nodes that take part."""
    for i in range(3):
        P[i, i] += h * Q[i]
    for m in range(4):
        if weights[m] > 0.0:
            P[3 + nodes[m], 3 + nodes[m]] += h * q_map


@njit(cache=True)
def _correct(x, theta, P, PH, c, nodes, weights, y, R):  # type: ignore[no-untyped-def]
    """Take in one scalar output y = c x + weights theta + noise of variance R."""
    PH[:] = 0.0
    innovation, S = y, R
    for j in range(3):
        if c[j] != 0.0:
            innovation -= c[j] * x[j]
            PH += c[j] * P[j]
    for m in range(4):
        if weights[m] > 0.0:
            innovation -= weights[m] * theta[nodes[m]]
            PH += weights[m] * P[3 + nodes[m]]
    for j in range(3):
        S += c[j] * PH[j]
    for m in range(4):
        S += weights[m] * PH[3 + nodes[m]]
    for i in range(PH.size):
        gain = PH[i] / S
        if gain == 0.0:
            continue
        if i < 3:
            x[i] += gain * innovation
        else:
            theta[i - 3] += gain * innovation
        for j in range(PH.size):
            P[i, j] -= gain * PH[j]


@njit(cache=True)
def _predict(F, P, row):  # type: ignore[no-untyped-def]
    """Replace P by diag(F, I) P diag(F, I)^T in place."""
    size = P.shape[0]
    for i in range(3):
        for j in range(size):
            row[i, j] = F[i, 0] * P[0, j] + F[i, 1] * P[1, j] + F[i, 2] * P[2, j]
    for i in range(3):
        for j in range(3, size):
            P[i, j] = row[i, j]
            P[j, i] = row[i, j]
    for i in range(3):
        for j in range(3):
            P[i, j] = row[i, 0] * F[j, 0] + row[i, 1] * F[j, 1] + row[i, 2] * F[j, 2]
