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
from lpvobs.maps.grid import Grid, local
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

    Returns
    -------
    ObserverRun
    """
    x = np.empty((time.size, 3))
    innovation = np.empty(time.size)
    theta = theta_0.copy()
    u_delta, n_e = operating_point
    for (start, stop), first in zip(segments, x_0, strict=True):
        part = slice(start, stop)
        _recursion(
            time[part],
            trajectory.A[part],
            trajectory.E[part],
            trajectory.C[part],
            trajectory.y[part],
            u_delta[part],
            n_e[part],
            grid.u_delta,
            grid.n_e,
            np.ascontiguousarray(L, dtype=float),
            gamma,
            first,
            theta,
            x[part],
            innovation[part],
        )
    return ObserverRun(x, theta, innovation)


@njit(cache=True)
def _recursion(  # type: ignore[no-untyped-def]
    time, A, E, C, y, u_delta, n_e, u_nodes, n_nodes, L, gamma, x_0, theta, x_out, innovation
):
    """Fill x_out and innovation and move theta in place along one segment."""
    N, r = y.shape
    nodes, weights = np.empty(4, dtype=np.int64), np.empty(4)
    M = np.empty((4, 5))
    x = x_0.copy()
    for k in range(N):
        h = time[k] - time[k - 1] if k > 0 else 0.0
        local(u_nodes, n_nodes, u_delta[k], n_e[k], nodes, weights)
        before, g = 0.0, 0.0
        for m in range(4):
            before += weights[m] * theta[nodes[m]]
            g += gamma * weights[m] * weights[m]
        for i in range(3):
            M[i, 4] = x[i] + h * E[k, i]
            for j in range(3):
                M[i, j] = (1.0 if i == j else 0.0) - h * A[k, i, j]
            for o in range(r):
                M[i, 4] += h * L[i, o] * y[k, o]
                for j in range(3):
                    M[i, j] += h * L[i, o] * C[k, o, j]
            M[i, 3] = h * L[i, r - 1]
        for j in range(3):
            M[3, j] = h * g * C[k, r - 1, j]
        M[3, 3] = 1.0 + h * g
        M[3, 4] = before + h * g * y[k, r - 1]
        _solve4(M)
        e = y[k, r - 1] - M[3, 4]
        for j in range(3):
            x[j] = M[j, 4]
            x_out[k, j] = x[j]
            e -= C[k, r - 1, j] * x[j]
        for m in range(4):
            theta[nodes[m]] += h * gamma * weights[m] * e
        innovation[k] = e


@njit(cache=True)
def _solve4(M: Array) -> None:
    """Solve the 4 x 4 system M[:, :4] z = M[:, 4] in place by elimination with row pivoting; z stands in M[:, 4]."""
    for j in range(4):
        pivot = j
        for i in range(j + 1, 4):
            if abs(M[i, j]) > abs(M[pivot, j]):
                pivot = i
        if pivot != j:
            for m in range(5):
                M[j, m], M[pivot, m] = M[pivot, m], M[j, m]
        for i in range(j + 1, 4):
            factor = M[i, j] / M[j, j]
            for m in range(j + 1, 5):
                M[i, m] -= factor * M[j, m]
    for i in range(3, -1, -1):
        for j in range(i + 1, 4):
            M[i, 4] -= M[i, j] * M[j, 4]
        M[i, 4] /= M[i, i]
