"""Smoothed signals at a few instants per second, in two views: from the even samples of a log, and from the odd ones.

The parabola through a window around each instant gives value and rate. The two views show the same signal. Their noise is
independent where that of the sensor is independent from sample to sample.
"""

import numpy as np

from lpvobs.compiled import njit
from lpvobs.discovery.thresholds import FORM_CALM, NEAR
from lpvobs.records import Array, Log


def averaged(values: Array, step: float) -> Array:
    """Return the means over a second around samples that are a step [s] apart."""
    width = 2 * int(0.5 * FORM_CALM / step) + 1
    return np.convolve(np.pad(values, width // 2, mode="edge"), np.full(width, 1.0 / width), mode="valid")


def instants(log: Log, spacing: float, half_width: float) -> Array:
    """Return the middles of windows that fit between the gaps of a log, shape (K,) [s]."""
    found = []
    for start, stop in log.segments:
        first, last = log.time[start] + half_width, log.time[stop - 1] - half_width
        if last > first:
            found.append(np.arange(first, last, spacing))
    return np.concatenate(found) if found else np.empty(0)


def at(log: Log, columns: Array, time: Array, half_width: float) -> tuple[Array, Array]:
    """Return values and rates around each instant, both of shape (2, m, K)."""
    # The first of two is made from the even samples, the second from the odd ones: same signal, independent noise. A value
    # is that of a local quadratic fit; a rate is the derivative of the smoothed signal, not the slope of the fit, so that a
    # balance of smoothed signals stays the balance that it was.
    h = NEAR * half_width
    value, later, earlier = (values_at(log, columns, time + shift, half_width) for shift in (0.0, h, -h))
    return value, (later - earlier) / (2.0 * h)


def values_at(log: Log, columns: Array, time: Array, half_width: float) -> Array:
    """Return the values of both views around each instant, shape (2, m, K)."""
    value = np.empty((2, columns.shape[0], time.size))
    for half in (0, 1):
        edges = np.array([(start + 1 - half) // 2 for start, _ in log.segments] + [(log.time.size + 1 - half) // 2])
        every = np.ascontiguousarray(columns[:, half::2], dtype=float)
        value[half] = _quadratics(np.ascontiguousarray(log.time[half::2]), every, edges, time, half_width)
    return value


@njit(cache=True)
def _quadratics(t, columns, edges, time, half_width):  # type: ignore[no-untyped-def]
    m = columns.shape[0]
    value = np.zeros((m, time.size))
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
        determinant = s0 * c00 + s1 * c01 + s2 * c02
        for i in range(lo, hi):
            tau = (t[i] - time[k]) / reach
            w = (1.0 - tau * tau) ** 2 / determinant * (c00 + c01 * tau + c02 * tau * tau)
            for c in range(m):
                value[c, k] += w * columns[c, i]
    return value
