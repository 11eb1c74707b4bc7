"""Logs laid out for the search: instants, two independent views of the signals, blocks, and what is known beforehand."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.signals import at, instants, values_at
from lpvobs.engines.effects import Plant, Scene
from lpvobs.errors import DataError
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Log

SPACING = 0.0973
"""[s] between instants; no simple part of a second, so that what happens on the second (set-points of a cycle, tasks of a control
unit) is seen at all phases: at tenths, kinks at whole seconds looked like a delay of half a millisecond. And"""
MOST_INSTANTS = 15000
"""how many there are at most: beyond 25 minutes they lie farther apart."""
LEAST_TIME = 60.0
"""[s] of driving that a log must hold."""
HALF_WIDTH = 0.1
"""[s] of the windows around instants; narrower ones blur fast transients less and let more noise through."""
WIDER = 1.5
"""How much wider the windows are that tell what a size owes to their width."""
LEAST_SAMPLES = 14
"""Samples that a window must hold: seven for each half of the samples."""
MOST_LEVELS = 3
"""A channel with at most so many values is a switch."""
PAUSE = 60.0
"""[s] between two logs on the common clock."""
WIDE = 0.5
"""[s], half width of the windows for rates of slow signals: of a temperature behind a sensor that takes seconds, narrower ones see
mostly noise."""
BLOCK = 2.0
"""[s], resolution of the search for onsets."""
MOST_BLOCKS = 400
"""Longer logs get longer blocks: the search over pairs of onset and end grows with their square."""
STRETCH = 20.0
"""[s], and"""
EVERY = 5
"""of so many stretches one is kept from every fit and every choice; the error before and after is that on those alone."""
GUARD = 1.0
"""[s] at either end of such a stretch that is neither used nor judged: farther than any window or lag reaches."""


@dataclass(frozen=True)
class MapPrior:
    """The map before these logs: theta = mean + sensitivity beta + error.

    Attributes
    ----------
    mean : ndarray, shape (p,)
        [kg/s]
    precision : ndarray, shape (p, p)
        [s^2/kg^2], inverse covariance of the error.
    sensitivity : ndarray, shape (p, q)
        [kg/s], what the map owes to the relative error of each constant.
    free : bool
        Whether the map is made from these very logs.
    """

    mean: Array
    precision: Array
    sensitivity: Array
    free: bool

    @cached_property
    def standard_error(self) -> Array:
        """Of every node, whatever the constants, shape (p,) [kg/s]."""
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.precision))))


@dataclass(frozen=True)
class Problem:
    """All that stays the same during a search.

    Attributes
    ----------
    plant : Plant
    grid : Grid
    names : tuple of str
        q uncertain constants.
    spread : ndarray, shape (q,)
        Standard deviation of the relative error of each.
    prior : MapPrior
    scene : Scene
        Of 2K columns.
    block : ndarray of int, shape (K,)
        Rising numbers of the blocks; none spans two logs.
    first : ndarray of int, shape (blocks,)
        The first instant of each.
    begins : ndarray, shape (blocks,)
        [s], beginning of each on the clock.
    per_coarse : int
        Blocks whose sums are taken as independent.
    haste : ndarray of int, shape (K,)
        Class of how fast the inputs change, from 0.
    auxiliary : mapping of str to ndarray, shape (K,)
        The logs' own channels, where all have them.
    used : ndarray of bool, shape (K,)
        Instants that fits and choices see.
    judged : ndarray of bool, shape (K,)
        Instants that only the error before and after is computed from, at a distance from all that are used.
    wider : callable
        The same problem, all of it used, seen through windows `WIDER` times as wide.
    """

    plant: Plant
    grid: Grid
    names: tuple[str, ...]
    spread: Array
    prior: MapPrior
    scene: Scene
    block: NDArray[np.int64]
    first: NDArray[np.int64]
    begins: Array
    per_coarse: int
    haste: NDArray[np.int64]
    auxiliary: Mapping[str, Array]
    used: NDArray[np.bool_]
    judged: NDArray[np.bool_]
    wider: Callable[[], "Problem"]

    @property
    def data(self) -> int:
        """The number of residuals that fits and choices see."""
        return int(self.used.sum()) * len(self.plant.balances)

    @property
    def coarse_blocks(self) -> float:
        """The number of blocks whose sums are taken as independent, without those kept back."""
        return float(self.first.size / self.per_coarse * self.used.mean())

    def with_all(self) -> "Problem":
        """Return the same with nothing kept back."""
        return replace(self, used=np.ones(self.K, dtype=bool))

    @property
    def K(self) -> int:
        """The number of instants."""
        return self.block.size


def free_map(grid: Grid, q: int, prior_map: float) -> MapPrior:
    """Return what is known of a map that these logs make: nothing beyond a wide prior [kg/s]."""
    p = grid.size
    return MapPrior(np.zeros(p), np.eye(p) / prior_map**2, np.zeros((p, q)), True)


def lay_out(
    plant: Plant,
    grid: Grid,
    tolerance: Mapping[str, float],
    prior: MapPrior,
    logs: Sequence[Log],
    coarse: float = 10.0,
    half_width: float = HALF_WIDTH,
) -> Problem:
    """Return the problem of one or more logs.

    Raises
    ------
    DataError
        If a log has no stretch that is long enough.
    """
    driven = sum(float(log.time[-1] - log.time[0]) for log in logs)
    spacing = SPACING * max(1.0, driven / SPACING / MOST_INSTANTS)
    views = [_view(plant, log, spacing, half_width) for log in logs]
    K = sum(view.time.size for view in views)
    length = max(BLOCK, np.ceil(K * spacing / MOST_BLOCKS / BLOCK) * BLOCK)
    block = _blocks(views, length)
    first = np.flatnonzero(np.diff(block, prepend=-1))
    scene = _joined(plant, logs, views)
    used, judged = _kept_back(views)
    common = set.intersection(*(set(log.auxiliary) for log in logs))
    return Problem(
        plant=plant,
        grid=grid,
        names=tuple(tolerance),
        spread=np.array(list(tolerance.values())) / np.sqrt(3.0),
        prior=prior,
        scene=scene,
        block=block,
        first=first,
        begins=scene.clock[first],
        per_coarse=max(1, round(coarse / length)),
        haste=_haste(plant, scene, int(np.ceil(2.0 * max(view.half_width for view in views) / spacing))),
        auxiliary={
            name: np.concatenate([_steadied(log, name, view.time) for log, view in zip(logs, views, strict=True)])
            for name in sorted(common)
            if all(_usable(log.auxiliary[name]) for log in logs)
        },
        used=used,
        judged=judged,
        wider=lambda: lay_out(plant, grid, tolerance, prior, logs, coarse, WIDER * HALF_WIDTH).with_all(),
    )


@dataclass(frozen=True)
class _View:
    time: Array
    half_width: float
    value: Array
    rate: Array


def _view(plant: Plant, log: Log, spacing: float, half_width: float) -> _View:
    if len(log) < 2 * LEAST_SAMPLES:
        raise DataError(f"{log.name}: {len(log)} samples; a search for effects needs minutes of driving, record more")
    least = max(1.0, 0.5 * LEAST_SAMPLES * float(np.median(np.diff(log.time))) / HALF_WIDTH)
    time = instants(log, spacing, least * WIDER * HALF_WIDTH)  # the same for all widths
    half_width *= least
    if time.size * spacing < LEAST_TIME:
        raise DataError(f"{log.name}: under a minute without a gap; a search for effects needs minutes, record more")
    value, rate = at(log, np.stack([log[name] for name in plant.channels]), time, half_width)
    return _View(time, half_width, value, rate)


def starts(logs: Sequence[Log]) -> Array:
    """Return where each log begins on the common clock [s]."""
    lengths = [log.time[-1] - log.time[0] + PAUSE for log in logs]
    return np.concatenate([[0.0], np.cumsum(lengths)[:-1]])


def place_in_logs(logs: Sequence[Log], clock: float) -> float | None:
    """Return the time since the start of its log [s] of an instant of the clock, None for none."""
    if not np.isfinite(clock):
        return None
    begins = starts(logs)
    return float(clock - begins[max(int(np.searchsorted(begins, clock, side="right")) - 1, 0)])


def _halves(values: Array) -> Array:
    """Return (2, m, K) as (m, 2K): the first view, then the second."""
    return np.concatenate([values[0], values[1]], axis=-1)


def _joined(plant: Plant, logs: Sequence[Log], views: Sequence[_View]) -> Scene:
    @lru_cache(maxsize=8)  # asked for again and again
    def later(shift: float) -> Array:
        seen = []
        for log, view in zip(logs, views, strict=True):
            time = np.clip(view.time + shift, log.time[0] + view.half_width, log.time[-1] - view.half_width)
            seen.append(values_at(log, log[plant.sensor][None], time, view.half_width))
        return np.asarray(_halves(np.concatenate(seen, axis=-1))[0])

    @lru_cache(maxsize=8)
    def slow(channel: str) -> Array:
        rates = [
            at(log, log[channel][None], view.time, max(WIDE, 2.0 * view.half_width))[1]
            for log, view in zip(logs, views, strict=True)
        ]
        return np.asarray(_halves(np.concatenate(rates, axis=-1))[0])

    time = np.concatenate([view.time - log.time[0] for log, view in zip(logs, views, strict=True)])
    clock = np.concatenate(
        [view.time - log.time[0] + start for log, view, start in zip(logs, views, starts(logs), strict=True)]
    )
    value, rate = (
        _halves(np.concatenate([getattr(view, name) for view in views], axis=-1)) for name in ("value", "rate")
    )
    return Scene(
        time=np.tile(time, 2),
        clock=np.tile(clock, 2),
        value=value,
        rate=rate,
        lacks=np.tile(np.array(plant.lacks)[:, None], (1, 2 * time.size)),
        later=later,
        slow=slow,
        channels=plant.channels,
        constants=plant.constants,
    )


def _blocks(views: Sequence[_View], length: float) -> NDArray[np.int64]:
    """Return the number of the block of every instant."""
    numbers, offset = [], 0
    for view in views:
        raw = np.floor((view.time - view.time[0]) / length).astype(np.int64)
        held, own = np.unique(raw, return_inverse=True)
        numbers.append(own + offset)
        offset += held.size
    return np.concatenate(numbers)


def _kept_back(views: Sequence[_View]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which instants are used, and which are judged: every fifth stretch, without the guards at its ends."""
    used, judged = [], []
    for view in views:
        into = (view.time - view.time[0]) / STRETCH
        kept = np.floor(into).astype(np.int64) % EVERY == EVERY // 2
        inside = np.abs(into - np.floor(into) - 0.5) * STRETCH <= 0.5 * STRETCH - GUARD
        used.append(~kept)
        judged.append(kept & inside)
    return np.concatenate(used), np.concatenate(judged)


