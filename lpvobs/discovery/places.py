"""Where residuals are taken, by one of two strategies: instants that are seen twice, or blocks of samples.

Where an engine's constants are known, the residual holds the noise of the sensors, which is new at every instant. Two views of the
same signal with independent noise keep it out of every product: one from the even samples of a log, one from the odd ones, by the
parabola through a window around each instant. Where curves are learned, errors last for seconds: means over blocks lose nothing
then, and the storage in the manifold is a difference of two pressures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.discovery import thresholds
from lpvobs.engines.blocks import Blocks, block_length, blocks_along, transience_of
from lpvobs.engines.effects import SENSOR, Signals
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.errors import DataError
from lpvobs.records import Array, Log


@dataclass(frozen=True, eq=False)
class Places:
    """Where residuals are taken: K places of all logs, and the signals that they are computed from.

    Places are instants, seen twice (2K columns of signals), or blocks of samples (N columns), as the model says.
    """

    time: Array  # (K,) [s] since the start of the log
    of_log: NDArray[np.int64]  # (K,) number of the log
    step: float  # [s] from one place to the next
    signals: Signals  # as recorded
    # (K,) how fast the inputs change: a class from 0 for instants, the relative scatter within for blocks
    transience: Array
    blocks: Blocks | None


def instants_of(model: ResidualModel, logs: Sequence[Log], wide: float, spacing: float) -> Places:
    """Return instants, each seen in two views, with their class of transience; `spacing` [s] apart, farther on long drives."""
    spacing = max(spacing, sum(lasting(log) for log in logs) / thresholds.MOST_INSTANTS)
    views = [_view(model, log, spacing, wide * thresholds.HALF_WIDTH) for log in logs]
    apart = int(np.ceil(2.0 * max(view.half_width for view in views) / spacing))
    time = np.concatenate([view.time - log.time[0] for log, view in zip(logs, views, strict=True)])
    of_log = np.repeat(np.arange(len(logs)), [view.time.size for view in views])
    signals = _signals(model, logs, views, wide * thresholds.WIDE, time, time + starts(logs)[of_log])
    return Places(time, of_log, spacing, signals, _transience(model, signals, apart), None)


def blocks_of_logs(model: ResidualModel, logs: Sequence[Log], wide: float) -> Places:
    """Return blocks of samples, with the scatter of the inputs within each."""
    begin = starts(logs)
    clock = np.concatenate([log.time - log.time[0] + start for log, start in zip(logs, begin, strict=True)])
    offsets = np.cumsum([0, *(len(log) for log in logs[:-1])])
    segments = [(a + o, b + o) for log, o in zip(logs, offsets, strict=True) for a, b in log.segments]
    blocks = blocks_along(clock, segments, wide * block_length(sum(lasting(log) for log in logs)))
    middle = blocks.time + clock[0]
    of_log = np.searchsorted(begin, middle, side="right") - 1
    for log, count in zip(logs, np.bincount(of_log, minlength=len(logs)), strict=True):
        _refuse_short(log, count * blocks.length)
    there = [name for name in model.signals if all(name in log.channels for log in logs)]
    value = {name: np.concatenate([log[name] for log in logs]) for name in there}
    rate = {name: _gradient(values, clock, segments) for name, values in value.items()}
    reading = value.get(SENSOR, np.zeros(clock.size))
    number = np.searchsorted(begin, clock, side="right") - 1
    since = clock - begin[number]
    lacks = lacks_of(model, clock.size)

    def later(shift: float) -> Array:
        return np.asarray(np.interp(clock + shift, clock, reading))

    signals = Signals(since, clock, value, rate, lacks, later, rate.__getitem__, model.constants)
    transience = transience_of(blocks, value, model.moving)
    return Places(middle - begin[of_log], of_log, blocks.length, signals, transience, blocks)


def _refuse_short(log: Log, driven: float) -> None:
    """Raise DataError for a log without gaps for a short time [s] alone."""
    if driven < 3.0 * thresholds.STRETCH:
        raise DataError(
            f"{log.name}: the stretches without gaps last under a minute in all; a search for effects needs several minutes of "
            f"driving; record a longer log"
        )


def _gradient(values: Array, clock: Array, segments: Sequence[tuple[int, int]]) -> Array:
    out = np.zeros(values.size)
    for a, b in segments:
        if b - a > 1:
            out[a:b] = np.gradient(values[a:b], clock[a:b])
    return out


def lasting(log: Log) -> float:
    """Return how long a log lasts [s]."""
    return float(log.time[-1] - log.time[0])


@dataclass(frozen=True)
class _View:
    time: Array
    half_width: float
    value: Array
    rate: Array


def _view(model: ResidualModel, log: Log, spacing: float, half_width: float) -> _View:
    if len(log) < 2 * thresholds.LEAST_SAMPLES:
        raise DataError(
            f"{log.name}: only {len(log)} samples; a search for effects needs several minutes of driving; record a longer log"
        )
    least = max(1.0, 0.5 * thresholds.LEAST_SAMPLES * float(np.median(np.diff(log.time))) / thresholds.HALF_WIDTH)
    time = instants(log, spacing, least * thresholds.WIDER * thresholds.HALF_WIDTH)  # the same instants for all widths
    time = time[filled(log, time, least * thresholds.HALF_WIDTH)]
    half_width *= least
    _refuse_short(log, time.size * spacing)
    value, rate = at(log, np.stack([log[name] for name in model.signals]), time, half_width)
    return _View(time, half_width, value, rate)


def starts(logs: Sequence[Log]) -> Array:
    """Return where each log begins on the common clock [s]."""
    lengths = [log.time[-1] - log.time[0] + thresholds.PAUSE for log in logs]
    return np.concatenate([[0.0], np.cumsum(lengths)[:-1]])


def place_in_logs(logs: Sequence[Log], clock: float) -> float | None:
    """Return the time since the start of its log [s] of an instant of the clock, None for none."""
    if not np.isfinite(clock):
        return None
    begins = starts(logs)
    return float(clock - begins[max(int(np.searchsorted(begins, clock, side="right")) - 1, 0)])


def _signals(
    model: ResidualModel, logs: Sequence[Log], views: Sequence[_View], half_width: float, time: Array, clock: Array
) -> Signals:
    @lru_cache(maxsize=8)  # the fits ask for the same few shifts many times
    def later(shift: float) -> Array:
        seen = []
        for log, view in zip(logs, views, strict=True):
            time = np.clip(view.time + shift, log.time[0] + view.half_width, log.time[-1] - view.half_width)
            seen.append(values_at(log, log[SENSOR][None], time, view.half_width))
        return np.asarray(_joined(seen)[0])

    @lru_cache(maxsize=8)
    def slow(channel: str) -> Array:
        rates = [
            at(log, log[channel][None], view.time, max(half_width, 2.0 * view.half_width))[1]
            for log, view in zip(logs, views, strict=True)
        ]
        return np.asarray(_joined(rates)[0])

    value = dict(zip(model.signals, _joined([view.value for view in views]), strict=True))
    rate = dict(zip(model.signals, _joined([view.rate for view in views]), strict=True))
    lacks = lacks_of(model, 2 * time.size)
    return Signals(np.tile(time, 2), np.tile(clock, 2), value, rate, lacks, later, slow, model.constants)


def _joined(parts: Sequence[Array]) -> Array:
    """Return both views of several logs, shapes (2, m, K), as one, (m, 2K): the first of all logs, then the second."""
    return np.asarray(np.concatenate(np.concatenate(parts, axis=-1), axis=-1))


def lacks_of(model: ResidualModel, columns: int) -> Array:
    """Return the sizes of an engine in order for every column of signals, shape (l, columns)."""
    return np.tile(np.array(model.lacks)[:, None], (1, columns))


def stretches(places: Places, length: float) -> NDArray[np.int64]:
    """Return the number of the stretch of every place."""
    number = np.floor(_into_log(places) / length).astype(np.int64)
    other_log = np.diff(places.of_log, prepend=0) != 0
    return np.cumsum((np.diff(number, prepend=number[:1]) != 0) | other_log)


def kept_back(places: Places) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which places are used, and which are judged: every fifth stretch, without the guards at its ends."""
    into = _into_log(places) / thresholds.STRETCH
    kept = np.floor(into).astype(np.int64) % thresholds.EVERY == thresholds.EVERY // 2
    inside = np.abs(into - np.floor(into) - 0.5) * thresholds.STRETCH <= 0.5 * thresholds.STRETCH - thresholds.GUARD
    return ~kept, kept & inside


