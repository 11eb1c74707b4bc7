"""The rival: map adaptation by an extended Kalman filter (the paper's references 9 to 11), n + p states.

The augmented state is (x, theta). The model of Eq. (24) is discretised by backward Euler like the observer's, theta is a random
walk. Nodes that take no part in the interpolation are not observable, and with process noise everywhere their variance grows
without bound; as in the references this growth is limited, here by giving process noise only to the nodes that take part.

Outputs are processed one after the other, each with what the ones before it have left of the covariance, but the covariance itself
is changed once per sample for all of them, and only its lower triangle: it is what costs, some 40 000 numbers for 195 nodes. Rows
whose gains are all exactly zero (nodes that are not correlated with anything measured yet) are skipped, which changes no value.
"""

from dataclasses import dataclass

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines.base import Trajectory
from lpvobs.maps.grid import Grid, local
from lpvobs.observer.inverse import ROW, invert
from lpvobs.records import Array


@dataclass(frozen=True)
class KalmanSettings:
    """Tuning of the filter: the configuration's `[ekf]`."""

    measurement_noise: dict[str, float]  # standard deviation of each output, sensor included, in its unit
    process_noise: dict[str, float]  # standard deviation of the drift of each state, per square root of a second
    map_drift: float  # [kg/s per square root of a second], the same for a node that takes part
    prior_map: float  # [kg/s], standard deviation of every node at the start

    def __post_init__(self) -> None:
        if not all(value > 0 for value in (*self.measurement_noise.values(), *self.process_noise.values())):
            raise ValueError("every value of measurement_noise and process_noise must be positive")
        if not (self.map_drift >= 0 and self.prior_map > 0):
            raise ValueError("map_drift must not be negative and prior_map must be positive")


@dataclass(frozen=True)
class KalmanState:
    """Map and covariance, carried from log to log."""

    theta: Array  # (p,) [kg/s]
    P: Array  # (n + p, n + p) covariance of states and nodes


def start(grid: Grid, settings: KalmanSettings, n: int) -> KalmanState:
    """Return the filter's state for n states of the engine before any data."""
    P = np.zeros((n + grid.size, n + grid.size))
    P[n:, n:] = settings.prior_map**2 * np.eye(grid.size)
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
    """Return the filter's state after a log, from that before it; other arguments as for `lpvobs.observer.recursion.observe`.

    The variances of measurements have shape (r,), those of the process (n,), per second; the drift of the map is in [kg/s per
    square root of a second]. `x_0`, shape (S, n), are the states at the first sample of each segment; their variance there is
    one second of process noise.
    """
    theta, P = state.theta.copy(), state.P.copy()  # of P, the lower triangle is kept up to date
    fuel, speed = operating_point
    r, n = trajectory.C.shape[1:]
    for (begin, end), first in zip(segments, x_0, strict=True):
        part = slice(begin, end)
        P[:, :n] = 0.0
        P[:n, :n] = np.diag(process_variance)
        system = (trajectory.A, trajectory.E, trajectory.C, trajectory.y)
        A, E, C, y = (np.ascontiguousarray(each[part]) for each in system)
        _filter(
            time[part], A, E, C, y, fuel[part], speed[part], grid.fuel, grid.speed, measurement_variance,
            process_variance, map_drift**2, tuple(first.tolist()), (0.0,) * r, theta, P,
        )  # fmt: skip
    return KalmanState(theta, np.tril(P) + np.tril(P, -1).T)


@njit(cache=True)
def _filter(  # type: ignore[no-untyped-def]
    time, A, E, C, y, fuel, speed, u_nodes, n_nodes, R, Q, q_map, first, outputs, theta, P
):
    """Move theta and P in place along one segment; the lengths of `first` and `outputs` are constants to the compiler."""
    n, r = len(first), len(outputs)
    nodes, weights, none = np.empty(4, dtype=np.int64), np.empty(4), np.zeros(4)
    PH, S, x, driven = np.zeros((r, P.shape[0])), np.ones(r), np.array(first), np.empty(n)
    M, F, spare, t = np.empty((n, n, ROW)), np.empty((n, n, ROW)), np.empty((n, n, ROW)), np.empty(ROW)
    for k in range(time.size):
        q = k % ROW
        if q == 0:
            for m in range(min(ROW, time.size - k)):
                h = time[k + m] - time[k + m - 1] if k + m > 0 else 0.0
                for i in range(n):
                    for j in range(n):
                        M[i, j, m] = (1.0 if i == j else 0.0) - h * A[k + m, i, j]
            F, spare = invert(first, M, F, spare, t)
        h = time[k] - time[k - 1] if k > 0 else 0.0
        local(u_nodes, n_nodes, fuel[k], speed[k], nodes, weights)
        if h > 0.0:
            for i in range(n):
                driven[i] = x[i] + h * E[k, i]
            for i in range(n):
                x[i] = 0.0
                for j in range(n):
                    x[i] += F[i, j, q] * driven[j]  # Eq. (4)
            _predict(first, F[:, :, q], P)
            _drift(P, h, Q, q_map, nodes, weights)
        for o in range(r):
            _take_in(x, theta, P, PH, S, o, C[k, o], nodes, weights if o == r - 1 else none, y[k, o], R[o])
        _update(P, PH, S, outputs)


