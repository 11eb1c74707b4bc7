"""From logs to the map: the default method and the observer as published.

Default. Scheduling parameters from smoothed signals; the state by the observer of Eq. (26) with the map's part left out, a gain
whose last column is zero; then the map by weighted least squares behind that state, from every balance of the engine. It is not the
map equation of Eq. (26): `information` says how it departs. Theorem 1 is proven for one balance and constant Gamma (or, where the
certificate says so, for gains that fall with information); it is not claimed for the mixture of balances. The certificate is about
the state, and the state is nearly its newest measurement: of a gain of 2000 1/s and samples 10 ms apart, 95 % (1 - 1 / (1 + h L)).

Published. Eq. (26) as printed, on the signals as recorded, Gamma = 200 I: what remains in a cell is its last visit.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.base import AirPath
from lpvobs.maps.excitation import Excitation, excitation
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, scaled_terms
from lpvobs.observer.information import Solution, solve
from lpvobs.observer.parts import (
    LogInformation,
    LogRun,
    RangeSeen,
    StateGain,
    added_up,
    inform,
    nothing_between,
    operating_point,
)
from lpvobs.observer.recursion import observe
from lpvobs.observer.settings import EstimateSettings, PublishedSettings
from lpvobs.observer.smoothing import smooth
from lpvobs.records import Array, Log, Recording
from lpvobs.synthesis.region import Region


@dataclass(frozen=True)
class MapEstimate:
    """The map and how good it is.

    Attributes
    ----------
    method : str
    grid : Grid
    theta : ndarray, shape (p_2, p_1)
        [kg/s], NaN where nothing supports it.
    covariance : ndarray, shape (p, p)
        [kg^2/s^2], of all nodes.
    noise : ndarray, shape (p, p)
        [kg^2/s^2], the part of it that does not come from the engine's constants.
    design : ndarray, shape (p, 6)
        The node values that the method would find for each term of Eq. (37), see `lpvobs.maps.quadratic.fit`.
    supported : ndarray of bool, shape (p_2, p_1)
    excitation : ndarray, shape (p_2 - 1, p_1 - 1)
        [s], delta_1 of Eq. (29) of every cell.
    runs : tuple of LogRun
    constants : tuple of str
        The q uncertain constants of the engine; none where the method does not tell.
    sensitivity : ndarray, shape (q, p_2, p_1)
        [kg/s], change of the map per relative error of each constant.
    """

    method: str
    grid: Grid
    theta: Array
    covariance: Array
    noise: Array
    design: Array
    supported: NDArray[np.bool_]
    excitation: Array
    runs: tuple[LogRun, ...]
    constants: tuple[str, ...]
    sensitivity: Array

    @property
    def standard_error(self) -> Array:
        """Standard error of every node, shape (p_2, p_1), [kg/s], NaN where nothing supports it."""
        error = np.sqrt(np.diag(self.covariance)).reshape(self.grid.shape)
        return np.where(self.supported, error, np.nan)


def steps_of(log: Log) -> Array:
    """Return the time that each sample stands for, shape (N,) [s]; the first of a segment stands for none.

    Raises
    ------
    DataError
        If no two samples are neighbours.
    """
    steps = np.diff(log.time, prepend=log.time[0])
    for start, _ in log.segments:
        steps[start] = 0.0
    if not steps.any():
        raise nothing_between(log.name, float(log.time[0]))
    return steps


def estimate_default(
    air_path: AirPath, grid: Grid, gain: StateGain, logs: Sequence[Recording], settings: EstimateSettings
) -> MapEstimate:
    """Return the map from one or more logs by the default method."""
    settings = settings.limited_to(air_path.balance_constants)
    return of_parts(grid, [inform(air_path, grid, gain, log, settings) for log in logs], settings)


def of_parts(grid: Grid, parts: Sequence[LogInformation], settings: EstimateSettings) -> MapEstimate:
    """Return the map from the parts of logs, added in the order of the logs' digests."""
    in_order = sorted(parts, key=lambda part: part.run.sha256)
    return replace(merged(grid, in_order, settings)[0], runs=tuple(part.run for part in parts))


