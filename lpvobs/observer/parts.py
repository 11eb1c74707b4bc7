"""What one log contributes to the map: found in one pass over the log, small, and added up over logs.

The passes of the method meet every sample once, block by block: smoothing, scheduling parameters, the observer of Eq. (26), the
balances, the sums per cell. What follows (the mixture of balances, the weights) is computed from the sums.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.base import AirPath, Trajectory
from lpvobs.errors import DataError
from lpvobs.maps.excitation import Excitation, corners, node_values, over_nodes
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, scaled_terms
from lpvobs.observer.balance_errors import Evidence, mix
from lpvobs.observer.cells import CellSums, add, end_visit, no_sums, no_visit
from lpvobs.observer.information import Information
from lpvobs.observer.recursion import observe
from lpvobs.observer.settings import EstimateSettings
from lpvobs.observer.smoothing import SmoothStretch, stretches
from lpvobs.records import Array, Defects, Log, Recording
from lpvobs.synthesis.region import Region


@dataclass(frozen=True)
class StateGain:
    """The part of a synthesised gain that the recursion needs.

    Attributes
    ----------
    outputs : tuple of str
        Measured states among the outputs; the sensor comes after them.
    L : ndarray, shape (n, r)
    region : Region or None
        What its certificate covers; None where nobody asks.
    """

    outputs: tuple[str, ...]
    L: Array
    region: Region | None = None


@dataclass(frozen=True)
class LogRun:
    """What an estimate keeps of a log.

    Attributes
    ----------
    name, sha256 : str
    samples : int
    duration : float
        [s], without gaps.
    defects : Defects
    lower, upper : ndarray, shape (m,)
        Range of the scheduling parameters along the log.
    share_certified : float
        Share of the samples inside the region of the gain's certificate; NaN without one.
    """

    name: str
    sha256: str
    samples: int
    duration: float
    defects: Defects
    lower: Array
    upper: Array
    share_certified: float


@dataclass(frozen=True)
class LogInformation:
    """The information of one log about the map, in the cells that it visited.

    Attributes
    ----------
    run : LogRun
    cells : ndarray of int, shape (v,)
        Numbers of the cells, row by row.
    gram : ndarray, shape (v, 4, 4)
        [s], the integral of Psi^T Psi.
    H : ndarray, shape (v, 4, 4)
        [s^2/kg^2], the same, weighted.
    h : ndarray, shape (v, 4)
        [s/kg], the integral of w Psi z.
    coupling : ndarray, shape (v, q + 6, 4)
        The integral of w Psi g for the engine's constants, and of w Psi times the terms of Eq. (37).
    """

    run: LogRun
    cells: NDArray[np.int64]
    gram: Array
    H: Array
    h: Array
    coupling: Array


@dataclass(frozen=True)
class Observed:
    """What the observer makes of a log of N samples that is in memory, B balances.

    Attributes
    ----------
    log : Log
    parameters : ndarray, shape (N, m)
        Scheduling parameters.
    point : tuple of ndarray, shape (N,)
        The map's inputs: fuel, speed.
    z : ndarray, shape (B, N)
        [kg/s], the sensor's reading less the flow of each balance.
    slope : ndarray, shape (B, q, N)
        [kg/s], derivative of each flow by the relative change of each uncertain constant.
    """

    log: Log
    parameters: Array
    point: tuple[Array, Array]
    z: Array
    slope: Array


def inform_observed(grid: Grid, region: Region | None, seen: Observed, constants_variance: Array) -> LogInformation:
    """Return the part of a log whose flows are known; raises DataError if no two samples are neighbours."""
    log, sums = seen.log, no_sums(grid, *seen.slope.shape[:2])
    visit, run = no_visit(seen.z.shape[0]), RangeSeen(seen.parameters.shape[1], region)
    steps = np.diff(log.time, prepend=log.time[0])
    steps[[start for start, _ in log.segments]] = 0.0
    run.see(log.time, steps, seen.parameters)
    if not run.duration > 0.0:
        raise nothing_between(log.name, run.started)
    for part in log.each_segment():
        point = (seen.point[0][part], seen.point[1][part])
        z, slope = np.ascontiguousarray(seen.z[:, part]), np.ascontiguousarray(seen.slope[..., part])
        add(sums, visit, grid, point, steps[part], z, slope, scaled_terms(grid, *point))
        end_visit(sums, visit)
    return _part(grid, sums, constants_variance, run.run(log))


def inform(
    air_path: AirPath, grid: Grid, gain: StateGain, log: Recording, settings: EstimateSettings
) -> LogInformation:
    """Return the part of one log, read once from beginning to end.

    Raises
    ------
    DataError
        If the gain is no cascade, or no two samples of the log are neighbours.
    """
    if np.any(gain.L[:, -1] != 0.0):
        raise DataError(
            "gain: the sensor corrects the state (last column of L is not zero), expected a cascade for the default method; "
            "synthesise with cascade = true in [gain], or use --method published"
        )
    walk = _Walk(air_path, grid, gain, tuple(settings.tolerance))
    for stretch in stretches(log.pieces(), air_path.smoothed, settings.smoothing):
        walk.follow(stretch)
    walk.end_segment()
    if not walk.range.duration > 0.0:
        raise nothing_between(log.name, walk.range.started)
    return _part(grid, walk.sums, settings.constants_variance, walk.range.run(log))


def nothing_between(name: str, started: float) -> DataError:
    """Return what is wrong with a log whose samples are all apart."""
    return DataError(
        f"log '{name}': a gap after every sample, the first at {started:.6g} s; "
        f"expected samples closer than gap_limit in [policies]"
    )


class RangeSeen:
    """Samples, time and range of the scheduling parameters so far."""

    def __init__(self, parameters: int, region: Region | None):
        self.samples, self.duration, self.inside, self.started = 0, 0.0, 0, float("nan")
        self.lower, self.upper = np.full(parameters, np.inf), np.full(parameters, -np.inf)
        self.region = region

    def see(self, time: Array, steps: Array, parameters: Array) -> None:
        """Take in N samples."""
        if not self.samples:
            self.started = float(time[0])
        self.samples += time.size
        self.duration = running_sum(self.duration, steps)
        np.minimum(self.lower, parameters.min(axis=0), out=self.lower)
        np.maximum(self.upper, parameters.max(axis=0), out=self.upper)
        if self.region is not None:
            self.inside += int(np.count_nonzero(self.region.contains(parameters)))

    def run(self, log: Recording) -> LogRun:
        """Return what is kept of the log that has been gone through."""
        share = float("nan") if self.region is None else self.inside / self.samples
        return LogRun(log.name, log.sha256, self.samples, self.duration, log.defects, self.lower, self.upper, share)


def running_sum(start: float, values: Array) -> float:
    """Return start plus the values, added one after the other, so that it does not matter how they come in pieces."""
    return float(np.add.accumulate(np.concatenate(([start], values)))[-1])


class _Walk:
    """The default method on its way along a log: the state, the visit that has not ended, the sums so far."""

    def __init__(self, air_path: AirPath, grid: Grid, gain: StateGain, uncertain: tuple[str, ...]):
        self.air_path, self.grid, self.gain, self.uncertain = air_path, grid, gain, uncertain
        self.sums: CellSums | None = None
        self.range = RangeSeen(len(air_path.parameter_names), gain.region)
        self.x = np.zeros(len(air_path.state_names))
        self.no_map = np.zeros(grid.size)

    def follow(self, stretch: SmoothStretch) -> None:
        """Go on by one stretch."""
        air_path = self.air_path
        calm = calm_log(stretch)
        trajectory = air_path.trajectory(calm, self.gain.outputs)
        self.range.see(stretch.time, stretch.steps, trajectory.parameters)
        seen = {**calm.channels, **self._states(stretch, calm, trajectory)}
        balances = air_path.balances(_log(stretch.time, seen), stretch.rates, self.uncertain)
        if stretch.begins:
            self.end_segment()
        if self.sums is None:
            self.sums = no_sums(self.grid, *balances.slope.shape[:2])
            self.visit = no_visit(balances.slope.shape[0])
        point = operating_point(air_path, calm)
        z = stretch.channels[air_path.sensor] - balances.flow
        terms = scaled_terms(self.grid, *point)
        add(self.sums, self.visit, self.grid, point, stretch.steps, z, balances.slope, terms)

    def end_segment(self) -> None:
        """Close the visit."""
        if self.sums is not None:
            end_visit(self.sums, self.visit)

    def _states(self, stretch: SmoothStretch, calm: Log, trajectory: Trajectory) -> dict[str, Array]:
        names = self.air_path.state_names
        first = self.air_path.states(calm)[0] if stretch.begins else self.x
        run = observe(
            trajectory,
            stretch.time,
            ((0, stretch.time.size),),
            operating_point(self.air_path, calm),
            self.grid,
            self.gain.L,
            0.0,
            first[None, :],
            self.no_map,
            None if stretch.begins else stretch.before,
        )
        self.x = run.x[-1]
        return dict(zip(names, np.ascontiguousarray(run.x.T), strict=True))


def calm_log(stretch: SmoothStretch) -> Log:
    """Return a stretch as a log with its smoothed channels in place of those as recorded."""
    return _log(stretch.time, {**stretch.channels, **stretch.values})


def _log(time: Array, channels: dict[str, Array]) -> Log:
    return Log("", "", time, channels, {}, ((0, time.size),), np.empty(0, dtype=np.int64), Defects(time.size))


def operating_point(air_path: AirPath, log: Log) -> tuple[Array, Array]:
    """Return the map's inputs along a log, each of shape (N,): fuel, speed."""
    fuel, speed = air_path.axes
    return log[fuel.channel], log[speed.channel]


