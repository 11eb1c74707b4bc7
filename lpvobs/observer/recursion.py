"""The adaptive observer of Eq. (26) in its local form, Eq. (36), discretised by backward Euler and compiled.

One step is `lpvobs.observer.step.local_step`, and tests hold the two together. Here the step is worked out ahead of its turn, for
neighbouring samples side by side. With e = y_m2 - C_2 x - Psi theta after the step and the old x and theta,

    M = I - h (A - L C),   x = M^-1 (x_old + h (E + L y_m)) - h M^-1 L G Psi theta,   theta = theta_old + h Gamma Psi^T e,

so that with a = y_m2 - C_2 M^-1 (x_old + h (E + L y_m)), b = 1 - h C_2 M^-1 L G and g = h Psi Gamma Psi^T

    e = (a - b Psi theta_old) / (1 + b g),

and one sample waits for the one before it in a few multiplications only. L_11 = 1636 1/s and Gamma = 200 1/s against samples
10 ms apart: explicit Euler diverges.

What the Lyapunov argument promises of this step. For the homogeneous error recursion z+ = z + h F z+ with Gamma constant and
S = diag(P, Gamma^-1), V = z^T S z obeys V(z+) - V(z) = h z+^T (F^T S + S F) z+ - h^2 (F z+)^T S (F z+), so the inequality of
Theorem 1 at the new sample makes V fall at any h, also with matrices that change from sample to sample. What it does not
promise: on a recorded log the truncation of the step, the noise and the error in rho enter as inputs. Then V is bounded, not
falling; an exactly integrated plant sampled at 10 ms shows it rise now and then.

Departure from the paper: none in the equations; the discretisation is ours, the paper does not state one.
"""

from dataclasses import dataclass

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines.base import Trajectory
from lpvobs.maps.excitation import steps_of
from lpvobs.maps.grid import Grid, reach, seek
from lpvobs.observer.inverse import ROW, invert, product
from lpvobs.records import Array


@dataclass(frozen=True)
class ObserverRun:
    """What the observer saw along a log of N samples, with n states."""

    x: Array  # (N, n) state estimates
    theta: Array  # (p,) the map at the end, [kg/s]
    innovation: Array  # (N,) y_m2 - C_2 x - Psi theta, [kg/s], after each update; NaN where the sensor says nothing


def observe(
    trajectory: Trajectory,
    time: Array,
    segments: tuple[tuple[int, int], ...],
    operating_point: tuple[Array, Array],
    grid: Grid,
    L: Array,
    gamma: float,
    x_0: Array,
    theta_0: Array,
    before: float | None = None,
) -> ObserverRun:
    """Run the observer over the segments of a log; the map is carried on, the state is not.

    The trajectory has N samples, n states, r outputs; an output that is NaN at a sample corrects nothing there. Time, shape (N,),
    is in s, the operating point fuel [mg/cycle] and speed [rpm], shape (N,) each; L has the shape (n, r). Gamma = gamma I [1/s]
    and zero freezes the map. x_0, shape (S, n), is the state at the first sample of each of S segments, theta_0, shape (p,), the
    first map. With `before` [s] the first segment goes on from a sample at this time, and the first row of x_0 is the state there;
    by default it begins: its first sample stands for no time.
    """
    # Samples last, so that neighbouring ones lie beside each other; no copy where they do already.
    A, C = (np.ascontiguousarray(matrix.transpose(1, 2, 0)) for matrix in (trajectory.A, trajectory.C))
    E, y = np.ascontiguousarray(trajectory.E.T), np.ascontiguousarray(trajectory.y.T)
    reading, steady = y[-1], trajectory.steady
    if np.isnan(y.sum()):
        C, y, steady = np.where(np.isnan(y)[:, None], 0.0, C), np.where(np.isnan(y), 0.0, y), 0
    system, nodes, L = (A, E, C, y, reading, steady), (grid.fuel, grid.speed), np.ascontiguousarray(L, dtype=float)
    x, innovation, theta = np.empty((C.shape[1], time.size)), np.empty(time.size), theta_0.copy()
    steps = steps_of(time, segments)
    if before is not None:
        steps[0] = time[0] - before
    for (start, stop), first in zip(segments, x_0, strict=True):
        state = tuple(first.tolist())
        _recursion(start, stop, steps, system, operating_point, nodes, L, gamma, state, theta, x, innovation)
    return ObserverRun(x.T, theta, innovation)


