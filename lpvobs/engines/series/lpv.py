"""An engine that logs what series vehicles do, as an LPV system: states p_im and the flow past the sensor, W_c.

    dp_im/dt = a_im (W_c + W_egr - rho_cyl p_im),    dW_c/dt = 0

with rho_cyl = eta_vol n V_d / (120 R_a T_im), a_im = R_a T_im / V_im. Without compressor speed nothing drives W_c but the
observer's injection, so the sensor's map enters the output alone, as Theorem 1 wants. Departure from the paper: another engine.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from lpvobs.engines.base import SPEED_AXIS, AsKnown, Balances, MapAxis, Trajectory
from lpvobs.engines.channels import AMBIENT, Channel
from lpvobs.engines.components import intake
from lpvobs.engines.constants import scaled
from lpvobs.engines.series import flows
from lpvobs.engines.series.constants import SeriesEngine, constants_of
from lpvobs.engines.unknowns import Caution, Component, Correction, MeasuredPart
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
class Series(AsKnown):
    """The air path; see `lpvobs.engines.base.AirPath` for what each member means."""

    engine: SeriesEngine

    name: ClassVar[str] = "series"
    dispensable: ClassVar[tuple[str, ...]] = ()  # a channel that a log lacks reads NaN
    sensor: ClassVar[str] = "W_maf"
    state_names: ClassVar[tuple[str, ...]] = STATES
    parameter_names: ClassVar[tuple[str, ...]] = ("rho_cyl", "a_im")
    temperature_names: ClassVar[tuple[str, ...]] = ("T_im",)
    rate_names: ClassVar[tuple[str, ...]] = ("a_im",)
    calmed: ClassVar[tuple[str, ...]] = ("p_im", "u_delta", "lambda_e")
    smoothed: ClassVar[tuple[str, ...]] = ("n_e", "u_delta", "p_im", "T_im", "lambda_e")
    balance_names: ClassVar[tuple[str, ...]] = flows.BALANCES
    components: ClassVar[tuple[Component, ...]] = flows.COMPONENTS
    measured_parts: ClassVar[tuple[MeasuredPart, ...]] = flows.MEASURED_PARTS
    volumes: ClassVar[tuple[str, ...]] = ("V_im",)
    usual_tolerance: ClassVar[Mapping[str, float]] = TOLERANCE
    axes: ClassVar[tuple[MapAxis, MapAxis]] = (
        MapAxis("u_delta", "mg/cycle", "injected fuel per cylinder and cycle"),
        SPEED_AXIS,
    )
    channels: ClassVar[Mapping[str, Channel]] = {
        "n_e": Channel("rpm", -50.0, 8000.0, (300.0, 6000.0), "engine speed", 60.0),
        "u_delta": Channel(
            "mg/cycle", -5.0, 300.0, (-0.5, 150.0), "injected fuel per cylinder and cycle", 300.0, reaches=1.0
        ),
        "u_egr": Channel("%", -20.0, 120.0, (-5.0, 105.0), "EGR valve opening", one_of=("lambda_e",)),
        "p_im": Channel("Pa", 2e4, 6e5, (6e4, 4e5), "intake manifold pressure", 120.0, ("p_amb", 6e4)),
        "p_em": Channel("Pa", 2e4, 1e6, (6e4, 6e5), "exhaust manifold pressure", one_of=()),
        "T_im": Channel("K", 200.0, 500.0, (230.0, 420.0), "intake manifold temperature", 300.0, ("T_amb", 40.0)),
        "T_em": Channel("K", 200.0, 1500.0, (250.0, 1300.0), "exhaust manifold temperature", one_of=()),
        **AMBIENT,
        "lambda_e": Channel("1", 0.5, 100.0, (0.7, 40.0), "lambda in the exhaust", one_of=("u_egr",)),
        "W_maf": Channel("kg/s", -1.0, 2.0, (5e-4, 0.5), "mass air flow sensor", 30.0, follows=("n_e", "p_im")),
    }

    @cached_property
    def constants(self) -> Any:
        """The engine's constants, flat."""
        return constants_of(self.engine)

    @property
    def cylinders(self) -> float:  # type: ignore[override]
        """Number of cylinders."""
        return float(self.engine.geometry.n_cyl)

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
        W_ei = intake.cylinder_flow(c, x["p_im"], x["n_e"], x["T_im"])
        parameters = np.stack([W_ei / x["p_im"], c.R_a * T / c.V_im])
        A, C = (np.moveaxis(np.array(rows), -1, 0) for rows in self.system(list(parameters), outputs))
        inflow = self.returned(x, W_ei)
        E = np.stack([parameters[1] * inflow, np.zeros(len(log))], axis=1)
        y = np.column_stack([log[name] for name in (*outputs, self.sensor)])
        return Trajectory(parameters.T, A, E, C, y)

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
        W_ei = intake.cylinder_flow(self.constants, x["p_im"], x["n_e"], x["T_im"])
        return np.stack([x["p_im"], W_ei - self.returned(x, W_ei)], axis=1)

    def returned(self, x: Mapping[str, Array], W_ei: Array) -> Array:
        """Return the EGR flow, shape (n,) [kg/s]; zero where nothing tells it."""
        return np.nan_to_num(flows.egr(self.constants, x, W_ei)[0])

    def deviating(self, deviation: Mapping[str, float]) -> "Series":
        """Return the air path of an engine whose constants deviate."""
        return type(self)(scaled(self.engine, deviation))

    def corrections(self, log: Log, rates: Mapping[str, Array]) -> tuple[Correction, ...]:
        """Return how each of the components moves the balances."""
        return flows.corrections(self.constants, log.channels, rates)

    def stand_ins(self, log: Log) -> Mapping[str, tuple[str, Array]]:
        """Return what the valve, the probe and the sensors of the exhaust would read, by the engine as configured."""
        c, x = self.constants, log.channels
        W_ei = intake.cylinder_flow(c, x["p_im"], x["n_e"], x["T_im"])
        unlogged = {name: values for name, values in x.items() if name not in ("p_em", "T_em")}
        burnt = c.air_fuel * c.k_fuel * intake.cylinder_fuel_flow(c, x["n_e"], np.maximum(x["u_delta"], 0.1))
        p_em, T_em = flows.exhaust(c, unlogged, W_ei)
        opening = np.linspace(0.0, 100.0, 101)
        wide, _ = flows.egr(c, {**x, "u_egr": np.full(W_ei.size, opening[-1])}, W_ei)
        area = intake.egr_area(c, opening) / intake.egr_area(c, opening[-1:])
        less = np.maximum(W_ei - x["W_maf"], 0.0)
        lifted = np.interp(less / np.maximum(wide, 1e-9), area, opening)
        return {
            "u_egr": (
                "shut where the sensor reads what the cylinders draw",
                np.where(less < MISSED * W_ei, 0.0, lifted),
            ),
            "lambda_e": ("fresh air over fuel", np.maximum((W_ei - self.returned(x, W_ei)) / burnt, 0.7)),
            "p_em": ("as configured", p_em),
            "T_em": ("as configured", T_em),
        }

    def caution(self, log: Log, noise: Mapping[str, Array], spread: float, learned: bool = False) -> Caution:
        """Return full trust, but none in the filling with EGR as long as no calibration knows its flow."""
        told = [learned or name != flows.BALANCES[flows.RECIRCULATED] for name in self.balance_names]
        trust = np.outer(told, np.ones(len(log)))
        return Caution(trust, np.zeros_like(trust))

    def balances(
        self, log: Log, rates: Mapping[str, Array], uncertain: Sequence[str], calm: Mapping[str, Array] | None = None
    ) -> Balances:
        """Return the flows of `flows.BALANCES`, and what they owe to each constant; NaN where nothing tells it."""
        c = self.constants
        flow = flows.flows(c, log.channels, rates)
        moved = (c._replace(**{name: getattr(c, name) * (1.0 + RELATIVE_STEP)}) for name in uncertain)
        slope = [(flows.flows(other, log.channels, rates) - flow) / RELATIVE_STEP for other in moved]
        return Balances(flows.BALANCES, flow, np.stack(slope, axis=1) if slope else np.zeros((len(flow), 0, len(log))))
