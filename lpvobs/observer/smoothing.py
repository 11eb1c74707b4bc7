"""Zero-phase smoothing with bounded look-ahead: a local quadratic around every sample.

The scheduling parameters are computed from measured pressures and speeds through a steep compressor curve, so noise inside rho
biases the map. A symmetric window does not shift signals in time, and each value depends on a bounded stretch of the log, so a
log read in pieces gives what the whole gives.
"""

import numpy as np
from numba import njit

from lpvobs.records import Array


def smooth(
    time: Array, columns: Array, segments: tuple[tuple[int, int], ...], half_width: float
) -> tuple[Array, Array]:
    """Return values and time derivatives of local quadratic fits with biweight window.

    Parameters
    ----------
    time : ndarray, shape (N,)
        [s]
    columns : ndarray, shape (m, N)
        Signals.
    segments : tuple of (start, stop)
        No window reaches across a gap.
    half_width : float
        [s]; the window is widened where it would hold fewer than two samples on either side.

    Returns
    -------
    values, rates : ndarray, shape (m, N)
        In the unit of the signals, and per second.
    """
    values, rates = np.empty_like(columns), np.empty_like(columns)
    for start, stop in segments:
        part = slice(start, stop)
        if stop - start < 3:  # too short for a quadratic
            values[:, part], rates[:, part] = columns[:, part], 0.0
            continue
        _local_quadratic(time[part], columns[:, part], half_width, values[:, part], rates[:, part])
    return values, rates


@njit(cache=True)
def _local_quadratic(time: Array, columns: Array, half_width: float, values: Array, rates: Array) -> None:
    m, N = columns.shape
    value_weight, rate_weight = np.empty(N), np.empty(N)
    first, last = 0, 0
    for k in range(N):
        while time[k] - time[first] >= half_width:
            first += 1
        while last < N - 1 and time[last + 1] - time[k] < half_width:
            last += 1
        lo, hi = max(min(first, k - 2), 0), min(max(last, k + 2), N - 1)
        reach = 1.001 * max(half_width, time[k] - time[lo], time[hi] - time[k])
        s0, s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(lo, hi + 1):
            tau = (time[i] - time[k]) / reach
            w = (1.0 - tau * tau) ** 2
            value_weight[i] = w
            s0 += w
            s1 += w * tau
            s2 += w * tau**2
            s3 += w * tau**3
            s4 += w * tau**4
        # first two rows of the inverse of the moment matrix [[s0, s1, s2], [s1, s2, s3], [s2, s3, s4]]
        c00, c01, c02 = s2 * s4 - s3 * s3, s2 * s3 - s1 * s4, s1 * s3 - s2 * s2
        c11, c12 = s0 * s4 - s2 * s2, s1 * s2 - s0 * s3
        determinant = s0 * c00 + s1 * c01 + s2 * c02
        for i in range(lo, hi + 1):
            tau = (time[i] - time[k]) / reach
            w = value_weight[i] / determinant
            value_weight[i] = w * (c00 + c01 * tau + c02 * tau * tau)
            rate_weight[i] = w * (c01 + c11 * tau + c12 * tau * tau) / reach
        for c in range(m):
            value, rate = 0.0, 0.0
            for i in range(lo, hi + 1):
                value += value_weight[i] * columns[c, i]
                rate += rate_weight[i] * columns[c, i]
            values[c, k], rates[c, k] = value, rate
