"""An engine that logs what series vehicles do, as an LPV system: states p_im and the flow past the sensor, W_c.

    dp_im/dt = a_im (W_c + W_egr - rho_cyl p_im),    dW_c/dt = 0

with rho_cyl = eta_vol n V_d / (120 R_a T_im), a_im = R_a T_im / V_im. Without compressor speed nothing drives W_c but the
observer's injection, so the sensor's map enters the output alone, as Theorem 1 wants. Departure from the paper: another engine.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from lpvobs.engines.base import SPEED_AXIS, AirPath, Balances, MapAxis, Trajectory, trajectory_of
from lpvobs.engines.channels import Channel, Columns, channels
from lpvobs.engines.components import intake
from lpvobs.engines.series import flows
from lpvobs.engines.series.constants import SeriesEngine, constants_of
from lpvobs.engines.unknowns import Caution, Correction
from lpvobs.records import Array, Log

STATES = ("p_im", "W_c")
TOLERANCE: Mapping[str, float] = {
    "R_a": 0.001, "R_e": 0.001, "V_d": 0.01, "V_im": 0.01, "c_vol1": 0.01, "c_vol2": 0.01, "c_vol3": 0.01,
    "A_egr_max": 0.1, "dp_0": 0.3, "dp_n": 0.3, "T_rise": 0.1, "air_fuel": 0.005, "k_fuel": 0.05,
}  # fmt: skip
"""Of constants of which the configuration says nothing: gases are in tables, what is fitted is good to a hundredth; pressure and
temperature of the exhaust are assumed; an injector's quantity scatters by some per cent."""
RELATIVE_STEP = 1e-5
MISSED = 0.25
"""[1] Share of the cylinders' air that a sensor may miss while the EGR valve is shut."""


@dataclass(frozen=True)
class SeriesPath(AirPath):
    """The air path of whatever is compared with the filling; see `lpvobs.engines.base.AirPath` for what each member means."""

    engine: SeriesEngine

    state_names = STATES
    parameter_names = ("rho_cyl", "a_im")
    temperature_names = ("T_im",)
    rate_names = ("a_im",)
    volumes = ("V_im",)
    cylinder_number = "n_cyl"

    @cached_property
    def constants(self) -> Any:
        """The engine's constants, flat."""
        return constants_of(self.engine)

    def engine_constants(self) -> Mapping[str, float]:
        """Return every constant of the engine by name."""
        return dict(self.constants._asdict())

    def rate_bounds(self, temperatures: Mapping[str, tuple[float, float]]) -> Mapping[str, tuple[float, float]]:
        """Return the range of a_im = R_a T_im / V_im [J/(kg m^3)]."""
        low, high = temperatures["T_im"]
        R_a, V_im = self.constants.R_a, self.constants.V_im
        return {"a_im": (R_a * low / V_im, R_a * high / V_im)}

    def trajectory(self, log: Log, outputs: Sequence[str], constant: Mapping[str, float] | None = None) -> Trajectory:
        """Return the LPV system along a log of N samples; `constant` holds a T_im [K] for a_im."""
        c, x = self.constants, log.channels
        T = x["T_im"] if constant is None else np.full(len(log), constant["T_im"])
        W_ei = intake.cylinder_flow(c, x)
        rho_cyl, a_im = W_ei / x["p_im"], c.R_a * T / c.V_im
        E = np.stack([a_im * self.returned(x, W_ei), np.zeros(len(log))], axis=1)
        return trajectory_of(self, [rho_cyl, a_im], E, log, outputs)

    @staticmethod
    def system(parameters: Sequence[Any], outputs: Sequence[str]) -> tuple[list[list[Any]], list[list[Any]]]:
        """Return A and C as nested lists, exact when the parameters are."""
        rho_cyl, a_im = parameters
        zero = 0 * rho_cyl
        C = [[zero + int(state == output) for state in STATES] for output in outputs]
        return [[-a_im * rho_cyl, a_im], [zero, zero]], [*C, [zero, zero + 1]]

    def states(self, log: Log) -> Array:
        """Return p_im as measured and W_c as the filling shows it, shape (N, 2)."""
        x = log.channels
        W_ei = intake.cylinder_flow(self.constants, x)
        return np.stack([x["p_im"], W_ei - self.returned(x, W_ei)], axis=1)

    def balances(self, log: Log, rates: Columns, uncertain: Sequence[str], calm: Columns | None = None) -> Balances:
        """Return the flows, and what they owe to each constant; NaN where nothing tells it."""
        c, slope = self.constants, np.zeros((len(self.balance_names), len(uncertain), len(log)))
        flow = self.flows(c, log.channels, rates)
        for i, name in enumerate(uncertain):
            moved = c._replace(**{name: getattr(c, name) * (1.0 + RELATIVE_STEP)})
            slope[:, i] = (self.flows(moved, log.channels, rates) - flow) / RELATIVE_STEP
        return Balances(self.balance_names, flow, slope)

    @abstractmethod
    def flows(self, c: Any, x: Columns, rates: Columns) -> Array:
        """Return the flow past the sensor by all balances for some constants, shape (B, n) [kg/s]."""

    def returned(self, x: Columns, W_ei: Array) -> Array:
        """Return the EGR flow, shape (n,) [kg/s]: none where nothing tells it."""
        return np.zeros(W_ei.size)