def _part(grid: Grid, sums: CellSums | None, constants_variance: Array, run: LogRun) -> LogInformation:
    """Return what the sums of a log say of the map."""
    if sums is None:
        raise nothing_between(run.name, float("nan"))
    rows, columns = grid.speed.size - 1, grid.fuel.size - 1
    excited = Excitation(over_nodes(grid, sums.gram), sums.gram.reshape(rows, columns, 4, 4))
    evidence = Evidence(
        power=_about_own_map(grid, excited, sums),
        time=sums.gram.sum((1, 2)),
        visits=sums.visits,
        slope=sums.slope.sum(-1),
        leverage=excited.leverage().ravel(),
    )
    mixture = mix((rows, columns), evidence, constants_variance)
    share, weight = mixture.share, 1.0 / mixture.density
    coupling = np.concatenate([-np.einsum("cb,cbim->cim", share, sums.slope), sums.terms], axis=1)
    visited = np.flatnonzero(evidence.time > 0.0)
    return LogInformation(
        run=run,
        cells=visited,
        gram=sums.gram[visited],
        H=(weight[:, None, None] * sums.gram)[visited],
        h=(weight[:, None] * np.einsum("cb,cbm->cm", share, sums.right))[visited],
        coupling=(weight[:, None, None] * coupling)[visited],
    )


