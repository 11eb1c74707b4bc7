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
from lpvobs.maps.excitation import steps_of
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
    steps, (r, n) = steps_of(time, segments), trajectory.C.shape[1:]
    z, P = np.concatenate((np.empty(n), state.theta)), state.P.copy()  # of P, the lower triangle is kept up to date
    for (begin, end), first in zip(segments, x_0, strict=True):
        part = slice(begin, end)
        z[:n], P[:, :n] = first, 0.0
        P[:n, :n] = np.diag(process_variance)
        system = (trajectory.E, trajectory.C, trajectory.y)
        E, C, y = (np.ascontiguousarray(each[part]) for each in system)
        fuel, speed = (axis[part] for axis in operating_point)
        h = steps[part]
        backward = np.eye(n) - h[:, None, None] * trajectory.A[part]
        _filter(
            h, backward, E, C, y, fuel, speed, grid.fuel, grid.speed, measurement_variance, process_variance,
            map_drift**2, (0.0,) * n, (0.0,) * r, z, P,
        )  # fmt: skip
    return KalmanState(z[n:], np.tril(P) + np.tril(P, -1).T)


@njit(cache=True)
def _filter(  # type: ignore[no-untyped-def]
    steps, backward, E, C, y, fuel, speed, u_nodes, n_nodes, R, Q, q_map, states, outputs, z, P
):
    """Move z = (x, theta) and P in place along one segment; the lengths of `states` and `outputs` are known to the compiler."""
    n, r = len(states), len(outputs)
    nodes, weights = np.empty(4, dtype=np.int64), np.empty(4)
    at, H = np.arange(n + 4), np.zeros(n + 4)  # the numbers in z that take part in an output, and how much
    PH, S, old = np.zeros((r, P.shape[0])), np.ones(r), np.empty(n)
    M, F, spare, t = np.empty((n, n, ROW)), np.empty((n, n, ROW)), np.empty((n, n, ROW)), np.empty(ROW)
    for k in range(steps.size):
        h, q = steps[k], k % ROW
        if q == 0:
            M[:, :, : min(ROW, steps.size - k)] = backward[k : k + ROW].transpose(1, 2, 0)
            F, spare = invert(states, M, F, spare, t)
        local(u_nodes, n_nodes, fuel[k], speed[k], nodes, weights)
        at[n:] = n + nodes
        if h > 0.0:
            for i in range(n):
                z[i] += h * E[k, i]
            _turn(states, F[:, :, q], z, old)  # Eq. (4)
            _predict(states, F[:, :, q], P, old)
            for i in range(n):
                P[i, i] += h * Q[i]
            for m in range(4):
                if weights[m] > 0.0:
                    P[at[n + m], at[n + m]] += h * q_map
        for o in range(r):
            H[:n] = C[k, o]
            H[n:] = weights if o == r - 1 else 0.0 * weights
            _take_in(z, P, PH, S, o, at, H, y[k, o], R[o])
        _update(P, PH, S, outputs)


@njit(cache=True)
def _take_in(z, P, PH, S, o, at, H, y, R):  # type: ignore[no-untyped-def]
    """Correct z by output o, y = H z[at] + noise of variance R; leave its P H and S for the update."""
    row = PH[o]
    row[:] = 0.0
    innovation, spread = y, R
    for m in range(at.size):
        if H[m] != 0.0:
            innovation -= H[m] * z[at[m]]
            _add_row(P, at[m], H[m], row)
    for earlier in range(o):  # what the outputs before it have taken from P
        taken = 0.0
        for m in range(at.size):
            taken += H[m] * PH[earlier, at[m]]
        taken /= S[earlier]
        if taken != 0.0:
            row -= taken * PH[earlier]
    for m in range(at.size):
        spread += H[m] * row[at[m]]
    S[o] = spread
    z += row * (innovation / spread)


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
        for o in range(r):
            gain[o] = PH[o, i] / S[o]
        if gain.any():
            target = P[i]
            for j in range(i + 1):
                total = 0.0
                for o in range(r):
                    total += gain[o] * PH[o, j]
                target[j] -= total


@njit(cache=True)
def _predict(states, F, P, old):  # type: ignore[no-untyped-def]
    """Replace P by diag(F, I) P diag(F, I)^T in its lower triangle."""
    n = len(states)
    for i in range(n):  # the block of the states, first P F^T, then F times that
        P[:i, i] = P[i, :i]
    for i in range(P.shape[0]):
        _turn(states, F, P[i], old)
    for j in range(n):
        _turn(states, F, P[:, j], old)


@njit(cache=True)
def _turn(states, F, row, old):  # type: ignore[no-untyped-def]
    """Multiply the first numbers of a row or column by F."""
    n = len(states)
    for i in range(n):
        old[i] = row[i]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += F[i, j] * old[j]
        row[i] = total
