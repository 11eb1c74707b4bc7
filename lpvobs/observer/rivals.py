"""The methods that the default is compared with, on the same logs: extended Kalman filter and batch least squares.

Both take the flow from the compressor balance alone, as the paper's observer does, on the signals as recorded.
"""

from collections.abc import Sequence

import numpy as np

from lpvobs.engines.base import AirPath
from lpvobs.maps.excitation import excitation
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import normal_equations
from lpvobs.observer.ekf import KalmanSettings, adapt, start
from lpvobs.observer.estimate import MapEstimate, finished, run_of, steps_of
from lpvobs.observer.parts import StateGain, operating_point
from lpvobs.observer.settings import EstimateSettings
from lpvobs.records import Log

NO_PRIOR = 1e4  # against weights that count samples: a node seen for a thousandth of a sample is left to the data


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
    state = start(grid, kalman, n)
    excited, runs = [], []
    for log in logs:
        trajectory, point = air_path.trajectory(log, gain.outputs), operating_point(air_path, log)
        first = air_path.states(log)[[begin for begin, _ in log.segments]]
        state = adapt(
            state, trajectory, log.time, log.segments, point, grid, measurement, process, kalman.map_drift, first
        )
        excited.append(excitation(grid, *point, log.time, log.segments))
        runs.append(run_of(log, trajectory.parameters, gain.region, air_path.sensor))
    return finished("ekf", grid, state.theta, state.P[n:, n:], runs, sum(excited[1:], excited[0]), settings)


def estimate_batch(
    air_path: AirPath, grid: Grid, gain: StateGain, logs: Sequence[Log], settings: EstimateSettings
) -> MapEstimate:
    """Return the map that fits sensor minus compressor flow best in the least squares of all samples."""
    # The standard errors are those of the textbook, for white errors of equal variance.
    p = grid.size
    gram, right, squares, samples = np.zeros((p, p)), np.zeros(p), 0.0, 0
    excited, runs = [], []
    for log in logs:
        trajectory, point = air_path.trajectory(log, gain.outputs), operating_point(air_path, log)
        used = steps_of(log) > 0
        z = (trajectory.y[:, -1] - np.einsum("kj,kj->k", trajectory.C[:, -1], air_path.states(log)))[used]
        nodes, weights = grid.regressors(*point)
        more = normal_equations(p, nodes[used], weights[used], z)
        gram, right, squares, samples = gram + more[0], right + more[1], squares + float(z @ z), samples + z.size
        excited.append(excitation(grid, *point, log.time, log.segments))
        runs.append(run_of(log, trajectory.parameters, gain.region, air_path.sensor))
    inverse = np.linalg.inv(gram + np.eye(p) / NO_PRIOR**2)
    theta = inverse @ right
    variance = max(squares - float(theta @ right), 0.0) / max(samples - p, 1)
    covariance = variance * 0.5 * (inverse + inverse.T)
    return finished("batch", grid, theta, covariance, runs, sum(excited[1:], excited[0]), settings)