def _about_own_map(grid: Grid, excited: Excitation, sums: CellSums) -> Array:
    """Return the power of the visits' residuals about the map that fits each balance best, shape (cells, B, B).

    Of a visit, the integral of the residual is that of z less that of Psi times the four nodes, so the products follow from those
    of the integrals.
    """
    nodes = corners(*grid.shape)
    right = np.zeros((grid.size, sums.right.shape[1]))
    np.add.at(right, nodes, sums.right.swapaxes(1, 2))
    theta = node_values(excited.gram, right)[nodes]  # (cells, 4, B)
    crossed = np.einsum("cam,cmb->cab", sums.visit_cross, theta)
    fitted = np.einsum("cma,cmo,cob->cab", theta, sums.visit_gram, theta, optimize=True)
    power = sums.visit_power - crossed - crossed.swapaxes(1, 2) + fitted
    B = power.shape[1]
    power[:, range(B), range(B)] = np.maximum(power[:, range(B), range(B)], 0.0)  # rounding of a difference
    return np.asarray(power)


def added_up(grid: Grid, constants: int, parts: Iterable[LogInformation]) -> tuple[Information, Excitation]:
    """Return the information and the excitation of logs together, added in the order given."""
    rows, columns = grid.speed.size - 1, grid.fuel.size - 1
    count = rows * columns
    gram, H, h = np.zeros((count, 4, 4)), np.zeros((count, 4, 4)), np.zeros((count, 4))
    coupling = np.zeros((count, constants + len(COEFFICIENTS), 4))
    for part in parts:
        gram[part.cells] += part.gram
        H[part.cells] += part.H
        h[part.cells] += part.h
        coupling[part.cells] += part.coupling
    nodes = corners(*grid.shape)
    total = Information(over_nodes(grid, H), np.zeros(grid.size), np.zeros((grid.size, coupling.shape[1])))
    np.add.at(total.h, nodes, h)
    np.add.at(total.coupling, nodes, coupling.swapaxes(1, 2))
    return total, Excitation(over_nodes(grid, gram), gram.reshape(rows, columns, 4, 4))