def _haste(plant: Plant, scene: Scene, apart: int) -> NDArray[np.int64]:
    """Return the class of each instant: fast changes blur the balances, whatever the cause.

    The change is that between instants `apart` before and after, whose windows do not touch: a weight that knew the noise of its
    own rate would trust a rise that noise makes smaller, and bias every lag and volume.
    """
    K = scene.time.size // 2
    number = np.arange(K)
    after, before = np.minimum(number + apart, K - 1), np.maximum(number - apart, 0)
    total = np.zeros(K)
    for name in plant.hurried:
        calm = 0.5 * (scene[name][:K] + scene[name][K:])
        change = (calm[after] - calm[before]) / np.maximum(scene.time[after] - scene.time[before], 1e-9)
        total += (change / max(float(np.std(calm)), 1e-9)) ** 2
    return np.searchsorted(np.quantile(total, HASTE), total)


HASTE = (0.7, 0.85, 0.93, 0.97, 0.99)
"""Quantiles that part the classes of haste."""


def _usable(values: Array) -> bool:
    known = np.isfinite(values)
    return bool(known.mean() > 0.95 and np.ptp(values[known]) > 0)


def _steadied(log: Log, name: str, time: Array) -> Array:
    known = np.isfinite(log.auxiliary[name])
    at, values = log.time[known], log.auxiliary[name][known]
    if np.unique(values).size <= MOST_LEVELS:  # a switch has no value between its levels
        return np.asarray(values[np.clip(np.searchsorted(at, time, side="right") - 1, 0, at.size - 1)])
    return np.interp(time, at, values)
