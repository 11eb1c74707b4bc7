"""A quadratic fitted around one sample by weighted least squares, the window as `lpvobs.observer.smoothing` documents it."""

import numpy as np


def window(time, k, half_width):
    """Return the samples of the window of sample k and their biweights: two samples on either side at least, if there are."""
    members = np.flatnonzero(np.abs(time - time[k]) < half_width)
    low, high = min(members[0], max(k - 2, 0)), max(members[-1], min(k + 2, time.size - 1))
    members = np.arange(low, high + 1)
    reach = 1.001 * max(half_width, np.abs(time[members] - time[k]).max())
    return members, (1.0 - ((time[members] - time[k]) / reach) ** 2) ** 2


def fit(time, signal, k, half_width):
    """Return value and slope at sample k."""
    members, weight = window(time, k, half_width)
    tau = time[members] - time[k]
    scale = np.abs(tau).max()
    columns = np.stack([np.ones_like(tau), tau / scale, (tau / scale) ** 2], axis=1)
    root = np.sqrt(weight)
    found = np.linalg.lstsq(columns * root[:, None], signal[members] * root, rcond=None)[0]
    return found[0], found[1] / scale
