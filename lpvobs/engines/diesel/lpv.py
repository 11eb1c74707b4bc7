"""The diesel with EGR and VGT as an LPV system (Sec. 2.1): states p_im, p_em, omega_t.

Departure from the paper: the output p_em can be added to (p_im, omega_t, W_maf), and a_1, a_2 count as scheduling parameters,
because the manifold temperatures move.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines.base import SPEED_AXIS, AirPath, Balances, Trajectory
from lpvobs.engines.channels import Columns, channels
from lpvobs.engines.components import intake
from lpvobs.engines.diesel import constants as constant
from lpvobs.engines.diesel import corrections as correction
from lpvobs.engines.diesel import relations as relation
from lpvobs.engines.diesel.component_maps import COMPONENT_MAPS
from lpvobs.engines.diesel.constants import DieselConstants, DieselEngine
from lpvobs.engines.unknowns import Caution, Correction
from lpvobs.records import Array, Log

STATES = ("p_im", "p_em", "omega_t")
PARAMETERS = ("rho_1", "rho_2", "rho_3", "rho_4", "rho_5", "a_1", "a_2")
BALANCES = ("compressor", "filling")
COMPRESSOR = ("R_c", "k_neg", *(name for names in constant.COMPRESSOR_FORMS.values() for name in names))
OWNED_CONSTANTS = (
    ("R_a", "c_pa", "gamma_a", *COMPRESSOR),
    ("R_a", "R_e", "V_d", "V_im", *intake.Filling.__dataclass_fields__, *intake.Egr.__dataclass_fields__),
)
"""The constants that each balance depends on, in any form of the components."""
GAS_TOLERANCE, FITTED_TOLERANCE = 0.001, 0.01
"""Of constants of which the configuration says nothing: gases are in tables, what is fitted is good to a hundredth."""
RELATIVE_STEP = 1e-5
"""Relative step of the difference quotients. Their error is a step times the second derivative, 1e-4 at the steepest."""
INPUTS = ("n_e", "u_delta", "u_egr", "u_vgt", "p_im", "p_em", "omega_t", "T_im", "T_em", "p_amb", "T_amb")


@dataclass(frozen=True)
class Diesel(AirPath):
    """The air path of a diesel with EGR and VGT; see `lpvobs.engines.base.AirPath` for what each member means."""

    engine: DieselEngine

    name = "diesel"
    state_names = STATES
    parameter_names = PARAMETERS
    temperature_names = ("T_im", "T_em")
    rate_names = ("a_1", "a_2")
    smoothed = ("p_im", "p_em", "omega_t", "T_im", "T_em")
    calmed = ("p_im", "omega_t", "p_em")
    followers = correction.FOLLOWERS
    balance_names = BALANCES
    components = correction.COMPONENTS
    measured_parts = correction.MEASURED_PARTS
    component_maps = COMPONENT_MAPS
    steep = COMPRESSOR
    volumes = correction.VOLUMES
    cylinder_number = "n_cyl"
    axes = (intake.FUEL_AXIS, SPEED_AXIS)
    channels = channels("components", "diesel")

    @cached_property
    def constants(self) -> DieselConstants:
        """The engine's constants, flat."""
        return constant.constants_of(self.engine)

    def engine_constants(self) -> Mapping[str, float]:
        """Return every constant of the engine by name."""
        return constant.own_constants(self.engine)

    @property
    def usual_tolerance(self) -> Mapping[str, float]:
        """Return the constants that a balance depends on, and how well one is known of which the configuration says nothing."""
        owned, known = dict.fromkeys(OWNED_CONSTANTS[0] + OWNED_CONSTANTS[1]), self.engine_constants()
        own = [name for name in owned if name in known]
        return {name: GAS_TOLERANCE if name in constant.Gas.__dataclass_fields__ else FITTED_TOLERANCE for name in own}

    def rate_bounds(self, temperatures: Mapping[str, tuple[float, float]]) -> Mapping[str, tuple[float, float]]:
        """Return the ranges of a_1 = R_a T_im / V_im and a_2 = R_e T_em / V_em of Eq. (5), [J/(kg m^3)]."""
        c = self.constants
        (im_low, im_high), (em_low, em_high) = temperatures["T_im"], temperatures["T_em"]
        a_1, a_2 = c.R_a / c.V_im, c.R_e / c.V_em
        return {"a_1": (a_1 * im_low, a_1 * im_high), "a_2": (a_2 * em_low, a_2 * em_high)}

    def trajectory(self, log: Log, outputs: Sequence[str], constant: Mapping[str, float] | None = None) -> Trajectory:
        """Return Eq. (24) along a log of N samples: 3 states, the outputs, in Eq. (6) `("p_im", "omega_t")`, and the sensor.

        a_1 and a_2 are computed from constant temperatures `T_im`, `T_em` [K] instead of the log's where these are given,
        as in the paper, whose proof takes a_1 and a_2 for constants.
        """
        parameters, E = (rows.T for rows in along(self.constants, tuple(log[name] for name in INPUTS)))
        if constant is not None:
            (a_1, _), (a_2, _) = self.rate_bounds({name: (T, T) for name, T in constant.items()}).values()
            E[1] *= a_2 / parameters[6]
            parameters[5:] = [[a_1], [a_2]]
        N = len(log)
        A, C, y = np.zeros((3, 3, N)), np.zeros((len(outputs) + 1, 3, N)), np.empty((len(outputs) + 1, N))
        rho_1, rho_2, rho_3, rho_4, rho_5, a_1, a_2 = parameters
        A[0] = -a_1 * rho_3, a_1 * rho_2, a_1 * rho_1  # Eq. (5)
        A[1, :2] = a_2 * rho_3, -a_2 * (rho_2 + rho_4)  # Eq. (5)
        A[2, 2] = -rho_5  # Eq. (5)
        for row, channel in enumerate(outputs):
            C[row, STATES.index(channel)] = 1.0  # Eq. (25)
        C[-1, 2] = rho_1  # Eq. (25)
        for row, channel in enumerate((*outputs, self.sensor)):
            y[row] = log[channel]  # Eq. (7)
        return Trajectory(parameters.T, A.transpose(2, 0, 1), E.T, C.transpose(2, 0, 1), y.T, len(outputs))  # Eq. (24)

    @staticmethod
    def system(parameters: Sequence[Any], outputs: Sequence[str]) -> tuple[list[list[Any]], list[list[Any]]]:
        """Return A of Eq. (5) and C of Eq. (25) as nested lists, exact when the parameters are."""
        r1, r2, r3, r4, r5, a_1, a_2 = parameters
        zero = 0 * r1
        A = [[-a_1 * r3, a_1 * r2, a_1 * r1], [a_2 * r3, -a_2 * r2 - a_2 * r4, zero], [zero, zero, -r5]]  # Eq. (5)
        C = [[zero + int(state == output) for state in STATES] for output in outputs]
        return A, [*C, [zero, zero, r1]]  # Eq. (25)

    def states(self, log: Log) -> Array:
        """Return the measured states, shape (N, 3)."""
        return np.stack([log[state] for state in STATES], axis=1)

    def corrections(self, log: Log, rates: Columns) -> tuple[Correction, ...]:
        """Return how each of the components moves the balances, given the rates of pressures and temperatures."""
        return correction.corrections(self.constants, log.channels, rates)

    def caution(self, log: Log, noise: Columns, spread: float, learned: bool = False) -> Caution:
        """Return how far the balances can be relied on, given the noise of calmed channels and the constants' spread."""
        return correction.caution(self.constants, log.channels, noise, spread)

    def balances(self, log: Log, rates: Columns, uncertain: Sequence[str], calm: Columns | None = None) -> Balances:
        """Return the flow from the compressor and from the filling of the cylinders, and what they owe to each constant.

        The log may be smoothed or not; `rates` are those of `p_im` [Pa/s] and `T_im` [K/s]. `calm` has the channels of
        `calmed` through a wider window, for the compressor, whose curve is steep.

        Compressor: W_c = rho_1 omega_t. Filling: Eq. (1) solved for W_c = W_ei - W_egr + V_im/(R_a T_im) (dp_im/dt -
        p_im/T_im dT_im/dt). Departure from the paper: its Eq. (1) has no term in dT_im/dt.
        """
        calmer, nominal = {**log.channels, **(calm or {})}, self.constants
        flows: tuple[Callable[[DieselConstants], Array], ...]
        flows = (lambda c: correction.compressor_flow(c, calmer)), (lambda c: filling_flow(c, log.channels, rates))
        flow: Array = np.stack([balance(nominal) for balance in flows])
        slope = np.zeros((len(flows), len(uncertain), len(log)))
        for i, name in enumerate(uncertain):
            shifted = nominal._replace(**{name: getattr(nominal, name) * (1.0 + RELATIVE_STEP)})
            for b, balance in enumerate(flows):
                if name in OWNED_CONSTANTS[b]:
                    slope[b, i] = (balance(shifted) - flow[b]) / RELATIVE_STEP
        return Balances(BALANCES, flow, slope)