@njit(cache=True)
def _recursion(  # type: ignore[no-untyped-def]
    start, stop, steps, system, point, nodes, L, gamma, first, theta, x, innovation
):
    """Fill x and innovation and move theta in place along one segment.

    The four nodes stay out of memory as long as their cell, so that a sample waits less for the one before it. Where the sensor
    does not correct the state, the state does not wait for the map either.
    """
    (A, E, C, y, reading, steady), (fuel, speed), (u_nodes, n_nodes) = system, point, nodes
    n, last = len(first), L.shape[1] - 1
    cascade = not L[:, last].any()
    t = np.empty(ROW)
    M, T, spare = np.empty((n, n, ROW)), np.empty((n, n, ROW)), np.empty((n, n, ROW))
    drive, push, lent, b = np.empty((n, 1, ROW)), np.empty((n, 1, ROW)), np.empty((n, ROW)), np.ones(ROW)
    old, new = np.array(first), np.empty(n)
    p_1, i_u, j_n, node = u_nodes.size, 0, 0, 0
    u_low, u_high, n_low, n_high = np.inf, -np.inf, np.inf, -np.inf  # no cell yet
    u_first, u_share, n_first, n_share = 0.0, 0.0, 0.0, 0.0
    t0, t1, t2, t3 = theta[0], theta[1], theta[p_1], theta[p_1 + 1]
    for s in range(start, stop, ROW):
        N = min(ROW, stop - s)
        h = steps[s : s + N]
        _closed_loop(s, N, h, A, E, C, y, steady, L, M, drive)
        T, spare = invert(first, M, T, spare, t)
        product(first, T, drive, push)
        C_2, x_out = C[last, :, s : s + N], x[:, s : s + N]
        u_here, n_here, y_2, e_out = fuel[s : s + N], speed[s : s + N], reading[s : s + N], innovation[s : s + N]
        if not cascade:
            _of_the_map(s, N, first, h, T, L[:, last], C[last], lent, b)
        for k in range(N):
            u, v = u_here[k], n_here[k]
            if u <= u_low or u > u_high or v <= n_low or v > n_high:
                theta[node], theta[node + 1], theta[node + p_1], theta[node + p_1 + 1] = t0, t1, t2, t3
                i_u, j_n = seek(u_nodes, u, i_u), seek(n_nodes, v, j_n)
                node = j_n * p_1 + i_u
                t0, t1, t2, t3 = theta[node], theta[node + 1], theta[node + p_1], theta[node + p_1 + 1]
                u_low, u_high, u_first, u_share = reach(u_nodes, i_u)
                n_low, n_high, n_first, n_share = reach(n_nodes, j_n)
            eta_1 = min(max((u - u_first) * u_share, 0.0), 1.0)
            eta_2 = min(max((v - n_first) * n_share, 0.0), 1.0)
            w0, w1 = (1.0 - eta_1) * (1.0 - eta_2), eta_1 * (1.0 - eta_2)
            w2, w3 = (1.0 - eta_1) * eta_2, eta_1 * eta_2
            a = y_2[k]
            for i in range(n):
                total = push[i, 0, k]
                for j in range(n):
                    total += T[i, j, k] * old[j]  # Eq. (36)
                new[i] = total
                a -= C_2[i, k] * total
            known = (w0 * t0 + w1 * t1) + (w2 * t2 + w3 * t3)
            g = h[k] * gamma * ((w0 * w0 + w1 * w1) + (w2 * w2 + w3 * w3))
            e = (a - b[k] * known) * (1.0 / (1.0 + b[k] * g))  # the reciprocal waits for no other sample
            e_out[k] = e
            if not np.isnan(e):  # otherwise the sensor says nothing
                if not cascade:
                    for i in range(n):
                        new[i] -= lent[i, k] * (known + g * e)
                step = h[k] * gamma * e
                t0, t1, t2, t3 = t0 + step * w0, t1 + step * w1, t2 + step * w2, t3 + step * w3  # Eq. (36)
            for i in range(n):
                old[i] = new[i]
                x_out[i, k] = new[i]
    theta[node], theta[node + 1], theta[node + p_1], theta[node + p_1 + 1] = t0, t1, t2, t3


@njit(cache=True)
def _closed_loop(s, N, h, A, E, C, y, steady, L, M, drive):  # type: ignore[no-untyped-def]
    """Fill M = I - h (A - L C) and drive = h (E + L y) for N samples from s on; C of the first `steady` outputs does not change."""
    n, r = L.shape
    for i in range(n):
        for j in range(n):
            row, given, constant, unit = M[i, j], A[i, j, s : s + N], 0.0, 1.0 if i == j else 0.0
            for o in range(steady):
                constant += L[i, o] * C[o, j, s]
            for k in range(N):
                row[k] = unit + h[k] * (constant - given[k])
            for o in range(steady, r):
                _add(N, h, L[i, o], C[o, j, s : s + N], row)
        row, given = drive[i, 0], E[i, s : s + N]
        for k in range(N):
            row[k] = h[k] * given[k]
        for o in range(r):
            _add(N, h, L[i, o], y[o, s : s + N], row)


@njit(cache=True)
def _add(N, h, gain, given, row):  # type: ignore[no-untyped-def]
    if gain != 0.0:
        for k in range(N):
            row[k] += h[k] * gain * given[k]


@njit(cache=True)
def _of_the_map(s, N, states, h, T, column, C_2, lent, b):  # type: ignore[no-untyped-def]
    """Fill lent = h T L G, by which the map moves the state, and b = 1 - C_2 lent."""
    n = len(states)
    b[:N] = 1.0
    for i in range(n):
        row, given = lent[i], C_2[i, s : s + N]
        for k in range(N):
            total = 0.0
            for j in range(n):
                total += T[i, j, k] * column[j]
            row[k] = h[k] * total
        for k in range(N):
            b[k] -= given[k] * row[k]
