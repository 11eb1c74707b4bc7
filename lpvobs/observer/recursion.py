"""The adaptive observer of Eq. (26) in its local form, Eq. (36), discretised by backward Euler.

With the innovation e = y_m2 - C_2 x - s and s = Psi theta, all at the new sample, one step of length h solves

    (I - h A + h L C) x + h L G s       = x_old + h (E + L y_m)
    h g C_2 x           + (1 + h g) s   = Psi theta_old + h g y_m2,        g = Psi Gamma Psi^T,

four equations for three states and s, and then moves the four nodes around the operating point by h Gamma Psi^T e.
L_11 = 1636 1/s and Gamma = 200 1/s against samples 10 ms apart: explicit Euler diverges.

What the Lyapunov argument promises of this step. For the homogeneous error recursion z+ = z + h F z+ with Gamma constant and
S = diag(P, Gamma^-1), V = z^T S z obeys V(z+) - V(z) = h z+^T (F^T S + S F) z+ - h^2 (F z+)^T S (F z+), so the inequality of
Theorem 1 at the new sample makes V fall at any h, also with matrices that change from sample to sample. What it does not
promise: on a recorded log the truncation of the step, the noise and the error in rho enter as inputs. Then V is bounded, not
falling; an exactly integrated plant sampled at 10 ms shows it rise now and then.

Departure from the paper: none in the equations; the discretisation is ours, the paper does not state one.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from lpvobs.engines.base import Trajectory
from lpvobs.maps.grid import Grid, reach, seek
from lpvobs.records import Array

ROW = 128
"""Samples whose matrices are inverted side by side: few enough that they stay in the cache nearest to the processor."""


@dataclass(frozen=True)
class ObserverRun:
    """What the observer saw along a log of N samples.

    Attributes
    ----------
    x : ndarray, shape (N, 3)
        State estimates.
    theta : ndarray, shape (p,)
        The map at the end, [kg/s].
    innovation : ndarray, shape (N,)
        y_m2 - C_2 x - Psi theta, [kg/s], after each update.
    """

    x: Array
    theta: Array
    innovation: Array


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

    Parameters
    ----------
    trajectory : Trajectory
        N samples, r outputs.
    time : ndarray, shape (N,)
        [s]
    segments : tuple of (start, stop)
    operating_point : tuple of two ndarrays, shape (N,)
        Fuel [mg/cycle] and speed [rpm].
    grid : Grid
        p nodes.
    L : ndarray, shape (3, r)
    gamma : float
        Gamma = gamma I, [1/s]; zero freezes the map.
    x_0 : ndarray, shape (S, 3)
        State at the first sample of each of S segments.
    theta_0 : ndarray, shape (p,)
    before : float, optional
        [s]; the first segment goes on from a sample at this time, and the first row of x_0 is the state there. By default it
        begins: its first sample stands for no time.

    Returns
    -------
    ObserverRun
    """
    x = np.empty((3, time.size))
    innovation = np.empty(time.size)
    theta = theta_0.copy()
    u_delta, n_e = operating_point
    L = np.ascontiguousarray(L, dtype=float)
    # samples last; no copy where they lie beside each other in memory
    A, E = np.ascontiguousarray(trajectory.A.transpose(1, 2, 0)), np.ascontiguousarray(trajectory.E.T)
    C, y = np.ascontiguousarray(trajectory.C.transpose(1, 2, 0)), np.ascontiguousarray(trajectory.y.T)
    for (start, stop), first in zip(segments, x_0, strict=True):
        _recursion(
            time[start] if before is None or start > 0 else before,
            start,
            stop,
            time,
            A,
            E,
            C,
            y,
            trajectory.steady,
            u_delta,
            n_e,
            grid.fuel,
            grid.speed,
            L,
            gamma,
            np.ascontiguousarray(first),
            theta,
            x,
            innovation,
        )
    return ObserverRun(x.T, theta, innovation)


