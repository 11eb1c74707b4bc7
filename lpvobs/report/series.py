"""Long time series drawn with few points: what the eye sees of them at a given width."""

from itertools import pairwise

import numpy as np

from lpvobs.records import Array

Segments = tuple[tuple[int, int], ...]


def thin(time: Array, values: Array, segments: Segments, columns: int) -> tuple[Array, Array]:
    """Return times, and the smallest and largest value of each column of pixels, with NaN where the line breaks.

    The line breaks between segments, and values of shape (N,) may be NaN. The columns cover the whole time. Both results have
    shape (M,), M about twice the number of columns at most; a segment with fewer samples is returned whole.
    """
    whole = max(float(time[-1] - time[0]), np.finfo(float).tiny)
    pieces = [
        _thin_segment(time[a:b], values[a:b], max(1, round(columns * float(time[b - 1] - time[a]) / whole)))
        for a, b in segments
    ]
    gap = np.full((2, 1), np.nan)
    joined = np.concatenate([part for piece in pieces for part in (piece, gap)][:-1], axis=1)
    return joined[0], joined[1]


def _thin_segment(time: Array, values: Array, columns: int) -> Array:
    """Return times and extremes of one segment, shape (2, M)."""
    if time.size <= 2 * columns:
        return np.stack([time, values])
    column = np.minimum((time - time[0]) * (columns / (time[-1] - time[0])), columns - 1).astype(int)
    starts = np.searchsorted(column, np.arange(columns + 1))
    points = [_extremes(time[a:b], values[a:b]) for a, b in pairwise(starts) if b > a]
    return np.concatenate(points, axis=1)


def _extremes(time: Array, values: Array) -> Array:
    """Return where and what the extremes are, shape (2, 2), or a break, shape (2, 1), where nothing is known."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size == 0:
        return np.array([[time[0]], [np.nan]])
    at = np.sort(known[[np.argmin(values[known]), np.argmax(values[known])]])
    return np.stack([time[at], values[at]])


def busiest(time: Array, values: Array, width: float) -> tuple[float, float]:
    """Return the window of a width [s] in which the values, shape (N,), move most: the largest sum of steps over its parts."""
    start, stop = float(time[0]), float(time[-1])
    if stop - start <= width:
        return start, stop
    raster = np.linspace(start, stop, max(int((stop - start) / (width / 30.0)), 2))  # 30 parts: noise averages out
    mean = np.interp(raster, time, values)
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(mean)))])
    ends = np.searchsorted(raster, raster + width, side="right") - 1
    inside = raster <= stop - width
    best = int(np.argmax(np.where(inside, moved[ends] - moved, -np.inf)))
    return float(raster[best]), float(raster[best]) + width


def window(time: Array, segments: Segments, start: float, stop: float) -> tuple[slice, Segments]:
    """Return the samples in a window of time, and the segments among them counted from its first sample."""
    first, last = int(np.searchsorted(time, start)), int(np.searchsorted(time, stop, side="right"))
    inside = [(max(a, first) - first, min(b, last) - first) for a, b in segments]
    return slice(first, last), tuple((a, b) for a, b in inside if b > a)
