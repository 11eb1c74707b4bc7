"""What one log contributes to the map: found in one pass over the log, small, and added up over logs.

The pass meets every sample once: smoothing, scheduling parameters, the observer of Eq. (26), the balances, means over windows. What
follows (weights of the balances, amplitudes of corrections, the map) is computed from the sums of `windows`.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.base import AirPath
from lpvobs.engines.followers import followed
from lpvobs.engines.unknowns import Unknowns
from lpvobs.errors import DataError
from lpvobs.maps.grid import Grid
from lpvobs.observer.log_run import LogRun, RangeSeen, nothing_between
from lpvobs.observer.recursion import observe
from lpvobs.observer.settings import EstimateSettings
from lpvobs.observer.smoothing import CALM, CALM_LEAST, SmoothStretch, kernel, stretches
from lpvobs.observer.windows import LENGTH, Columns, Moments, Slopes, Windows, no_moments
from lpvobs.records import Array, Defects, Log, Recording
from lpvobs.synthesis.region import Region

SETTLED = 0.25  # of the constants' prior spread that is left where they have been found once
ROUGH = 1.94
"""Second differences of white noise that say as much as one that is alone: one and twice the sum of 4/9 and 1/36."""
NEAR = 9  # windows around each that tell of the sensor's noise there, for most sensors' grows with the flow
SIGNS = reduce(np.kron, [np.array([[1.0, 1.0], [1.0, -1.0]])] * 4)
"""Of noise by window and source, a Hadamard matrix: over 16 windows each of 15 sources is free of all others."""


@dataclass(frozen=True)
class StateGain:
    """The part of a synthesised gain that the recursion needs."""

    outputs: tuple[str, ...]  # measured states among the outputs; the sensor comes after them
    L: Array  # (n, r)
    region: Region | None = None  # what its certificate covers; None where nobody asks


@dataclass(frozen=True)
class LogInformation:
    """What one log says of the map and of the engine's unknowns, in the columns and cells that it touches."""

    run: LogRun
    columns: NDArray[np.int64]  # (a,) see `windows.Columns`
    products: Array  # (B, B, a, a) see `windows.Moments`
    slow: Array  # (B, B, a, a)
    windows: Array  # (B,)
    cells: NDArray[np.int64]  # (v,) numbers of the cells, row by row
    gram: Array  # (v, 4, 4) [s]


@dataclass(frozen=True)
class Observed:
    """What the observer makes of N samples, B balances."""

    time: Array  # (N,) [s]
    steps: Array  # (N,) [s]
    parameters: Array  # (N, m) scheduling parameters
    point: tuple[Array, Array]  # (N,) the map's inputs: fuel, speed
    z: Array  # (B, N) [kg/s], the sensor's reading less the flow of each balance
    signals: Array  # (s, N) see `slope_signals`


def slope_signals(
    air_path: AirPath,
    channels: Mapping[str, Array],
    rates: Mapping[str, Array],
    rough: Mapping[str, Array],
    steps: Array,
) -> Array:
    """Return what slopes are computed from as rows, shape (s, N): channels, rates, squares of what is rough in them, steps."""
    names, smoothed = (*air_path.channels, *air_path.followers), air_path.smoothed
    squares = [rough[name] ** 2 for name in air_path.noisy]
    return np.stack([*(channels[name] for name in names), *(rates[name] for name in smoothed), *squares, steps])


def parted(air_path: AirPath, rows: Array) -> tuple[list[dict[str, Array]], Array]:
    """Return channels, rates and squares, and the steps, again from rows of shape (n, s)."""
    columns, smoothed = iter(np.ascontiguousarray(rows.T)), air_path.smoothed
    sorts = ((*air_path.channels, *air_path.followers), smoothed, air_path.noisy)
    return [{name: next(columns) for name in names} for names in sorts], next(columns)


