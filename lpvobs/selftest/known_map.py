"""A map that is known, and what lies between its nodes, from the definition."""

import numpy as np

from lpvobs.maps.grid import Grid
from lpvobs.records import Array


def known_map(grid: Grid) -> Array:
    """Return the error of the sensor at the nodes, shape (p_2, p_1) [kg/s]: a saddle of a few grams per second."""
    u, n = np.meshgrid(grid.fuel / grid.fuel[-1], grid.speed / grid.speed[-1])
    return np.asarray(1e-3 * (1.0 - 4.0 * u + 3.0 * n * n - 2.0 * u * n))


def bilinear(grid: Grid, theta: Array, u: Array, n: Array) -> Array:
    """Return a map between its nodes: along one axis, then along the other."""
    i = np.clip(np.searchsorted(grid.fuel, u, side="right") - 1, 0, grid.fuel.size - 2)
    j = np.clip(np.searchsorted(grid.speed, n, side="right") - 1, 0, grid.speed.size - 2)
    a = (u - grid.fuel[i]) / (grid.fuel[i + 1] - grid.fuel[i])
    b = (n - grid.speed[j]) / (grid.speed[j + 1] - grid.speed[j])
    below = (1.0 - a) * theta[j, i] + a * theta[j, i + 1]
    above = (1.0 - a) * theta[j + 1, i] + a * theta[j + 1, i + 1]
    return np.asarray((1.0 - b) * below + b * above)