@njit(cache=True)
def along(c: DieselConstants, columns: tuple[Array, ...]) -> tuple[Array, Array]:
    """Return rho_1..rho_5, a_1, a_2 (N, 7) and E (N, 3) of Eq. (3) and (5) along the columns named in `INPUTS`."""
    n_e, u_delta, u_egr, u_vgt, p_im, p_em, omega_t, T_im, T_em, p_amb, T_amb = columns
    N = n_e.size
    parameters = np.empty((7, N))
    E, head = np.zeros((3, N)), np.empty(N)
    # One relation after the other: a power takes long to come, and the next sample's need not wait for this one's.
    for k in range(N):
        head[k] = relation.head(c, p_im[k], p_amb[k])
    for k in range(N):
        parameters[0, k] = relation.rho_1_of(c, head[k], omega_t[k], p_amb[k], T_amb[k])
    for k in range(N):
        parameters[1, k] = intake.rho_2(c, p_im[k], p_em[k], u_egr[k], T_im[k], T_em[k])
        parameters[2, k] = intake.rho_3(c, p_im[k], n_e[k], T_im[k])
        parameters[5, k] = c.R_a * T_im[k] / c.V_im  # Eq. (5)
        parameters[6, k] = c.R_e * T_em[k] / c.V_em  # Eq. (5)
    for k in range(N):
        parameters[4, k] = relation.rho_5(c, parameters[0, k], head[k], p_im[k], omega_t[k], p_amb[k], T_amb[k])
    scale, p_es, Pi_t = np.empty(N), p_amb.copy(), np.empty(N)
    for k in range(N):
        scale[k] = relation.turbine_scale(c, u_vgt[k], T_em[k])
    for _ in range(relation.TURBINE_PASSES):
        for k in range(N):
            parameters[3, k], Pi_t[k], p_es[k] = relation.turbine_pass(c, scale[k], p_es[k], p_em[k], p_amb[k])
    for k in range(N):
        power = relation.turbine_power(c, parameters[3, k] * p_em[k], Pi_t[k], omega_t[k], T_em[k])
        E[1, k] = parameters[6, k] * intake.cylinder_fuel_flow(c, n_e[k], u_delta[k])  # Eq. (5)
        E[2, k] = power / (c.J_t * omega_t[k])  # Eq. (5)
    return parameters.T, E.T


def filling_flow(c: DieselConstants, x: Columns, rates: Columns) -> Array:
    """Return W_c = W_ei - W_egr + what fills the intake manifold, shape (N,) [kg/s]."""
    W_egr = intake.egr_flow(c, x["p_im"], x["p_em"], x["u_egr"], x["T_im"], x["T_em"])
    return intake.cylinder_flow(c, x) - W_egr + intake.stored(c, x, rates)  # Eq. (1)
