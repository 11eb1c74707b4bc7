"""The methods that the default is compared with, on the same logs: the observer as published, a Kalman filter, batch least squares.

All take the flow from the compressor balance alone, as the paper's observer does, on the signals as recorded.
"""

from collections.abc import Sequence

import numpy as np

from lpvobs.engines.base import AirPath, Trajectory
from lpvobs.maps.excitation import Excitation, excitation, steps_of
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import normal_equations
from lpvobs.observer.ekf import KalmanSettings, adapt, start
from lpvobs.observer.estimate import MapEstimate, finished
from lpvobs.observer.log_run import LogRun, RangeSeen, nothing_between
from lpvobs.observer.parts import StateGain, operating_point
from lpvobs.observer.recursion import observe
from lpvobs.observer.settings import EstimateSettings, PublishedSettings
from lpvobs.records import Array, Log

NO_PRIOR = 1e4  # against weights that count samples: a node seen for a thousandth of a sample is left to the data


class _InTurn:
    """Logs that are gone through one after another."""

    def __init__(self, air_path: AirPath, grid: Grid, gain: StateGain):
        self.air_path, self.grid, self.gain = air_path, grid, gain
        self.excited: list[Excitation] = []
        self.runs: list[LogRun] = []

    def begin(self, log: Log) -> tuple[Trajectory, tuple[Array, Array]]:
        """Take note of the next log, and return its trajectory and the map's inputs along it."""
        trajectory = self.air_path.trajectory(log, self.gain.outputs)
        point = operating_point(self.air_path, log)
        seen = RangeSeen(trajectory.parameters.shape[1], self.gain.region)
        seen.see(trajectory.parameters, log.time, steps_of(log.time, log.segments), log[self.air_path.sensor])
        self.runs.append(seen.run(log))
        self.excited.append(excitation(self.grid, *point, log.time, log.segments))
        return trajectory, point

    def finished(self, method: str, theta: Array, covariance: Array, settings: EstimateSettings) -> MapEstimate:
        """Return the estimate from all of them."""
        excited = sum(self.excited[1:], self.excited[0])
        return finished(method, self.grid, theta, covariance, self.runs, excited, settings)


def estimate_published(
    air_path: AirPath,
    grid: Grid,
    gain: StateGain,
    logs: Sequence[Log],
    published: PublishedSettings,
    settings: EstimateSettings,
) -> MapEstimate:
    """Return the map from the observer as published: Eq. (26) as printed, Gamma = 200 I, logs one after another."""
    # What remains in a cell is its last visit. The observer takes the temperatures for constant; what the certificate covers
    # is judged by those of the drive.
    theta, in_turn = np.zeros(grid.size), _InTurn(air_path, grid, gain)
    for log in logs:
        _, point = in_turn.begin(log)
        trajectory = air_path.trajectory(log, gain.outputs, published.temperatures)
        first = np.tile(published.x_0, (len(log.segments), 1))
        theta = observe(trajectory, log.time, log.segments, point, grid, gain.L, published.gamma, first, theta).theta
    return in_turn.finished("published", theta, np.full((grid.size, grid.size), np.nan), settings)


def estimate_ekf(
    air_path: AirPath,
    grid: Grid,
    gain: StateGain,
    logs: Sequence[Log],
    kalman: KalmanSettings,
    settings: EstimateSettings,
) -> MapEstimate:
    """Return the map from an extended Kalman filter with n + p states, logs one after another."""
    channels = (*gain.outputs, air_path.sensor)
    measurement = np.array([kalman.measurement_noise[name] for name in channels]) ** 2
    process = np.array([kalman.process_noise[name] for name in air_path.state_names]) ** 2
    n = len(air_path.state_names)
    state, in_turn = start(grid, kalman, n), _InTurn(air_path, grid, gain)
    for log in logs:
        trajectory, point = in_turn.begin(log)
        first = air_path.states(log)[[begin for begin, _ in log.segments]]
        state = adapt(
            state, trajectory, log.time, log.segments, point, grid, measurement, process, kalman.map_drift, first
        )
    return in_turn.finished("ekf", state.theta, state.P[n:, n:], settings)


def estimate_batch(
    air_path: AirPath, grid: Grid, gain: StateGain, logs: Sequence[Log], settings: EstimateSettings
) -> MapEstimate:
    """Return the map that fits sensor minus compressor flow best in the least squares of all samples."""
    # The standard errors are those of the textbook, for white errors of equal variance.
    p, in_turn = grid.size, _InTurn(air_path, grid, gain)
    gram, right, squares, samples = np.zeros((p, p)), np.zeros(p), 0.0, 0
    for log in logs:
        trajectory, point = in_turn.begin(log)
        used = steps_of(log.time, log.segments) > 0
        if not used.any():
            raise nothing_between(log.name, float(log.time[0]))
        z = (trajectory.y[:, -1] - np.einsum("kj,kj->k", trajectory.C[:, -1], air_path.states(log)))[used]
        nodes, weights = grid.regressors(*point)
        more = normal_equations(p, nodes[used], weights[used], z)
        gram, right, squares, samples = gram + more[0], right + more[1], squares + float(z @ z), samples + z.size
    inverse = np.linalg.inv(gram + np.eye(p) / NO_PRIOR**2)
    theta = inverse @ right
    variance = max(squares - float(theta @ right), 0.0) / max(samples - p, 1)
    return in_turn.finished("batch", theta, variance * 0.5 * (inverse + inverse.T), settings)