@njit(cache=True, error_model="numpy")
def _recursion(  # type: ignore[no-untyped-def] # noqa: PLR0915 straight-line arithmetic
    before, start, stop, time, A, E, C, y, steady, u_delta, n_e, u_nodes, n_nodes, L, gamma, x_0, theta, x, innovation
):
    """Fill x and innovation and move theta in place along one segment.

    The state's block is inverted before its turn comes, for neighbouring samples side by side: with x = T (x_old + h f) - h per s
    the fourth equation gives e in closed form, so that one sample waits for the one before in a few multiplications only. For the
    same reason the four nodes stay out of memory as long as their cell. Nothing is allocated but the room for T.
    """
    last = L.shape[1] - 1
    b0, b1, b2 = L[0, last], L[1, last], L[2, last]
    cascade = b0 == 0.0 and b1 == 0.0 and b2 == 0.0
    used = last if cascade else last + 1
    room, T = np.empty(13 * ROW), np.empty(12 * ROW)
    x_0_, x_1_, x_2_ = x_0[0], x_0[1], x_0[2]
    p_1 = u_nodes.size
    i, j, node = 0, 0, 0
    u_low, u_high, n_low, n_high = np.inf, -np.inf, np.inf, -np.inf  # no cell yet
    u_first, u_share, n_first, n_share = 0.0, 0.0, 0.0, 0.0
    t0, t1, t2, t3 = theta[0], theta[1], theta[p_1], theta[p_1 + 1]
    for s in range(start, stop, ROW):
        N = min(ROW, stop - s)
        _collect(before, s, N, time, A, E, C, y, steady, used, L, room)
        _invert(N, room, T)
        before = time[s + N - 1]
        fuel, speed, reading, e_out = u_delta[s : s + N], n_e[s : s + N], y[last, s : s + N], innovation[s : s + N]
        q_0, q_1, q_2 = C[last, 0, s : s + N], C[last, 1, s : s + N], C[last, 2, s : s + N]
        x_0_out, x_1_out, x_2_out = x[0, s : s + N], x[1, s : s + N], x[2, s : s + N]
        for k in range(N):
            # the map at the operating point
            u, n = fuel[k], speed[k]
            if u <= u_low or u > u_high or n <= n_low or n > n_high:
                theta[node], theta[node + 1], theta[node + p_1], theta[node + p_1 + 1] = t0, t1, t2, t3
                i, j = seek(u_nodes, u, i), seek(n_nodes, n, j)
                node = j * p_1 + i
                t0, t1, t2, t3 = theta[node], theta[node + 1], theta[node + p_1], theta[node + p_1 + 1]
                u_low, u_high, u_first, u_share = reach(u_nodes, i)
                n_low, n_high, n_first, n_share = reach(n_nodes, j)
            eta_1 = min(max((u - u_first) * u_share, 0.0), 1.0)
            eta_2 = min(max((n - n_first) * n_share, 0.0), 1.0)
            w0, w1 = (1.0 - eta_1) * (1.0 - eta_2), eta_1 * (1.0 - eta_2)
            w2, w3 = (1.0 - eta_1) * eta_2, eta_1 * eta_2
            h = room[12 * ROW + k]
            g = h * gamma * ((w0 * w0 + w1 * w1) + (w2 * w2 + w3 * w3))
            # x as it would be for s = 0
            z_0 = (T[k] * x_0_ + T[ROW + k] * x_1_) + (T[2 * ROW + k] * x_2_ + T[9 * ROW + k])
            z_1 = (T[3 * ROW + k] * x_0_ + T[4 * ROW + k] * x_1_) + (T[5 * ROW + k] * x_2_ + T[10 * ROW + k])
            z_2 = (T[6 * ROW + k] * x_0_ + T[7 * ROW + k] * x_1_) + (T[8 * ROW + k] * x_2_ + T[11 * ROW + k])
            missing = reading[k] - (q_0[k] * z_0 + q_1[k] * z_1 + q_2[k] * z_2)
            known = (w0 * t0 + w1 * t1) + (w2 * t2 + w3 * t3)
            if cascade:
                e = (missing - known) * (1.0 / (1.0 + g))
            else:
                per_0 = T[k] * b0 + T[ROW + k] * b1 + T[2 * ROW + k] * b2
                per_1 = T[3 * ROW + k] * b0 + T[4 * ROW + k] * b1 + T[5 * ROW + k] * b2
                per_2 = T[6 * ROW + k] * b0 + T[7 * ROW + k] * b1 + T[8 * ROW + k] * b2
                left = 1.0 - h * (q_0[k] * per_0 + q_1[k] * per_1 + q_2[k] * per_2)
                e = (missing - left * known) * (1.0 / (1.0 + g * left))
                hs = h * (known + g * e)
                z_0, z_1, z_2 = z_0 - per_0 * hs, z_1 - per_1 * hs, z_2 - per_2 * hs
            push = h * gamma * e
            t0, t1, t2, t3 = t0 + push * w0, t1 + push * w1, t2 + push * w2, t3 + push * w3
            x_0_, x_1_, x_2_ = z_0, z_1, z_2
            x_0_out[k], x_1_out[k], x_2_out[k] = z_0, z_1, z_2
            e_out[k] = e
    theta[node], theta[node + 1], theta[node + p_1], theta[node + p_1 + 1] = t0, t1, t2, t3


