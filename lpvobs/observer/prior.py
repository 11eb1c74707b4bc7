"""What is known of map and engine before the logs, and how large what is not known may be."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from lpvobs.engines.unknowns import Unknowns, matern
from lpvobs.maps.grid import Grid
from lpvobs.observer.windows import SENSOR, Columns
from lpvobs.records import Array

AMPLITUDES = (0.03, 0.06, 0.12, 0.3, 0.7, 1.5, 3.0)
"""Of the corrections, over those of `Component.deviation`: what is tried. The least decides on an engine that needs none. With
0.05, 0.03, 0.02 the map was off by 1.75, 1.59, 1.51 % on ETC (ten engines with constants within 1 %), and by 0.78, 0.79, 0.81 %
on FTP75 (twelve), where 96, 95, 93 % of the 90 % intervals held."""
SWEEPS = 2  # over all numbers that are sought one after the other
ALIKE = 1.0 / 3.0
"""Of an axis of the map, the length over which errors that repeat are correlated. On twelve engines with all differences from the
model, a fifth, a third and a half gave maps that are off by 0.415, 0.415 and 0.416 % of the air flow; 94 % of the 90 % intervals of
the nodes held, and 81, 94, 96 % of those of means over a quarter of the map."""
FOLLOWS = 0.1  # standard deviation of the slope of the sensor's error over the flow, where it follows the flow
STAYS = 1e-6  # the same where it does not
AMPLITUDE_SPREAD = 3.0  # standard deviation of the logarithm of an amplitude before any data: a factor of twenty


@dataclass(frozen=True)
class Scales:
    """How large what is not known can be."""

    amplitudes: tuple[float, ...]  # of the groups of corrections
    follows: bool = False  # whether the sensor's error follows the flow


@dataclass(frozen=True)
class Prior:
    """What is known before the logs."""

    node: float  # [kg/s], standard deviation of a node, far beyond any sensor
    unknowns: Unknowns
    alike: Array  # (p, p) correlation of the errors of a balance that repeat at the nodes
    may_follow: bool = True  # whether the sensor's error may follow the flow

    def mean(self, layout: Columns) -> Array:
        """Return the mean of all columns that are solved for."""
        found = np.zeros(layout.solved)
        found[layout.engine] = self.unknowns.mean
        return found

    def root(self, scales: Scales, flow: float) -> Array:
        """Return a square root of the covariance of all but the map, lower triangular.

        The mean flow [kg/s] is the unit of powers of the reading.
        """
        covariance = self.unknowns.scaled(scales.amplitudes)
        ridge = 1e-9 * np.diag(covariance) + 1e-18
        sensor = (FOLLOWS if scales.follows else STAYS) * flow ** -np.arange(SENSOR)
        return np.asarray(scipy.linalg.block_diag(np.linalg.cholesky(covariance + np.diag(ridge)), np.diag(sensor)))


def prior_of(grid: Grid, node: float, unknowns: Unknowns) -> Prior:
    """Return the prior of logs; `node` [kg/s] is the standard deviation of a node."""
    axes = (grid.speed, grid.fuel)
    return Prior(node, unknowns, matern(axes, [ALIKE * float(np.ptp(nodes)) for nodes in axes]))


def swept(
    start: Sequence[float], choices: Sequence[Sequence[float]], cost: Callable[[tuple[float, ...]], float]
) -> tuple[float, ...]:
    """Return the numbers of least cost, sought one after the other among the choices of each, `SWEEPS` times over all."""
    best, cost = tuple(start), cache(cost)
    for _ in range(SWEEPS):
        for i, among in enumerate(choices):
            best = min(((*best[:i], choice, *best[i + 1 :]) for choice in among), key=cost)
    return best