@njit(cache=True)
def _drift(P, h, Q, q_map, nodes, weights):  # type: ignore[no-untyped-def]
    """Add the process noise of the states and of the nodes that take part."""
    for i in range(Q.size):
        P[i, i] += h * Q[i]
    for m in range(4):
        if weights[m] > 0.0:
            P[Q.size + nodes[m], Q.size + nodes[m]] += h * q_map


@njit(cache=True)
def _take_in(  # type: ignore[no-untyped-def] # noqa: PLR0912 loops over states and nodes
    x, theta, P, PH, S, o, c, nodes, weights, y, R
):
    """Correct states and map by output o, y = c x + weights theta + noise of variance R; leave its P H and S for the update."""
    n, row = x.size, PH[o]
    row[:] = 0.0
    innovation, spread = y, R
    for j in range(n):
        if c[j] != 0.0:
            innovation -= c[j] * x[j]
            _add_row(P, j, c[j], row)
    for m in range(4):
        if weights[m] > 0.0:
            innovation -= weights[m] * theta[nodes[m]]
            _add_row(P, n + nodes[m], weights[m], row)
    for earlier in range(o):  # what the outputs before it have taken from P
        other = PH[earlier]
        taken = 0.0
        for j in range(n):
            taken += c[j] * other[j]
        for m in range(4):
            taken += weights[m] * other[n + nodes[m]]
        taken /= S[earlier]
        if taken != 0.0:
            for i in range(row.size):
                row[i] -= taken * other[i]
    for j in range(n):
        spread += c[j] * row[j]
    for m in range(4):
        spread += weights[m] * row[n + nodes[m]]
    S[o] = spread
    push = innovation / spread
    for i in range(n):
        x[i] += row[i] * push
    for i in range(theta.size):
        theta[i] += row[n + i] * push


@njit(cache=True)
def _add_row(P, i, factor, row):  # type: ignore[no-untyped-def]
    """Add factor times row i of the symmetric P to a row."""
    for j in range(i + 1):
        row[j] += factor * P[i, j]
    for j in range(i + 1, row.size):
        row[j] += factor * P[j, i]


@njit(cache=True)
def _update(P, PH, S, outputs):  # type: ignore[no-untyped-def]
    """Take the information of all outputs from the lower triangle of P."""
    r, gain = len(outputs), np.empty(len(outputs))
    for i in range(P.shape[0]):
        known = False
        for o in range(r):
            gain[o] = PH[o, i] / S[o]
            known |= gain[o] != 0.0
        if known:
            target = P[i]
            for j in range(i + 1):
                total = 0.0
                for o in range(r):
                    total += gain[o] * PH[o, j]
                target[j] -= total


@njit(cache=True)
def _predict(states, F, P):  # type: ignore[no-untyped-def]
    """Replace P by diag(F, I) P diag(F, I)^T in its lower triangle."""
    n, row = len(states), np.empty(len(states))
    for i in range(n):  # the block of the states, first P F^T, then F times that
        for j in range(i):
            P[j, i] = P[i, j]
    for i in range(P.shape[0]):
        for j in range(n):
            row[j] = P[i, j]
        for j in range(n):
            total = 0.0
            for m in range(n):
                total += F[j, m] * row[m]
            P[i, j] = total
    for j in range(n):
        for i in range(n):
            row[i] = P[i, j]
        for i in range(j, n):
            total = 0.0
            for m in range(n):
                total += F[i, m] * row[m]
            P[i, j] = total
