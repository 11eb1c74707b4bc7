"""A quadratic and a cubic fitted around one sample by weighted least squares, the window as `lpvobs.observer.smoothing` has it."""

import numpy as np


def window(time, k, half_width):
    """Return the samples of the window of sample k and their biweights: two samples on either side at least, if there are."""
    members = np.flatnonzero(np.abs(time - time[k]) < half_width)
    low, high = min(members[0], max(k - 2, 0)), max(members[-1], min(k + 2, time.size - 1))
    members = np.arange(low, high + 1)
    reach = 1.001 * max(half_width, np.abs(time[members] - time[k]).max())
    return members, (1.0 - ((time[members] - time[k]) / reach) ** 2) ** 2


def fit(time, signal, k, half_width, cube=0.05):
    """Return the value of the quadratic at sample k, and the slope of a cubic, or of the quadratic where a cube is like one."""
    members, weight = window(time, k, half_width)
    tau = time[members] - time[k]
    scale = np.abs(tau).max()
    columns = np.stack([np.ones_like(tau), tau / scale, (tau / scale) ** 2, (tau / scale) ** 3], axis=1)
    root = np.sqrt(weight)
    value, slope, _ = np.linalg.lstsq(columns[:, :3] * root[:, None], signal[members] * root, rcond=None)[0]
    like = np.linalg.lstsq(columns[:, :3] * root[:, None], columns[:, 3] * root, rcond=None)[0]
    left = columns[:, 3] - columns[:, :3] @ like
    if weight @ left**2 > cube * (weight @ columns[:, 3] ** 2):
        slope = np.linalg.lstsq(columns * root[:, None], signal[members] * root, rcond=None)[0][1]
    return value, slope / scale
