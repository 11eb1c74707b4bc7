"""From a log to its part of the map: the default method and the observer as published.

Default. Scheduling parameters from smoothed signals; the state by the observer of Eq. (26) with a gain whose last column is zero,
so that the state error does not depend on the map and decays as the certificate of the gain proves, inside its region; then the map
in information form (see `information`), from every balance that the engine offers. In this cascade the map's error is that of least
squares, driven by a decaying state error, noise and model error. Theorem 1 itself is proven for one balance and constant Gamma (or,
where the certificate says so, for gains that fall with information); it is not claimed for the mixture of balances.

Published. Eq. (26) as printed, on the signals as recorded, Gamma = 200 I: what remains in a cell is its last visit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.airpath.base import AirPath
from lpvobs.errors import DataError
from lpvobs.maps.excitation import Excitation, excitation, node_values
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, scaled_terms
from lpvobs.observer.balance_errors import cell_numbers, mix
from lpvobs.observer.information import Information, assemble, empty, solve
from lpvobs.observer.recursion import observe
from lpvobs.observer.settings import EstimateSettings, PublishedSettings
from lpvobs.observer.smoothing import smooth
from lpvobs.records import Array, Defects, Log


@dataclass(frozen=True)
class StateGain:
    """The part of a synthesised gain that the recursion needs.

    Attributes
    ----------
    outputs : tuple of str
        Measured states among the outputs; the sensor comes after them.
    L : ndarray, shape (3, r)
    """

    outputs: tuple[str, ...]
    L: Array


@dataclass(frozen=True)
class LogRun:
    """What one log contributes.

    Attributes
    ----------
    name, sha256 : str
    samples : int
    duration : float
        [s], without gaps.
    defects : Defects
    excitation : Excitation
    parameters : ndarray, shape (N, m)
        The scheduling parameters, for the share inside a certificate.
    """

    name: str
    sha256: str
    samples: int
    duration: float
    defects: Defects
    excitation: Excitation
    parameters: Array


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
        raise DataError(
            f"log '{log.name}': a gap after every sample, the first at {log.time[0]:.6g} s; "
            f"expected samples closer than gap_limit in [policies]"
        )
    return steps


def estimate_default(
    air_path: AirPath, grid: Grid, gain: StateGain, logs: Sequence[Log], settings: EstimateSettings
) -> MapEstimate:
    """Return the map from one or more logs by the default method."""
    settings = settings.limited_to(air_path.balance_constants)
    total = empty(grid.size, len(settings.tolerance) + len(COEFFICIENTS))
    runs = []
    for log in logs:
        information, run = inform(air_path, grid, gain, log, settings)
        total += information
        runs.append(run)
    solution = solve(total, settings.prior_map)
    q = len(settings.tolerance)
    sensitivity, design = solution.response[:, :q], solution.response[:, q:]
    covariance = solution.covariance(np.concatenate([settings.constants_variance, np.zeros(len(COEFFICIENTS))]))
    estimate = finished("observer", grid, solution.theta, covariance, runs, settings)
    return replace(
        estimate,
        noise=solution.noise,
        design=design,
        constants=tuple(settings.tolerance),
        sensitivity=sensitivity.T.reshape(-1, *grid.shape),
    )


def inform(
    air_path: AirPath, grid: Grid, gain: StateGain, log: Log, settings: EstimateSettings
) -> tuple[Information, LogRun]:
    """Return the information of one log about the map, coupled to the uncertain constants and to the terms of Eq. (37)."""
    if np.any(gain.L[:, -1] != 0.0):
        raise DataError(
            "gain: the sensor corrects the state (last column of L is not zero), expected a cascade for the default method; "
            "synthesise with cascade = true in [gain], or use --method published"
        )
    steps = steps_of(log)
    calm, rates = calmed(air_path, log, settings.smoothing)
    trajectory = air_path.trajectory(calm, gain.outputs)
    point = operating_point(air_path, log)
    first = np.stack([[calm[state][start] for state in air_path.state_names] for start, _ in log.segments])
    run = observe(trajectory, log.time, log.segments, point, grid, gain.L, 0.0, first, np.zeros(grid.size))
    seen = replace(calm, channels={**calm.channels, **dict(zip(air_path.state_names, run.x.T, strict=True))})
    balances = air_path.balances(seen, rates, tuple(settings.tolerance))
    z = log[air_path.sensor] - balances.flow
    nodes, weights = grid.regressors(*point)
    cells = cell_numbers(grid, nodes)
    excited = excitation(grid, *point, log.time, log.segments)
    residual = _about_own_map(excited, z, steps, nodes, weights)
    mixture = mix(
        grid, residual, balances.slope, settings.constants_variance, steps, cells, log.segments, excited.leverage()
    )
    share = mixture.share[cells].T
    responses = np.concatenate([-np.einsum("bk,bik->ik", share, balances.slope), scaled_terms(grid, *point).T])
    information = assemble(
        grid.size, (nodes, weights), steps / mixture.density[cells], np.einsum("bk,bk->k", share, z), responses
    )
    return information, run_of(log, excited, trajectory.parameters, steps)


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
    runs = []
    for log in logs:
        trajectory = air_path.trajectory(log, gain.outputs, published.temperatures)
        point = operating_point(air_path, log)
        first = np.tile(published.x_0, (len(log.segments), 1))
        run = observe(trajectory, log.time, log.segments, point, grid, gain.L, published.gamma, first, theta)
        theta = run.theta
        steps = steps_of(log)
        runs.append(run_of(log, excitation(grid, *point, log.time, log.segments), trajectory.parameters, steps))
    return finished("published", grid, theta, np.full((grid.size, grid.size), np.nan), runs, settings)


def finished(
    method: str, grid: Grid, theta: Array, covariance: Array, runs: Sequence[LogRun], settings: EstimateSettings
) -> MapEstimate:
    """Return the estimate with the nodes marked that the drives inform."""
    excited = runs[0].excitation
    for run in runs[1:]:
        excited = excited + run.excitation
    n, u = np.meshgrid(grid.n_e, grid.u_delta, indexing="ij")
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


def operating_point(air_path: AirPath, log: Log) -> tuple[Array, Array]:
    """Return the map's inputs along a log, each of shape (N,): fuel, speed."""
    fuel, speed = air_path.axes
    return log[fuel.channel], log[speed.channel]


def _about_own_map(excited: Excitation, z: Array, steps: Array, nodes: NDArray[np.int64], weights: Array) -> Array:
    """Return the residual of each balance about the map that fits it best, shape (B, N)."""
    p = excited.gram.shape[0]
    weighted = ((steps[:, None] * weights * row[:, None]).ravel() for row in z)
    right: Array = np.stack([np.bincount(nodes.ravel(), part, minlength=p) for part in weighted], axis=1).astype(float)
    own = node_values(excited.gram, right)
    return np.stack([row - np.einsum("km,km->k", weights, theta[nodes]) for row, theta in zip(z, own.T, strict=True)])


def run_of(log: Log, excited: Excitation, parameters: Array, steps: Array) -> LogRun:
    """Return what a result keeps of a log."""
    return LogRun(log.name, log.sha256, len(log), float(steps.sum()), log.defects, excited, parameters)
