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

from lpvobs.airpath.base import Trajectory
from lpvobs.maps.grid import Grid, seek, share
from lpvobs.records import Array


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
    x = np.empty((time.size, 3))
    innovation = np.empty(time.size)
    theta = theta_0.copy()
    u_delta, n_e = operating_point
    by_output = np.ascontiguousarray(np.asarray(L, dtype=float).T)
    steady = trajectory.steady
    fixed = tuple((by_output[:steady].T @ trajectory.C[0, :steady]).ravel().tolist())
    for (start, stop), first in zip(segments, x_0, strict=True):
        part = slice(start, stop)
        _recursion(
            time[start] if before is None or start > 0 else before,
            time[part],
            trajectory.A[part],
            trajectory.E[part],
            trajectory.C[part],
            trajectory.y[part],
            trajectory.steady,
            fixed,
            u_delta[part],
            n_e[part],
            grid.u_delta,
            grid.n_e,
            by_output,
            gamma,
            (float(first[0]), float(first[1]), float(first[2])),
            theta,
            x[part],
            innovation[part],
        )
    return ObserverRun(x, theta, innovation)


@njit(cache=True)
def _recursion(  # type: ignore[no-untyped-def] # noqa: PLR0915 straight-line arithmetic
    before, time, A, E, C, y, steady, fixed, u_delta, n_e, u_nodes, n_nodes, L, gamma, x_0, theta, x_out, innovation
):
    """Fill x_out and innovation and move theta in place along one segment.

    The state's block is inverted by cofactors: it is regular at any step if the state error decays, and cofactors, unlike
    elimination with pivots, do not care that pascals stand beside radians per second. With x = x(s = 0) - h per s the fourth
    equation gives e in closed form. `fixed` is L C of the first `steady` outputs, whose rows of C do not change. Nothing is
    allocated, and what the next sample waits for is kept short.
    """
    N, r = y.shape
    x_0_, x_1_, x_2_ = x_0
    b0, b1, b2 = L[r - 1, 0], L[r - 1, 1], L[r - 1, 2]
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = fixed
    cascade = b0 == 0.0 and b1 == 0.0 and b2 == 0.0
    p_1 = u_nodes.size
    i, j = 0, 0
    for k in range(N):
        h = time[k] - before
        before = time[k]
        # I - h (A - L C) and the right-hand side
        m00, m01, m02 = c00 - A[k, 0, 0], c01 - A[k, 0, 1], c02 - A[k, 0, 2]
        m10, m11, m12 = c10 - A[k, 1, 0], c11 - A[k, 1, 1], c12 - A[k, 1, 2]
        m20, m21, m22 = c20 - A[k, 2, 0], c21 - A[k, 2, 1], c22 - A[k, 2, 2]
        f0, f1, f2 = E[k, 0], E[k, 1], E[k, 2]
        for o in range(r - 1):
            f0, f1, f2 = f0 + L[o, 0] * y[k, o], f1 + L[o, 1] * y[k, o], f2 + L[o, 2] * y[k, o]
        if not cascade:
            f0, f1, f2 = f0 + b0 * y[k, r - 1], f1 + b1 * y[k, r - 1], f2 + b2 * y[k, r - 1]
        if not (cascade and steady == r - 1):
            for o in range(steady, r):
                l0, l1, l2 = L[o, 0], L[o, 1], L[o, 2]
                c0, c1, c2 = C[k, o, 0], C[k, o, 1], C[k, o, 2]
                m00, m10, m20 = m00 + l0 * c0, m10 + l1 * c0, m20 + l2 * c0
                m01, m11, m21 = m01 + l0 * c1, m11 + l1 * c1, m21 + l2 * c1
                m02, m12, m22 = m02 + l0 * c2, m12 + l1 * c2, m22 + l2 * c2
        m00, m01, m02 = 1.0 + h * m00, h * m01, h * m02
        m10, m11, m12 = h * m10, 1.0 + h * m11, h * m12
        m20, m21, m22 = h * m20, h * m21, 1.0 + h * m22
        f0, f1, f2 = x_0_ + h * f0, x_1_ + h * f1, x_2_ + h * f2
        # cofactors
        a00, a01, a02 = m11 * m22 - m12 * m21, m02 * m21 - m01 * m22, m01 * m12 - m02 * m11
        a10, a11, a12 = m12 * m20 - m10 * m22, m00 * m22 - m02 * m20, m02 * m10 - m00 * m12
        a20, a21, a22 = m10 * m21 - m11 * m20, m01 * m20 - m00 * m21, m00 * m11 - m01 * m10
        inverse = 1.0 / (m00 * a00 + m01 * a10 + m02 * a20)
        # the map at the operating point
        i, j = seek(u_nodes, u_delta[k], i), seek(n_nodes, n_e[k], j)
        eta_1, eta_2 = share(u_nodes, u_delta[k], i), share(n_nodes, n_e[k], j)
        w0, w1 = (1.0 - eta_1) * (1.0 - eta_2), eta_1 * (1.0 - eta_2)
        w2, w3 = (1.0 - eta_1) * eta_2, eta_1 * eta_2
        node = j * p_1 + i
        g = h * gamma * ((w0 * w0 + w1 * w1) + (w2 * w2 + w3 * w3))
        q0, q1, q2, reading = C[k, r - 1, 0], C[k, r - 1, 1], C[k, r - 1, 2], y[k, r - 1]
        # x as it would be for s = 0
        x_0_ = (a00 * f0 + a01 * f1 + a02 * f2) * inverse
        x_1_ = (a10 * f0 + a11 * f1 + a12 * f2) * inverse
        x_2_ = (a20 * f0 + a21 * f1 + a22 * f2) * inverse
        missing = reading - (q0 * x_0_ + q1 * x_1_ + q2 * x_2_)
        known = (w0 * theta[node] + w1 * theta[node + 1]) + (w2 * theta[node + p_1] + w3 * theta[node + p_1 + 1])
        if cascade:
            e = (missing - known) * (1.0 / (1.0 + g))
        else:
            per0 = (a00 * b0 + a01 * b1 + a02 * b2) * inverse
            per1 = (a10 * b0 + a11 * b1 + a12 * b2) * inverse
            per2 = (a20 * b0 + a21 * b1 + a22 * b2) * inverse
            left = 1.0 - h * (q0 * per0 + q1 * per1 + q2 * per2)
            e = (missing - left * known) * (1.0 / (1.0 + g * left))
            s = h * (known + g * e)
            x_0_, x_1_, x_2_ = x_0_ - per0 * s, x_1_ - per1 * s, x_2_ - per2 * s
        push = h * gamma * e
        theta[node] += push * w0
        theta[node + 1] += push * w1
        theta[node + p_1] += push * w2
        theta[node + p_1 + 1] += push * w3
        x_out[k, 0], x_out[k, 1], x_out[k, 2] = x_0_, x_1_, x_2_
        innovation[k] = e