def _into_log(places: Places) -> Array:
    """Return the time of every place since the first one of its log [s], shape (K,)."""
    return np.asarray(places.time - places.time[np.searchsorted(places.of_log, places.of_log)])


def _transience(model: ResidualModel, signals: Signals, apart: int) -> Array:
    """Return the class of each instant: fast changes blur the balances, whatever the cause."""
    # The change is taken between instants `apart` before and after, whose windows do not overlap. A weight that depends on
    # the noise of its own rate would trust rises that noise makes smaller, and bias every lag and volume.
    K = signals.time.size // 2
    number = np.arange(K)
    after, before = np.minimum(number + apart, K - 1), np.maximum(number - apart, 0)
    total = np.zeros(K)
    for name in model.moving:
        calm = 0.5 * (signals[name][:K] + signals[name][K:])
        change = (calm[after] - calm[before]) / np.maximum(signals.time[after] - signals.time[before], 1e-9)
        total += (change / max(float(np.std(calm)), 1e-9)) ** 2
    return np.searchsorted(np.quantile(total, thresholds.TRANSIENT), total).astype(float)


def moves(values: Array) -> bool:
    """Return whether a channel moves on the logs: by more than `STANDS` of its mean."""
    return bool(np.std(values) > thresholds.STANDS * np.abs(np.mean(values)))


