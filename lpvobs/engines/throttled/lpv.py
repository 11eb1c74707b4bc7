"""A throttled engine with intercooler as an LPV system: states p_ic, p_im, W_c.

    dp_ic/dt = a_ic (W_c - rho_th p_ic),    dp_im/dt = a_im (rho_th p_ic - rho_cyl p_im),    dW_c/dt = 0,

with rho_th = A(alpha) Psi(p_im / p_ic) / sqrt(R T_ic), rho_cyl = eta_vol n V_d / (120 R T_ic) and a = R T_ic / V. The flow past the
sensor is a state that only the observer's injection moves, so the sensor's map enters the output alone, as Theorem 1 wants.
Departure from the paper: another engine; the curves are not configured but learned from a healthy log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from lpvobs.engines.base import SPEED_AXIS, AirPath, Balances, MapAxis, Trajectory, trajectory_of
from lpvobs.engines.channels import Columns, channels
from lpvobs.engines.curves import Knowledge
from lpvobs.engines.throttled import relations as relation
from lpvobs.engines.throttled.constants import ThrottledEngine
from lpvobs.engines.throttled.learning import NUMBERS, learn
from lpvobs.engines.unknowns import Caution
from lpvobs.errors import UsageError
from lpvobs.records import Array, Log

STATES = ("p_ic", "p_im", "W_c")
BALANCES = ("throttle", "filling", "fuel")
CONSTANTS = ("A_th", "eta_vol", "k_fuel", "V_ic", "V_im")
"""Names of the uncertain constants: the level of each curve, and the volumes."""
UNSURE = 1e-4  # weight of the fuel's balance in the map: idle of the real engine is not stoichiometric
LEVEL_TOLERANCE = 0.01
"""Of one of which the configuration says nothing: from one day to another a learned curve holds to a hundredth."""


@dataclass(frozen=True)
class Throttled(AirPath):
    """The air path of a throttled engine; see `lpvobs.engines.base.AirPath` for what each member means."""

    engine: ThrottledEngine
    learned: Knowledge | None = None

    name = "throttled"
    learns = True
    dispensable = ("n_e", "m_f", "alpha_th", "p_ic", "T_ic", "p_im", "p_amb", "T_amb")
    state_names = STATES
    parameter_names = ("rho_th", "rho_cyl", "a_ic", "a_im")
    temperature_names = ("T_ic",)
    rate_names = ("a_ic", "a_im")
    balance_names = BALANCES
    smoothed = ("p_ic", "p_im")
    cylinder_number = "n_cyl"
    usual_tolerance: ClassVar[Mapping[str, float]] = dict.fromkeys(CONSTANTS, LEVEL_TOLERANCE)
    axes = (MapAxis("m_f", "1", "fuel per stroke as logged"), SPEED_AXIS)
    channels = channels("throttled")

    def knowledge(self) -> Knowledge | None:
        """Return the learned curves and volumes; None before there are any."""
        return self.learned

    def knowing(self, known: Knowledge) -> "Throttled":
        """Return the air path with curves and volumes that were learned before; raises KeyError for another engine's."""
        curves = {part.name: known.curves[part.name] for part in relation.PARTS}  # files have an order of their own
        return replace(self, learned=replace(known, curves=curves, numbers={n: known.numbers[n] for n in NUMBERS}))

    def deviating(self, deviation: Mapping[str, float]) -> "Throttled":
        """Return the air path with curves that deviate at their nodes."""
        learned = self._known()
        return replace(self, learned=learned.moved(np.array([deviation.get(name, 0.0) for name in learned.names])))

    def learned_from(self, logs: Sequence[Log]) -> "Throttled":
        """Return the air path with the curves and volumes that healthy logs show."""
        return replace(self, learned=learn(self.engine, logs))

    def engine_constants(self) -> Mapping[str, float]:
        """Return every scalar of the configured engine by name; what is learned is no part of it."""
        return {**vars(self.engine.air), **vars(self.engine.geometry)}

    def rate_bounds(self, temperatures: Mapping[str, tuple[float, float]]) -> Mapping[str, tuple[float, float]]:
        """Return the ranges of a_ic = R_a T_ic / V_ic and a_im = R_a T_ic / V_im [J/(kg m^3)]."""
        # Before the volumes are learned they may be off by their tolerance.
        low, high = temperatures["T_ic"]
        R, g = self.engine.air.R_a, self.engine.geometry
        if self.learned is None:
            slack = 1.0 + g.volume_tolerance
            volumes = [(V / slack, V * slack) for V in (g.V_ic, g.V_im)]
        else:
            volumes = [(self.learned[name],) * 2 for name in ("V_ic", "V_im")]
        return {n: (R * low / b, R * high / a) for n, (a, b) in zip(self.rate_names, volumes, strict=True)}

    def trajectory(self, log: Log, outputs: Sequence[str], constant: Mapping[str, float] | None = None) -> Trajectory:
        """Return the LPV system along a log of N samples; `constant` holds a T_ic [K] for a_ic and a_im."""
        learned, R = self._known(), self.engine.air.R_a
        x = log.channels
        T = x["T_ic"] if constant is None else np.full(len(log), constant["T_ic"])
        rho_th = relation.THROTTLE.flow(self.engine, learned, x) / x["p_ic"]
        rho_cyl = relation.FILLING.flow(self.engine, learned, x) / x["p_im"]
        parameters = [rho_th, rho_cyl, R * T / learned["V_ic"], R * T / learned["V_im"]]
        return trajectory_of(self, parameters, np.zeros((len(log), 3)), log, outputs)

    @staticmethod
    def system(parameters: Sequence[Any], outputs: Sequence[str]) -> tuple[list[list[Any]], list[list[Any]]]:
        """Return A and C as nested lists, exact when the parameters are."""
        rho_th, rho_cyl, a_ic, a_im = parameters
        zero = 0 * rho_th
        one = zero + 1
        A = [[-a_ic * rho_th, zero, a_ic], [a_im * rho_th, -a_im * rho_cyl, zero], [zero, zero, zero]]
        C = [[zero + int(state == output) for state in STATES] for output in outputs]
        return A, [*C, [zero, zero, one]]

    def states(self, log: Log) -> Array:
        """Return p_ic and p_im as measured and W_c as the throttle shows it, shape (N, 3)."""
        flow = relation.THROTTLE.flow(self.engine, self._known(), log.channels)
        return np.stack([log["p_ic"], log["p_im"], flow], axis=1)

    def caution(self, log: Log, noise: Columns, spread: float, learned: bool = False) -> Caution:
        """Return full trust in throttle and filling, and next to none in the fuel, which is no measure of air where it is rich."""
        trust = np.ones((len(BALANCES), len(log)))
        trust[BALANCES.index("fuel")] = UNSURE
        return Caution(trust, np.zeros_like(trust))

    def balances(self, log: Log, rates: Columns, uncertain: Sequence[str], calm: Columns | None = None) -> Balances:
        """Return the flow past the sensor from throttle, filling and fuel, and what each owes to the uncertain constants."""
        # Each is the flow at its place plus what the volumes between sensor and place store; slopes are exact, the flows
        # are linear in the constants.
        learned, x = self._known(), log.channels
        RT = self.engine.air.R_a * x["T_ic"]
        in_ic, in_im = learned["V_ic"] * rates["p_ic"] / RT, learned["V_im"] * rates["p_im"] / RT
        own = [part.flow(self.engine, learned, x) for part in relation.PARTS]
        stored = (in_ic, in_ic + in_im, in_ic + in_im)
        flow = np.stack([through + kept for through, kept in zip(own, stored, strict=True)])
        slope = np.zeros((len(BALANCES), len(uncertain), len(log)))
        for b, through in enumerate(own):
            owed = {CONSTANTS[b]: through, "V_ic": in_ic, "V_im": in_im if b > 0 else 0.0}
            for i, name in enumerate(uncertain):
                slope[b, i] = owed.get(name, 0.0)
        return Balances(BALANCES, flow, slope)

    def _known(self) -> Knowledge:
        if self.learned is None:
            raise UsageError(
                "engine: the curves of a throttled engine are not configured but learned; give a healthy log"
            )
        return self.learned


def in_c(path: Throttled) -> dict[str, float | Array]:
    """Return the numbers that `model.c` reads: what is configured, nodes of the curves, and the curves."""
    engine, learned = path.engine, path._known()
    nodes = {name: np.array(getattr(engine.curves, name)) for name in ("alpha_th", "n_e", "p_im")}
    area, eta_vol = (learned.curves[part.name].values.reshape(-1) for part in (relation.THROTTLE, relation.FILLING))
    volumes = {name: learned[name] for name in ("V_ic", "V_im")}
    return {**path.engine_constants(), **nodes, **volumes, "area": area, "eta_vol": eta_vol}
