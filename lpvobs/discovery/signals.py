"""Calm signals at a few instants per second: what every balance is computed from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lpvobs.records import Array, Log

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Signals:
    """Values and rates of channels at K instants.

    Attributes
    ----------
    time : ndarray, shape (K,)
        [s], instants, never closer to a gap than the window's half width.
    names : tuple of str
        m channels.
    value, rate : ndarray, shape (m, K)
        In the channel's unit, and per second: a local quadratic around each instant.
    block : ndarray of int, shape (K,)
        Number of the stretch of the log to which each instant belongs; rising.
    """

    time: Array
    names: tuple[str, ...]
    value: Array
    rate: Array
    block: Index

    def __getitem__(self, name: str) -> Array:
        """Return the values of one channel, shape (K,)."""
        return self.value[self.names.index(name)]

    def rate_of(self, name: str) -> Array:
        """Return the rates of one channel, shape (K,)."""
        return self.rate[self.names.index(name)]


def instants(log: Log, spacing: float, half_width: float) -> Array:
    """Return the middles of windows that fit between the gaps of a log, shape (K,) [s]."""
    found = []
    for start, stop in log.segments:
        first, last = log.time[start] + half_width, log.time[stop - 1] - half_width
        if last > first:
            found.append(np.arange(first, last, spacing))
    return np.concatenate(found) if found else np.empty(0)


def at(log: Log, columns: Array, time: Array, half_width: float) -> tuple[Array, Array]:
    """Return value and rate of local quadratic fits around each instant, both of shape (2, m, K).

    The first of two is made from the even samples, the second from the odd ones: same signal, independent noise.
    """
    value, rate = (np.empty((2, columns.shape[0], time.size)) for _ in range(2))
    for half in (0, 1):
        edges = np.array([(start + 1 - half) // 2 for start, _ in log.segments] + [(log.time.size + 1 - half) // 2])
        every = np.ascontiguousarray(columns[:, half::2], dtype=float)
        _quadratics(np.ascontiguousarray(log.time[half::2]), every, edges, time, half_width, value[half], rate[half])
    return value, rate


def calm(log: Log, names: Sequence[str], spacing: float, half_width: float, block: float) -> Signals:
    """Return the needed channels of a log at instants `spacing` seconds apart, in blocks of `block` seconds."""
    time = instants(log, spacing, half_width)
    value, rate = at(log, np.stack([log[name] for name in names]), time, half_width)
    number = np.floor((time - log.time[0]) / block).astype(np.int64)
    return Signals(time, tuple(names), value, rate, np.unique(number, return_inverse=True)[1])


@njit(cache=True)
def _quadratics(t, columns, edges, time, half_width, value, rate):  # type: ignore[no-untyped-def]
    m = columns.shape[0]
    for k in range(time.size):
        lo = np.searchsorted(t, time[k] - half_width)
        hi = np.searchsorted(t, time[k] + half_width, side="right")
        middle = min(max(np.searchsorted(t, time[k]), 0), t.size - 1)
        segment = max(np.searchsorted(edges, middle, side="right") - 1, 0)
        lo = max(min(lo, middle - 2), edges[segment])
        hi = min(max(hi, middle + 3), edges[segment + 1])
        reach = 1.001 * max(half_width, time[k] - t[lo], t[hi - 1] - time[k])
        s0, s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(lo, hi):
            tau = (t[i] - time[k]) / reach
            w = (1.0 - tau * tau) ** 2
            s0 += w
            s1 += w * tau
            s2 += w * tau**2
            s3 += w * tau**3
            s4 += w * tau**4
        c00, c01, c02 = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
        c11, c12 = s0 * s4 - s2 * s2, s1 * s2 - s0 * s3
        determinant = s0 * c00 + s1 * c01 + s2 * c02
        for c in range(m):
            value[c, k] = 0.0
            rate[c, k] = 0.0
        for i in range(lo, hi):
            tau = (t[i] - time[k]) / reach
            w = (1.0 - tau * tau) ** 2 / determinant
            wv = w * (c00 + c01 * tau + c02 * tau * tau)
            wr = w * (c01 + c11 * tau + c12 * tau * tau) / reach
            for c in range(m):
                value[c, k] += wv * columns[c, i]
                rate[c, k] += wr * columns[c, i]