def averaged(values: Array, step: float) -> Array:
    """Return the means over a second around samples that are a step [s] apart."""
    width = 2 * int(0.5 * thresholds.FORM_CALM / step) + 1
    return np.convolve(np.pad(values, width // 2, mode="edge"), np.full(width, 1.0 / width), mode="valid")


def instants(log: Log, spacing: float, half_width: float) -> Array:
    """Return the middles of windows that fit between the gaps of a log, shape (K,) [s]."""
    found = []
    for start, stop in log.segments:
        first, last = log.time[start] + half_width, log.time[stop - 1] - half_width
        if last > first:
            found.append(np.arange(first, last, spacing))
    return np.concatenate(found) if found else np.empty(0)


def filled(log: Log, time: Array, half_width: float) -> NDArray[np.bool_]:
    """Return whether both halves of the window around an instant hold a third of its samples, shape (K,).

    Where a few readings are missing, there is no gap yet. A parabola through what is left runs away beside it.
    """
    before, here, after = (np.searchsorted(log.time, time + shift) for shift in (-half_width, 0.0, half_width))
    return np.asarray(np.minimum(here - before, after - here) >= thresholds.LEAST_SAMPLES // 3)


def at(log: Log, columns: Array, time: Array, half_width: float) -> tuple[Array, Array]:
    """Return values and rates around each instant, both of shape (2, m, K)."""
    # The first of two is made from the even samples, the second from the odd ones: same signal, independent noise. A value
    # is that of a local quadratic fit; a rate is the derivative of the smoothed signal, not the slope of the fit, so that a
    # balance of smoothed signals stays the balance that it was.
    h = thresholds.NEAR * half_width
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