@dataclass(frozen=True)
class Series(SeriesPath):
    """The air path with EGR and lambda; a channel that a log lacks reads NaN."""

    name = "series"
    calmed = ("p_im", "u_delta", "lambda_e")
    smoothed = ("n_e", "u_delta", "p_im", "T_im", "lambda_e")
    balance_names = flows.BALANCES
    components = flows.COMPONENTS
    measured_parts = flows.MEASURED_PARTS
    usual_tolerance = TOLERANCE
    axes = (intake.FUEL_AXIS, SPEED_AXIS)
    channels = channels("components", "series")

    def flows(self, c: Any, x: Columns, rates: Columns) -> Array:
        """Return the flows of `flows.BALANCES`."""
        return flows.flows(c, x, rates)

    def returned(self, x: Columns, W_ei: Array) -> Array:
        """Return the EGR flow, shape (n,) [kg/s]; zero where nothing tells it."""
        return np.nan_to_num(flows.egr(self.constants, x, W_ei)[0])

    def corrections(self, log: Log, rates: Columns) -> tuple[Correction, ...]:
        """Return how each of the components moves the balances."""
        return flows.corrections(self.constants, log.channels, rates)

    def stand_ins(self, log: Log) -> Mapping[str, tuple[str, Array]]:
        """Return what the valve, the probe and the sensors of the exhaust would read, by the engine as configured."""
        c, x = self.constants, log.channels
        W_ei = intake.cylinder_flow(c, x)
        unlogged = {name: values for name, values in x.items() if name not in ("p_em", "T_em")}
        burnt = c.air_fuel * c.k_fuel * intake.cylinder_fuel_flow(c, x["n_e"], np.maximum(x["u_delta"], 0.1))
        p_em, T_em = flows.exhaust(c, unlogged, W_ei)
        opening = np.linspace(0.0, 100.0, 101)
        wide, _ = flows.egr(c, {**x, "u_egr": np.full(W_ei.size, opening[-1])}, W_ei)
        area = intake.egr_area(c, opening) / intake.egr_area(c, opening[-1:])
        less = np.maximum(W_ei - x["W_maf"], 0.0)
        valve = np.where(less < MISSED * W_ei, 0.0, np.interp(less / np.maximum(wide, 1e-9), area, opening))
        return {
            "u_egr": ("shut where the sensor reads what the cylinders draw", valve),
            "lambda_e": ("fresh air over fuel", np.maximum((W_ei - self.returned(x, W_ei)) / burnt, 0.7)),
            "p_em": ("as configured", p_em),
            "T_em": ("as configured", T_em),
        }

    def caution(self, log: Log, noise: Columns, spread: float, learned: bool = False) -> Caution:
        """Return full trust, but none in the filling with EGR as long as no calibration knows its flow."""
        told = [learned or name != flows.BALANCES[flows.RECIRCULATED] for name in self.balance_names]
        trust = np.outer(told, np.ones(len(log)))
        return Caution(trust, np.zeros_like(trust))


USUAL = channels("components")


@dataclass(frozen=True)
class SpeedDensity(SeriesPath):
    """A vehicle that says no more than speed, intake manifold and air flow, as if the EGR valve were shut.

    Without fuel and EGR position the map, over speed and pressure, holds the sensor's error less the EGR flow and what the filling
    is off: all confounded. Maps of the same vehicle on different days differ by what has changed of the three.
    """

    name = "speed_density"
    calmed = ("p_im",)
    smoothed = ("n_e", "p_im", "T_im")
    balance_names = ("filling",)
    components = (*intake.SHAPE, intake.CHARGE)
    axes = (MapAxis("p_im", "Pa", "intake manifold pressure"), SPEED_AXIS)
    channels: ClassVar[Mapping[str, Channel]] = {name: USUAL[name] for name in ("n_e", "p_im", "T_im", "W_maf")}
    usual_tolerance: ClassVar[Mapping[str, float]] = {
        name: TOLERANCE[name] for name in ("R_a", "V_d", "V_im", "c_vol1", "c_vol2", "c_vol3")
    }

    def corrections(self, log: Log, rates: Columns) -> tuple[Correction, ...]:
        """Return how the shape of the filling moves it."""
        x = log.channels
        W_ei = intake.cylinder_flow(self.constants, x)
        shape = (Correction(0, W_ei, points) for points in intake.shape_points(x))
        return (*shape, Correction(0, intake.per_charge(W_ei, x)))

    def flows(self, c: Any, x: Columns, rates: Columns) -> Array:
        """Return the flow into the cylinders and the manifold, shape (1, n) [kg/s]."""
        return np.stack([intake.cylinder_flow(c, x) + intake.stored(c, x, rates)])  # Eq. (1)
