"""The map before the logs of a search: none but a wide prior, or a stored one."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery import thresholds
from lpvobs.maps.grid import Grid
from lpvobs.records import Array


@dataclass(frozen=True)
class MapPrior:
    """The map before these logs: theta = mean + sensitivity beta + error."""

    mean: Array  # (p,) [kg/s]
    precision: Array  # (p, p) [s^2/kg^2] inverse covariance of the error
    sensitivity: Array  # (p, q) [kg/s] derivative of the map by the relative error of each constant
    free: bool  # whether the map is estimated from these logs

    def beside(self, deviation: Array) -> "MapPrior":
        """Return the map beside an engine whose constants deviate by so much more, shape (q,)."""
        return replace(self, mean=self.mean + self.sensitivity @ deviation)

    @cached_property
    def standard_error(self) -> Array:
        """Standard error of every node for given constants, shape (p,) [kg/s]."""
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.precision))))

    @cached_property
    def estimated(self) -> NDArray[np.bool_]:
        """Whether each node was estimated before, shape (p,)."""
        return np.asarray((np.diag(self.precision) > thresholds.UNKNOWN * self.precision.max()) & (not self.free))


def free_map(grid: Grid, q: int, prior_map: float) -> MapPrior:
    """Return the prior of a map that these logs make: a wide one [kg/s]."""
    p = grid.size
    return MapPrior(np.zeros(p), np.eye(p) / prior_map**2, np.zeros((p, q)), True)


def nominal_map(theta: Array, covariance: Array, sensitivity: Array, constants: Array, prior_map: float) -> MapPrior:
    """Return a stored map as what is known before other logs.

    The map theta, shape (p_2, p_1), and its sensitivity, shape (q, p_2, p_1), are in kg/s, NaN where not estimated; its covariance,
    shape (p, p) [kg^2/s^2], holds noise and constants together, as stored. `constants`, shape (q, q), is the covariance of their
    relative errors beside this map, `prior_map` [kg/s] the standard deviation of a node that is not estimated.
    """
    known = np.isfinite(theta).ravel()
    S = np.nan_to_num(sensitivity.reshape(len(constants), known.size).T)
    noise = covariance - S @ constants @ S.T
    own = np.where(known, thresholds.LIKENESS**2, prior_map**2)
    noise = np.where(np.outer(known, known), noise, 0.0) + np.diag(own)
    values, vectors = np.linalg.eigh(0.5 * (noise + noise.T))
    precision = (vectors / np.maximum(values, thresholds.LIKENESS**2)) @ vectors.T
    return MapPrior(np.nan_to_num(theta).ravel(), precision, S, False)