@njit(cache=True)
def _collect(before, s, N, time, A, E, C, y, steady, used, L, room):  # type: ignore[no-untyped-def]
    """Fill the rows of `room` for N samples from s on: 0 to 8 with L C - A, 9 to 11 with f = E + L y, 12 with the step h.

    Of the first `steady` outputs, the rows of C do not change; `used` outputs correct the state.
    """
    now, h = time[s : s + N], room[12 * ROW :]
    h[0] = now[0] - before
    for k in range(1, N):
        h[k] = now[k] - now[k - 1]
    for i in range(3):
        for j in range(3):
            row, given, constant = room[(3 * i + j) * ROW :], A[i, j, s : s + N], 0.0
            for o in range(steady):
                constant += L[i, o] * C[o, j, s]
            for k in range(N):
                row[k] = constant - given[k]
            for o in range(steady, used):
                given, gain = C[o, j, s : s + N], L[i, o]
                for k in range(N):
                    row[k] += gain * given[k]
        row, given = room[(9 + i) * ROW :], E[i, s : s + N]
        for k in range(N):
            row[k] = given[k]
        for o in range(used):
            given, gain = y[o, s : s + N], L[i, o]
            for k in range(N):
                row[k] += gain * given[k]


@njit(cache=True, error_model="numpy")
def _invert(N, room, T):  # type: ignore[no-untyped-def]
    """Fill the rows of T for N samples: 0 to 8 with T = (I - h A + h L C)^-1, 9 to 11 with T h f.

    By cofactors: the matrix is regular at any step if the state error decays, and cofactors, unlike elimination with pivots, do
    not care that pascals stand beside radians per second. Rows lie at fixed distances, or the compiler would not do several
    samples at a time.
    """
    for k in range(N):
        h = room[12 * ROW + k]
        m00, m01, m02 = 1.0 + h * room[k], h * room[ROW + k], h * room[2 * ROW + k]
        m10, m11, m12 = h * room[3 * ROW + k], 1.0 + h * room[4 * ROW + k], h * room[5 * ROW + k]
        m20, m21, m22 = h * room[6 * ROW + k], h * room[7 * ROW + k], 1.0 + h * room[8 * ROW + k]
        f0, f1, f2 = h * room[9 * ROW + k], h * room[10 * ROW + k], h * room[11 * ROW + k]
        a00, a01, a02 = m11 * m22 - m12 * m21, m02 * m21 - m01 * m22, m01 * m12 - m02 * m11
        a10, a11, a12 = m12 * m20 - m10 * m22, m00 * m22 - m02 * m20, m02 * m10 - m00 * m12
        a20, a21, a22 = m10 * m21 - m11 * m20, m01 * m20 - m00 * m21, m00 * m11 - m01 * m10
        inverse = 1.0 / (m00 * a00 + m01 * a10 + m02 * a20)
        T[k], T[ROW + k], T[2 * ROW + k] = a00 * inverse, a01 * inverse, a02 * inverse
        T[3 * ROW + k], T[4 * ROW + k], T[5 * ROW + k] = a10 * inverse, a11 * inverse, a12 * inverse
        T[6 * ROW + k], T[7 * ROW + k], T[8 * ROW + k] = a20 * inverse, a21 * inverse, a22 * inverse
        T[9 * ROW + k] = (a00 * f0 + a01 * f1 + a02 * f2) * inverse
        T[10 * ROW + k] = (a10 * f0 + a11 * f1 + a12 * f2) * inverse
        T[11 * ROW + k] = (a20 * f0 + a21 * f1 + a22 * f2) * inverse