class Answers:
    """How flows answer to the engine's unknowns in windows of a log; the air path is at the point of linearisation."""

    def __init__(self, air_path: AirPath, unknowns: Unknowns, settings: EstimateSettings):
        self.air_path, self.unknowns = air_path, unknowns
        self.half_width = settings.smoothing
        constants = unknowns.covariance.diagonal()[: len(unknowns.constants)]
        self.spread = float(np.sqrt(constants.mean())) if constants.size else 0.0
        if unknowns.mean.any():  # seen from where the logs have the engine
            self.spread *= SETTLED

    def slopes(self, stay: Array, means: Array) -> Slopes:
        """Return what mean signals of windows of some stay say of the slopes."""
        (channels, rates, squares), steps = parted(self.air_path, means)
        n, step = stay.size, float(np.median(steps))
        (_, by_rate), (by_value, _) = kernel(step, self.half_width), kernel(step, CALM * self.half_width, CALM_LEAST)
        # A window's mean of squares has about so many degrees of freedom; their median, which transients do not raise, lies lower.
        degrees = np.maximum(np.median(stay) / step / ROUGH, 1.0)
        noise = {k: np.sqrt(np.median(s)) / (1.0 - 2.0 / (9.0 * degrees)) ** 1.5 for k, s in squares.items()}
        del noise[self.air_path.sensor]
        near = np.pad(squares[self.air_path.sensor], NEAR // 2, mode="edge")
        beside = np.median(np.lib.stride_tricks.sliding_window_view(near, NEAR), axis=1)
        of_sensor = np.sqrt(beside * step / stay) / (1.0 - 2.0 / (9.0 * degrees)) ** 1.5
        calm = {name: np.full(n, noise[name] * np.linalg.norm(by_value)) for name in self.air_path.calmed}
        caution = self.air_path.caution(log_of(np.arange(float(n)), channels), calm, self.spread, self.unknowns.learned)
        box = np.full(max(round(LENGTH / step), 1), step / LENGTH)
        in_rate = float(np.linalg.norm(np.convolve(box, by_rate)))
        signs = iter(np.resize(SIGNS, (n, len(SIGNS))).T[1:])
        moved = {name: channels[name] + next(signs) * sd * np.sqrt(step / stay) for name, sd in noise.items()}
        shaken = {name: rates[name] + next(signs) * sd * in_rate for name, sd in noise.items()}
        touched, J, flow = self._at(
            {name: np.concatenate((signal, moved.get(name, signal))) for name, signal in channels.items()},
            {name: np.concatenate((signal, shaken[name])) for name, signal in rates.items()},
        )
        by_noise = [np.where(np.isfinite(each), each, 0.0) for each in (J[n:] - J[:n], flow[:n] - flow[n:])]
        reading = channels[self.air_path.sensor]
        return Slopes(touched, J[:n], reading, of_sensor, caution.trust.T, caution.bias.T, (by_noise[0], by_noise[1]))

    def _at(self, channels: Mapping[str, Array], rates: Mapping[str, Array]) -> tuple[NDArray[np.int64], Array, Array]:
        """Return which k unknowns a flow answers to, J (n, B, k) and the flows (n, B) [kg/s]."""
        n = next(iter(rates.values())).size
        log = log_of(np.arange(float(n)), channels)
        found = self.air_path.balances(log, rates, self.unknowns.constants)
        B, q = found.slope.shape[:2]
        corrections = self.air_path.corrections(log, rates)
        answers, places = np.arange(self.unknowns.size) < q, [*self.unknowns.places().values()]
        for place, correction in zip(places, corrections, strict=True):
            answers[place.start + (0 if correction.points is None else correction.points.weights[0])] = True
        touched, at = np.flatnonzero(answers), np.cumsum(answers) - 1
        J = np.zeros((n, B, touched.size))
        J[:, :, :q] = found.slope.transpose(2, 0, 1)
        for place, correction in zip(places, corrections, strict=True):
            for b in correction.on(B):
                correction.fill(J[:, b], at[place])
        return touched, J, found.flow.T


def inform(
    air_path: AirPath, grid: Grid, gain: StateGain, log: Recording, settings: EstimateSettings, unknowns: Unknowns
) -> LogInformation:
    """Return the part of one log, read once from beginning to end; the air path is at the point of linearisation.

    Raises DataError if the gain is no cascade, or no two samples of the log are neighbours.
    """
    if np.any(gain.L[:, -1] != 0.0):
        raise DataError(
            "gain: the last column of L is not zero, so the air flow sensor corrects the state; run `lpvobs synth-gain` with "
            "cascade = true in [gain], or use --method published"
        )
    found = observed_along(air_path, grid, gain, log, settings)
    return inform_observed(air_path, grid, gain.region, log, found, settings, unknowns)


def inform_observed(
    air_path: AirPath,
    grid: Grid,
    region: Region | None,
    log: Recording,
    observed: Iterable[tuple[Observed, Array]],
    settings: EstimateSettings,
    unknowns: Unknowns,
) -> LogInformation:
    """Return the part of a log from what the observer makes of it and what the sensor read, in one or more stretches.

    Raises DataError if no two samples are neighbours.
    """
    seen = RangeSeen(len(air_path.parameter_names), region)
    answers = Answers(air_path, unknowns, settings)
    layout = Columns(grid.size, unknowns.size, len(air_path.balance_names))
    # What makes slopes must not hold the windows, or both stay until garbage is looked for.
    windows = Windows(grid, layout, answers.slopes)
    for found, reading in observed:
        seen.see(found.parameters, found.time, found.steps, reading)
        windows.add(found.time, found.steps, found.point, found.z, found.signals)
    if not seen.duration > 0.0:
        raise nothing_between(log.name, seen.started)
    total = windows.moments()
    touched = np.concatenate((np.einsum("abii->abi", total.products), total.products[..., layout.z]))
    columns = np.flatnonzero(touched.any(axis=(0, 1)))
    cells = np.flatnonzero(total.gram.any(axis=(1, 2)))
    products, slow = (each.take(columns, 2).take(columns, 3) for each in (total.products, total.slow))
    return LogInformation(seen.run(log), columns, products, slow, total.windows, cells, total.gram[cells])


def observed_along(
    air_path: AirPath, grid: Grid, gain: StateGain, recording: Recording, settings: EstimateSettings
) -> Iterator[tuple[Observed, Array]]:
    """Yield what the observer makes of a recording, stretch by stretch, and what the sensor read [kg/s]."""
    x, no_map = np.empty(0), np.zeros(grid.size)
    pieces = followed(air_path.followers, recording.pieces())
    for stretch in stretches(pieces, air_path.smoothed, settings.smoothing, air_path.calmed, air_path.noisy):
        log = calm_log(stretch)
        trajectory, point = air_path.trajectory(log, gain.outputs), operating_point(air_path, log)
        first = air_path.states(log)[0] if stretch.before is None else x
        run = observe(trajectory, log.time, log.segments, point, grid, gain.L, 0.0, first[None], no_map, stretch.before)
        x = run.x[-1]
        states = dict(zip(air_path.state_names, np.ascontiguousarray(run.x.T), strict=True))
        seen = {**log.channels, **states}
        flow = air_path.balances(log_of(stretch.time, seen), stretch.rates, (), stretch.calm).flow
        rows = slope_signals(air_path, seen, stretch.rates, stretch.rough, stretch.steps)
        reading = stretch.channels[air_path.sensor]
        yield Observed(stretch.time, stretch.steps, trajectory.parameters, point, reading - flow, rows), reading


def calm_log(stretch: SmoothStretch) -> Log:
    """Return a stretch as a log with its smoothed channels in place of those as recorded."""
    return log_of(stretch.time, {**stretch.channels, **stretch.values})


def log_of(time: Array, channels: Mapping[str, Array]) -> Log:
    """Return channels that were computed as a log of one segment."""
    return Log("", "", time, channels, {}, ((0, time.size),), np.arange(time.size), Defects(time.size))


def operating_point(air_path: AirPath, log: Log) -> tuple[Array, Array]:
    """Return the map's inputs along a log, each of shape (N,): fuel, speed."""
    fuel, speed = air_path.axes
    return log[fuel.channel], log[speed.channel]


def added_up(grid: Grid, layout: Columns, parts: Iterable[LogInformation]) -> tuple[Moments, tuple[LogRun, ...]]:
    """Return the sums of logs together, added in the order given, and what is kept of each log."""
    total, runs = no_moments(grid, layout), []
    for part in parts:
        total.products[:, :, part.columns[:, None], part.columns] += part.products
        total.slow[:, :, part.columns[:, None], part.columns] += part.slow
        total.windows[:] += part.windows
        total.gram[part.cells] += part.gram
        runs.append(part.run)
    return total, tuple(runs)
