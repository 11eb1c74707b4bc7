"""The rival: map adaptation by an extended Kalman filter (the paper's references 9 to 11), 3 + p states.

The augmented state is (x, theta). The model of Eq. (24) is discretised by backward Euler like the observer's, theta is a random
walk. Nodes that take no part in the interpolation are not observable, and with process noise everywhere their variance grows
without bound; as in the references this growth is limited, here by giving process noise only to the nodes that take part.

Outputs are processed one after the other, each with what the ones before it have left of the covariance, but the covariance itself
is changed once per sample for all of them, and only its lower triangle: it is what costs, some 40 000 numbers for 195 nodes. Rows
whose gains are all exactly zero (nodes that are not correlated with anything measured yet) are skipped, which changes no value.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from lpvobs.engines.base import Trajectory
from lpvobs.maps.grid import Grid, local
from lpvobs.records import Array

MOST_OUTPUTS = 4
"""Three states and the sensor; the update of the covariance takes them together."""


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
    theta, P = state.theta.copy(), state.P.copy()  # of P, the lower triangle is kept up to date
    u_delta, n_e = operating_point
    for (begin, end), first in zip(segments, x_0, strict=True):
        part = slice(begin, end)
        P[:, :3] = 0.0
        P[:3, :3] = np.diag(process_variance)
        _filter(
            time[part],
            np.ascontiguousarray(trajectory.A[part]),
            np.ascontiguousarray(trajectory.E[part]),
            np.ascontiguousarray(trajectory.C[part]),
            np.ascontiguousarray(trajectory.y[part]),
            u_delta[part],
            n_e[part],
            grid.fuel,
            grid.speed,
            measurement_variance,
            process_variance,
            map_drift**2,
            first.copy(),
            theta,
            P,
        )
    return KalmanState(theta, np.tril(P) + np.tril(P, -1).T)


@njit(cache=True)
def _filter(  # type: ignore[no-untyped-def]
    time, A, E, C, y, u_delta, n_e, u_nodes, n_nodes, R, Q, q_map, x, theta, P
):
    N, r = y.shape
    nodes, weights, none = np.empty(4, dtype=np.int64), np.empty(4), np.zeros(4)
    PH, S, F = np.zeros((MOST_OUTPUTS, P.shape[0])), np.ones(MOST_OUTPUTS), np.empty((3, 3))
    for k in range(N):
        h = time[k] - time[k - 1] if k > 0 else 0.0
        local(u_nodes, n_nodes, u_delta[k], n_e[k], nodes, weights)
        if h > 0.0:
            _step(A[k], h, F)
            x0, x1, x2 = x[0] + h * E[k, 0], x[1] + h * E[k, 1], x[2] + h * E[k, 2]
            for i in range(3):
                x[i] = F[i, 0] * x0 + F[i, 1] * x1 + F[i, 2] * x2
            _predict(F, P)
            _drift(P, h, Q, q_map, nodes, weights)
        for o in range(r):
            _take_in(x, theta, P, PH, S, o, C[k, o], nodes, weights if o == r - 1 else none, y[k, o], R[o])
        _update(P, PH, S)


@njit(cache=True)
def _step(A, h, F):  # type: ignore[no-untyped-def]
    """Fill F with the inverse of I - h A, by cofactors."""
    m00, m01, m02 = 1.0 - h * A[0, 0], -h * A[0, 1], -h * A[0, 2]
    m10, m11, m12 = -h * A[1, 0], 1.0 - h * A[1, 1], -h * A[1, 2]
    m20, m21, m22 = -h * A[2, 0], -h * A[2, 1], 1.0 - h * A[2, 2]
    F[0, 0], F[0, 1], F[0, 2] = m11 * m22 - m12 * m21, m02 * m21 - m01 * m22, m01 * m12 - m02 * m11
    F[1, 0], F[1, 1], F[1, 2] = m12 * m20 - m10 * m22, m00 * m22 - m02 * m20, m02 * m10 - m00 * m12
    F[2, 0], F[2, 1], F[2, 2] = m10 * m21 - m11 * m20, m01 * m20 - m00 * m21, m00 * m11 - m01 * m10
    inverse = 1.0 / (m00 * F[0, 0] + m01 * F[1, 0] + m02 * F[2, 0])
    for i in range(3):
        for j in range(3):
            F[i, j] *= inverse


@njit(cache=True)
def _drift(P, h, Q, q_map, nodes, weights):  # type: ignore[no-untyped-def]
    """Add the process noise of the states and of the nodes that take part."""
    for i in range(3):
        P[i, i] += h * Q[i]
    for m in range(4):
        if weights[m] > 0.0:
            P[3 + nodes[m], 3 + nodes[m]] += h * q_map


@njit(cache=True)
def _take_in(  # type: ignore[no-untyped-def] # noqa: PLR0912 loops over three states and four nodes
    x, theta, P, PH, S, o, c, nodes, weights, y, R
):
    """Correct states and map by output o, y = c x + weights theta + noise of variance R; leave its P H and S for the update."""
    row = PH[o]
    row[:] = 0.0
    innovation, spread = y, R
    for j in range(3):
        if c[j] != 0.0:
            innovation -= c[j] * x[j]
            _add_row(P, j, c[j], row)
    for m in range(4):
        if weights[m] > 0.0:
            innovation -= weights[m] * theta[nodes[m]]
            _add_row(P, 3 + nodes[m], weights[m], row)
    for earlier in range(o):  # what the outputs before it have taken from P
        other = PH[earlier]
        taken = 0.0
        for j in range(3):
            taken += c[j] * other[j]
        for m in range(4):
            taken += weights[m] * other[3 + nodes[m]]
        taken /= S[earlier]
        if taken != 0.0:
            for i in range(row.size):
                row[i] -= taken * other[i]
    for j in range(3):
        spread += c[j] * row[j]
    for m in range(4):
        spread += weights[m] * row[3 + nodes[m]]
    S[o] = spread
    push = innovation / spread
    for i in range(3):
        x[i] += row[i] * push
    for i in range(theta.size):
        theta[i] += row[3 + i] * push


@njit(cache=True)
def _add_row(P, i, factor, row):  # type: ignore[no-untyped-def]
    """Add factor times row i of the symmetric P to a row."""
    for j in range(i + 1):
        row[j] += factor * P[i, j]
    for j in range(i + 1, row.size):
        row[j] += factor * P[j, i]


@njit(cache=True)
def _update(P, PH, S):  # type: ignore[no-untyped-def]
    """Take the information of all outputs from the lower triangle of P."""
    a, b, c, d = PH[0], PH[1], PH[2], PH[3]
    for i in range(a.size):
        ga, gb, gc, gd = a[i] / S[0], b[i] / S[1], c[i] / S[2], d[i] / S[3]
        if ga == 0.0 and gb == 0.0 and gc == 0.0 and gd == 0.0:
            continue
        target = P[i]
        for j in range(i + 1):
            target[j] -= (ga * a[j] + gb * b[j]) + (gc * c[j] + gd * d[j])


@njit(cache=True)
def _predict(F, P):  # type: ignore[no-untyped-def]
    """Replace P by diag(F, I) P diag(F, I)^T in its lower triangle."""
    p00, p10, p20 = P[0, 0], P[1, 0], P[2, 0]
    p11, p21, p22 = P[1, 1], P[2, 1], P[2, 2]
    for i in range(3):
        r0 = F[i, 0] * p00 + F[i, 1] * p10 + F[i, 2] * p20
        r1 = F[i, 0] * p10 + F[i, 1] * p11 + F[i, 2] * p21
        r2 = F[i, 0] * p20 + F[i, 1] * p21 + F[i, 2] * p22
        for j in range(i + 1):
            P[i, j] = r0 * F[j, 0] + r1 * F[j, 1] + r2 * F[j, 2]
    for i in range(3, P.shape[0]):
        q0, q1, q2 = P[i, 0], P[i, 1], P[i, 2]
        for j in range(3):
            P[i, j] = F[j, 0] * q0 + F[j, 1] * q1 + F[j, 2] * q2