def merged(grid: Grid, parts: Iterable[LogInformation], settings: EstimateSettings) -> tuple[MapEstimate, Solution]:
    """Return the map from the parts of logs, and the solution behind it.

    The parts are looked at once, one after the other; the bits of a sum depend on their order, so give them in the order of the
    logs' digests.
    """
    q = len(settings.tolerance)
    runs: list[LogRun] = []

    def noted() -> Iterator[LogInformation]:
        for part in parts:
            runs.append(part.run)
            yield part

    total, excited = added_up(grid, q, noted())
    solution = solve(total, settings.prior_map)
    sensitivity, design = solution.response[:, :q], solution.response[:, q:]
    covariance = solution.covariance(np.concatenate([settings.constants_variance, np.zeros(len(COEFFICIENTS))]))
    estimate = replace(
        finished("observer", grid, solution.theta, covariance, runs, excited, settings),
        noise=solution.noise,
        design=design,
        constants=tuple(settings.tolerance),
        sensitivity=sensitivity.T.reshape(-1, *grid.shape),
    )
    return estimate, solution


def calmed(air_path: AirPath, log: Log, half_width: float) -> tuple[Log, dict[str, Array]]:
    """Return the log with smoothed states and temperatures, and the time derivative of each of those."""
    columns = np.stack([log[name] for name in air_path.smoothed])
    values, slopes = smooth(log.time, columns, log.segments, half_width)
    channels = {**log.channels, **dict(zip(air_path.smoothed, values, strict=True))}
    return replace(log, channels=channels), dict(zip(air_path.smoothed, slopes, strict=True))


def estimate_published(
    air_path: AirPath,
    grid: Grid,
    gain: StateGain,
    logs: Sequence[Log],
    published: PublishedSettings,
    settings: EstimateSettings,
) -> MapEstimate:
    """Return the map from the observer as published, logs one after another."""
    theta = np.zeros(grid.size)
    excited, runs = [], []
    for log in logs:
        trajectory = air_path.trajectory(log, gain.outputs, published.temperatures)
        point = operating_point(air_path, log)
        first = np.tile(published.x_0, (len(log.segments), 1))
        run = observe(trajectory, log.time, log.segments, point, grid, gain.L, published.gamma, first, theta)
        theta = run.theta
        excited.append(excitation(grid, *point, log.time, log.segments))
        runs.append(run_of(log, trajectory.parameters, gain.region))
    unknown = np.full((grid.size, grid.size), np.nan)
    return finished("published", grid, theta, unknown, runs, sum(excited[1:], excited[0]), settings)


def finished(
    method: str,
    grid: Grid,
    theta: Array,
    covariance: Array,
    runs: Sequence[LogRun],
    excited: Excitation,
    settings: EstimateSettings,
) -> MapEstimate:
    """Return the estimate with the nodes marked that the drives inform."""
    n, u = np.meshgrid(grid.speed, grid.fuel, indexing="ij")
    supported = (excited.nodes() >= settings.least_information).reshape(grid.shape)
    return MapEstimate(
        method=method,
        grid=grid,
        theta=np.where(supported, theta.reshape(grid.shape), np.nan),
        covariance=covariance,
        noise=covariance,
        design=scaled_terms(grid, u, n).reshape(grid.size, -1),
        supported=supported,
        excitation=excited.cells(),
        runs=tuple(runs),
        constants=(),
        sensitivity=np.empty((0, *grid.shape)),
    )


def run_of(log: Log, parameters: Array, region: Region | None) -> LogRun:
    """Return what an estimate keeps of a log, given the scheduling parameters along it, shape (N, m)."""
    seen = RangeSeen(parameters.shape[1], region)
    seen.see(log.time, steps_of(log), parameters)
    return seen.run(log)
