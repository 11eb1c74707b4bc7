"""The simple methods an engineer would use instead, for the table of rivals: means per cell and a curve over the flow.

All of them take the flow from the compressor balance on the signals as recorded, and return a map on the same grid.
"""

import numpy as np

from lpvobs.engines.base import AirPath
from lpvobs.maps.grid import Grid
from lpvobs.observer.parts import operating_point
from lpvobs.records import Array, Log

SLOW = 2e-3
"""[kg/s^2]; a sample counts as steady where the sensor moves less than this."""
LEAST_SAMPLES = 30


def compressor_error(air_path: AirPath, log: Log) -> tuple[Array, Array]:
    """Return sensor minus compressor flow and the compressor flow, each of shape (N,) [kg/s]."""
    trajectory = air_path.trajectory(log, ())
    flow = trajectory.C[:, -1, 2] * log["omega_t"]
    return log[air_path.sensor] - flow, flow


def mean_per_cell(air_path: AirPath, grid: Grid, log: Log, steady_only: bool) -> Array:
    """Return the mean error of the samples nearest to each node, shape (p_2, p_1), NaN where there are none."""
    error, _ = compressor_error(air_path, log)
    chosen = np.ones(error.size, dtype=bool)
    if steady_only:
        window = np.ones(20) / 20
        rate = np.gradient(np.convolve(log[air_path.sensor], window, mode="same"), log.time)
        chosen = np.abs(rate) < SLOW
    u_delta, n_e = operating_point(air_path, log)
    column = np.abs(u_delta[:, None] - grid.fuel).argmin(axis=1)
    row = np.abs(n_e[:, None] - grid.speed).argmin(axis=1)
    node = (row * grid.fuel.size + column)[chosen]
    count = np.bincount(node, minlength=grid.size)
    total = np.bincount(node, error[chosen], minlength=grid.size)
    enough = count >= (LEAST_SAMPLES if steady_only else 1)
    return np.where(enough, total / np.maximum(count, 1), np.nan).reshape(grid.shape)


def curve_over_flow(air_path: AirPath, log: Log, points: int = 20) -> Array:
    """Return, along the log, the mean error at the sensor's own reading: the one-dimensional map of the paper's reference 2.

    Piecewise linear over `points` nodes of equal share of samples, by least squares, shape (N,).
    """
    error, _ = compressor_error(air_path, log)
    reading = log[air_path.sensor]
    nodes = np.unique(np.quantile(reading, np.linspace(0, 1, points)))
    place = np.clip(np.searchsorted(nodes, reading) - 1, 0, nodes.size - 2)
    eta = np.clip((reading - nodes[place]) / (nodes[place + 1] - nodes[place]), 0.0, 1.0)
    design = np.zeros((reading.size, nodes.size))
    design[np.arange(reading.size), place] = 1.0 - eta
    design[np.arange(reading.size), place + 1] = eta
    return np.asarray(design @ np.linalg.lstsq(design, error, rcond=None)[0])
