"""What every engine offers, so that gain, observer, tracer and report need not know which one they serve."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from lpvobs.records import Array, Log


@dataclass(frozen=True)
class Channel:
    """A channel that the engine's air path needs.

    Attributes
    ----------
    unit : str
        The unit of the contract; readers convert to it.
    low, high : float
        What a working sensor can read at all, in that unit; a sample outside is a defect.
    typical : tuple of float
        Range in which the median of a whole log lies; outside, the unit or the sign is wrong.
    meaning : str
        For people.
    still : float
        [s], longest time that a working sensor may stand exactly still while the engine moves; infinite for what may rest
        for a whole log, such as a valve or the weather.
    above : tuple of str and float, optional
        A channel that this one does not fall below by more than so much, in a healthy engine.
    reaches : float
        What some sample of every log reaches.
    """

    unit: str
    low: float
    high: float
    typical: tuple[float, float]
    meaning: str
    still: float = math.inf
    above: tuple[str, float] | None = None
    reaches: float = -math.inf


@dataclass(frozen=True)
class MapAxis:
    """One input of the error map."""

    channel: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Trajectory:
    """The LPV system of Eq. (24) along a log: N samples, 3 states, r outputs.

    The observer is at its fastest where neighbouring samples lie beside each other in memory.

    Attributes
    ----------
    parameters : ndarray, shape (N, m)
        The scheduling parameters in the order of `AirPath.parameter_names` (for the diesel rho_1..rho_5, a_1, a_2).
    A : ndarray, shape (N, 3, 3)
        [1/s and mixed]
    E : ndarray, shape (N, 3)
        Known input of the state equation.
    C : ndarray, shape (N, r, 3)
        Output matrix; the last row, C_2, carries the map.
    y : ndarray, shape (N, r)
        Measured outputs y_m; the last, y_m2, is the mass air flow sensor.
    steady : int
        Outputs, from the first on, whose row of C is the same for all samples: they cost less.
    """

    parameters: Array
    A: Array
    E: Array
    C: Array
    y: Array
    steady: int = 0


@dataclass(frozen=True)
class Balances:
    """Independent estimates of the true flow past the sensor, from everything but the sensor.

    Attributes
    ----------
    names : tuple of str
        B balances.
    flow : ndarray, shape (B, N)
        [kg/s]
    slope : ndarray, shape (B, q, N)
        [kg/s], derivative of each flow by the relative change of each of q uncertain constants.
    """

    names: tuple[str, ...]
    flow: Array
    slope: Array


class AirPath(Protocol):
    """An engine's air path."""

    @property
    def name(self) -> str:
        """Which engine this is, as in the configuration."""

    @property
    def channels(self) -> Mapping[str, Channel]:
        """Needed channels, the sensor under test among them."""

    @property
    def smoothed(self) -> tuple[str, ...]:
        """Measured states and temperatures that enter the scheduling parameters."""

    @property
    def axes(self) -> tuple[MapAxis, MapAxis]:
        """Inputs of the map: the fuel axis (p_1 nodes), then the speed axis (p_2 nodes)."""

    @property
    def sensor(self) -> str:
        """The channel of the sensor under test."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states x."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the scheduling parameters."""

    @property
    def temperature_names(self) -> tuple[str, ...]:
        """Names of the temperatures that `rate_bounds` takes."""

    @property
    def balance_constants(self) -> tuple[str, ...]:
        """Names of the engine constants that a balance depends on."""

    @property
    def rate_names(self) -> tuple[str, ...]:
        """Names of the parameters that `rate_bounds` gives."""

    def engine_constants(self) -> Mapping[str, float]:
        """Return every constant of the engine by name."""

    def rate_bounds(self, temperatures: Mapping[str, tuple[float, float]]) -> Mapping[str, tuple[float, float]]:
        """Return the range of the parameters that depend on temperatures alone, given the range of those [K]."""

    def trajectory(self, log: Log, outputs: Sequence[str], constant: Mapping[str, float] | None = None) -> Trajectory:
        """Return the LPV system along a log; `outputs` names the measured states, the sensor is added last.

        `constant` holds temperatures that the parameters of `rate_bounds` are computed from instead of the log's.
        """

    @staticmethod
    def system(parameters: Sequence[Any], outputs: Sequence[str]) -> tuple[list[list[Any]], list[list[Any]]]:
        """Return A and C as nested lists for parameters of any number type (floats or exact fractions)."""

    @property
    def learns(self) -> bool:
        """Whether parts of the engine are known only after a healthy log has shown them."""

    def fingerprint(self) -> str:
        """Return a text that changes with what was learned; empty where nothing is."""

    def learned_from(self, logs: Sequence[Log]) -> "AirPath":
        """Return the air path with what it learns of the engine from healthy logs; itself where all is configured."""

    def states(self, log: Log) -> Array:
        """Return the states along a log as measured, shape (N, 3), computed where no sensor shows them."""

    def balances(self, log: Log, rates: Mapping[str, Array], uncertain: Sequence[str]) -> Balances:
        """Return the redundant flows along a log, given the time derivative of each smoothed channel."""
