"""The nonlinear plant: nine states, one relation per function; the right-hand side stands in `integrate`.

Structure after Wahlstrom and Eriksson, Proc. IMechE D 225 (2011), the paper's reference 16, with three changes that a small car
engine needs, marked (+): EGR that flows backward, a compressor that passes more flow when the pressure ratio falls below one, and
an intake temperature that is a state. SI units; openings in %, engine speed in rpm, fuel in mg/cycle.

The relations are written here anew and not shared with the observer's model, so that a test can hold one against the other.
"""

from math import exp, log, pi, sqrt
from typing import NamedTuple

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines.constants import flat, flat_type, names_of
from lpvobs.engines.diesel.constants import DieselConstants, DieselEngine, constants_of
from lpvobs.records import Array
from lpvobs.simulation.parameters import Actuators, Amplitudes, Combustion, Cooling, SimulationParameters

STATES = ("p_im", "p_em", "X_Oim", "X_Oem", "omega_t", "u_egr1", "u_egr2", "u_vgt", "T_im")
P_IM, P_EM, X_OIM, X_OEM, OMEGA_T, U_EGR1, U_EGR2, U_VGT, T_IM = range(9)
SLOWEST_TURBINE = 150.0  # rad/s
ROTOR_SPEED = 1.0  # place of the form `rotor_speed` among the forms of the compressor, and among those of the turbine


class Body(flat_type([*names_of(Combustion, Cooling, Actuators, without=("friction_bar",)), "pipe"])):  # type: ignore[misc]
    """The constants that only the plant has; `pipe` [W/K] is the exhaust pipes' heat transfer coefficient times their area."""


class Rise(NamedTuple):
    """A Gaussian on top of one, over a component's own input, in its unit."""

    amplitude: float = 0.0  # none: the component is as it was
    centre: float = 0.0
    width: float = 1.0


class Condition(NamedTuple):
    """What has happened to the engine since it was new; areas effective [m^2], factors of one change nothing.

    The fields bear the identifiers of the effects.
    """

    leak_intake: float = 0.0  # hole in the intake manifold
    egr_leak: float = 0.0  # area of the EGR valve that never closes
    egr_area: float = 1.0  # of the EGR valve's own area
    eta_vol_factor: float = 1.0
    compressor_flow: float = 1.0
    turbine_efficiency: float = 1.0
    exhaust_restriction: float = 1.0  # of the back pressure's coefficient
    eta_vol_curve: Rise = Rise()  # over engine speed
    compressor_curve: Rise = Rise()  # over the blade's speed
    egr_curve: Rise = Rise()  # over the valve's opening
    turbine_curve: Rise = Rise()  # of the efficiency, over the vanes' position


SOUND = Condition()


class Plant(NamedTuple):
    """Everything that is constant during a drive, or up to the next change of the engine's condition."""

    engine: DieselConstants
    body: Body
    condition: Condition
    structure: Amplitudes


class Inputs(NamedTuple):
    """What acts on the plant from outside, at one instant."""

    n_e: float
    u_demand: float  # mg/cycle, before the smoke limit
    u_egr: float  # %, command
    u_vgt: float  # %, command
    p_amb: float
    T_amb: float
    T_wall: float = 360.0  # K, of the intake ports; like the next one of use to another structure only
    v_air: float = 20.0  # m/s, cooling air at the intercooler


class Flows(NamedTuple):
    """What follows from state and inputs without memory."""

    W_c: float
    W_egr: float
    W_ei: float
    W_f: float
    W_t: float
    W_leak: float  # out of the intake manifold
    u_delta: float  # mg/cycle, injected
    u_egr: float  # %, position of the valve
    T_em: float
    X_Oe: float
    charge_warming: float  # K above ambient, behind the intercooler
    P_c: float
    P_t: float  # W, turbine power times mechanical efficiency


def plant_of(engine: DieselEngine, parameters: SimulationParameters) -> Plant:
    """Return the plant's constants, flat, as the compiled functions read them."""
    fire = parameters.combustion
    pipe = fire.h_tot * pi * fire.d_pipe * fire.l_pipe * fire.n_pipe
    body = flat(Body, fire, parameters.cooling, parameters.actuators, pipe=pipe)
    return Plant(constants_of(engine), body, SOUND, flat(Amplitudes, parameters.structure))


def resting_state(plant: Plant, p_amb: float, T_amb: float) -> Array:
    """Return a state from which the engine starts: ambient pressures, fresh air, a slow turbine; shape (9,)."""
    return np.array([p_amb, p_amb + 1e3, plant.body.X_Oc, plant.body.X_Oc, 3000.0, 0.0, 0.0, 50.0, T_amb])


@njit(cache=True)
def risen(rise: Rise, at: float) -> float:
    """Return the factor of a rise [-] where its input is."""
    if rise.amplitude == 0.0:
        return 1.0
    return 1.0 + rise.amplitude * exp(-0.5 * ((at - rise.centre) / rise.width) ** 2)


@njit(cache=True)
def valve_position(plant: Plant, u_egr1: float, u_egr2: float) -> float:
    """Return the opening of the EGR valve [%]: it overshoots, but only between its stops."""
    vertex = -0.5 * plant.engine.c_egr2 / plant.engine.c_egr1
    return min(max(plant.body.K_egr * u_egr1 - (plant.body.K_egr - 1.0) * u_egr2, 0.0), vertex)


@njit(cache=True)
def compressor_flow(plant: Plant, p_im: float, omega_t: float, p_amb: float, T_amb: float) -> float:
    """Return W_c [kg/s] of Eq. (2); nothing in stall, never backward. Fouling takes a share at any speed and pressure ratio."""
    c = plant.engine
    U = c.R_c * omega_t
    Psi_c = 2.0 * c.c_pa * T_amb * ((p_im / p_amb) ** (1.0 - 1.0 / c.gamma_a) - 1.0) / U**2
    if c.compressor_form == ROTOR_SPEED:
        # Wahlstrom and Eriksson (2011); below no head the flow grows (+)
        widest = c.c_w_phi1 * omega_t**2 + c.c_w_phi2 * omega_t + c.c_w_phi3
        steepness = c.c_w_psi1 * omega_t**2 + c.c_w_psi2 * omega_t + c.c_w_psi3
        head = Psi_c - c.c_psi2
        inside = 1.0 - steepness * head**2 if head >= 0.0 else 1.0 + c.k_neg * -head / 0.1
        Phi_c = max(0.0, c.c_phi2 + sqrt(max(0.0, inside) / max(widest, 1.0)))  # Phi_c above one: no compressor
    else:
        Phi_c = c.phi_0 + c.phi_1 * U / 400.0
        if Psi_c >= 0.0:
            Phi_c *= sqrt(max(0.0, 1.0 - (Psi_c / (c.psi_0 + c.psi_1 * U / 400.0)) ** 2))
        else:
            Phi_c *= sqrt(1.0 + c.k_neg * -Psi_c / 0.1)  # (+)
    share = plant.condition.compressor_flow * risen(plant.condition.compressor_curve, U)
    return share * (p_amb * pi * c.R_c**3 * Phi_c * omega_t / (c.R_a * T_amb))  # Eq. (2)


@njit(cache=True)
def compressor_heating(plant: Plant, W_c: float, p_im: float, p_amb: float, T_amb: float, loss: float) -> float:
    """Return by how much the compressor heats the air [K]; its power, Eq. (2), is W_c c_pa times this."""
    # `loss` multiplies what efficiency lacks to one.
    c = plant.engine
    Pi_c = p_im / p_amb
    a = W_c - c.W_c_opt
    b = max(Pi_c - 1.0, 0.0) ** c.c_pi - c.pi_c_opt
    eta_c = c.eta_c_max - (c.Q_11 * a * a + 2.0 * c.Q_12 * a * b + c.Q_22 * b * b)
    if loss != 1.0:
        eta_c = 1.0 - loss * (1.0 - eta_c)
    eta_c = min(max(eta_c, c.eta_c_min), 1.0)
    return T_amb * max(Pi_c ** (1.0 - 1.0 / c.gamma_a) - 1.0, 0.0) / eta_c


@njit(cache=True)
def egr_flow_function(plant: Plant, Pi: float) -> float:
    """Return Psi_egr [-] over the pressure quotient: one when choked, zero at equal pressures."""
    Pi_opt = plant.engine.pi_egr_opt
    Pi = min(max(Pi, Pi_opt), 1.0)
    return 1.0 - ((1.0 - Pi) / (1.0 - Pi_opt) - 1.0) ** 2


@njit(cache=True)
def egr_flow(
    plant: Plant, p_im: float, p_em: float, u_egr: float, T_im: float, T_em: float, wide: float = 1.0
) -> float:
    """Return W_egr [kg/s] of Eq. (2), negative where it flows backward (+); `wide` multiplies the area of the valve."""
    c = plant.engine
    area = wide * plant.condition.egr_area * (c.A_egr_max * (c.c_egr1 * u_egr * u_egr + c.c_egr2 * u_egr))
    area = area * risen(plant.condition.egr_curve, u_egr) + plant.condition.egr_leak
    if p_em >= p_im:
        return area * p_em * egr_flow_function(plant, p_im / p_em) / sqrt(T_em * c.R_e)  # Eq. (2)
    return -c.k_reverse * area * p_im * egr_flow_function(plant, p_em / p_im) / sqrt(T_im * c.R_a)


@njit(cache=True)
def cylinder_flow(plant: Plant, p_im: float, n_e: float, T_im: float) -> float:
    """Return W_ei [kg/s] of Eq. (2)."""
    c = plant.engine
    eta_vol = c.c_vol1 * sqrt(p_im) + c.c_vol2 * sqrt(n_e) + c.c_vol3
    share = plant.condition.eta_vol_factor * risen(plant.condition.eta_vol_curve, n_e)
    return share * (eta_vol * p_im * n_e * c.V_d / (120.0 * c.R_a * T_im))  # Eq. (2)


@njit(cache=True)
def orifice_flow(area: float, p_up: float, p_down: float, T_up: float, R: float, gamma: float) -> float:
    """Return the flow [kg/s] through a hole of effective area [m^2]: isentropic, choked beyond the critical quotient."""
    Pi = max(p_down / p_up, (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0)))
    inside = 2.0 * gamma / (gamma - 1.0) * (Pi ** (2.0 / gamma) - Pi ** ((gamma + 1.0) / gamma))
    return area * p_up / sqrt(R * T_up) * sqrt(max(inside, 0.0))


@njit(cache=True)
def intake_leak(plant: Plant, p_im: float, T_im: float, p_amb: float, T_amb: float) -> float:
    """Return what a hole in the intake manifold lets out [kg/s]; negative where the manifold draws air in."""
    c, area = plant.engine, plant.condition.leak_intake
    if area == 0.0:
        return 0.0
    if p_im >= p_amb:
        return orifice_flow(area, p_im, p_amb, T_im, c.R_a, c.gamma_a)
    return -orifice_flow(area, p_amb, p_im, T_amb, c.R_a, c.gamma_a)


@njit(cache=True)
def smoke_limit(plant: Plant, W_ei: float, X_Oim: float, n_e: float) -> float:
    """Return the most fuel [mg/cycle] that leaves the cylinder lambda_min times the air it needs."""
    W_f = W_ei * X_Oim / (plant.body.lambda_min * plant.body.air_fuel_stoichiometric * plant.body.X_Oc)
    return W_f * 120.0e6 / (n_e * plant.engine.n_cyl)


@njit(cache=True)
def cylinder_out_temperature(
    plant: Plant, W_ei: float, W_f: float, lambda_O: float, p_im: float, p_em: float, T_im: float
) -> float:
    """Return T_e [K] of a limited-pressure cycle: residual gas and its temperature by four fixed-point passes."""
    c, b = plant.engine, plant.body
    c_va = c.c_pa - c.R_a
    heated = b.compression_ratio ** (c.gamma_a - 1.0)
    Pi_e = p_em / p_im
    expansion = Pi_e ** (1.0 / c.gamma_a)
    heat = min(1.0, lambda_O) * W_f * b.q_HV / (W_ei + W_f)
    x_r, T_1, T_e = 0.03, T_im, T_im
    for _ in range(4):
        q = heat * (1.0 - x_r)
        compressed = T_1 * heated
        x_p = 1.0 + q * b.x_cv / (c_va * compressed)
        x_v = 1.0 + q * (1.0 - b.x_cv) / (c.c_pa * (q * b.x_cv / c_va + compressed))
        lowered = x_p ** (-1.0 / c.gamma_a)
        x_r = expansion * lowered / (b.compression_ratio * x_v)
        released = q * ((1.0 - b.x_cv) / c.c_pa + b.x_cv / c_va) + compressed
        T_e = b.eta_sc * (Pi_e / expansion) / heated / (x_p * lowered) * released
        T_1 = x_r * T_e + (1.0 - x_r) * T_im
    return T_e


@njit(cache=True)
def pipe_temperature(plant: Plant, T_e: float, W_eo: float, T_amb: float) -> float:
    """Return T_em [K]: the gas has cooled on its way through the pipes."""
    return T_amb + (T_e - T_amb) * exp(-plant.body.pipe / (W_eo * plant.engine.c_pe))


@njit(cache=True)
def vgt_area_ratio(plant: Plant, u_vgt: float) -> float:
    """Return f_vgt [-] of Eq. (2): part of an ellipse over the vane opening [%]."""
    c = plant.engine
    inside = 1.0 - ((u_vgt - c.c_vgt2) / c.c_vgt1) ** 2
    return max(c.f_vgt_min, c.c_f2 + c.c_f1 * sqrt(max(inside, 0.0)))


@njit(cache=True)
def turbine_flow(
    plant: Plant, p_em: float, u_vgt: float, T_em: float, p_amb: float, factor: float = 1.0
) -> tuple[float, float]:
    """Return W_t [kg/s] of Eq. (2) and outlet over inlet pressure, by three fixed-point passes; `factor` is on the area."""
    # They come within 0.2 % of the solution as long as the back pressure is that of a clean exhaust, and swing around it when
    # it is several times that; with a restriction, Newton's method solves the two equations instead.
    c = plant.engine
    scale = factor * (c.A_vgt_max * vgt_area_ratio(plant, u_vgt)) * p_em / sqrt(T_em * c.R_e)
    if plant.condition.exhaust_restriction != 1.0:
        return restricted_flow(scale, p_em, p_amb, plant.condition.exhaust_restriction * c.k_exhaust, c.K_t)
    W_t, Pi_t = 0.0, 0.9999
    for _ in range(3):
        Pi_t = min((p_amb + c.k_exhaust * W_t**2) / p_em, 0.9999)
        W_t = scale * sqrt(1.0 - Pi_t**c.K_t)  # Eq. (2)
    return W_t, Pi_t


@njit(cache=True)
def restricted_flow(scale: float, p_em: float, p_amb: float, k_exhaust: float, K_t: float) -> tuple[float, float]:
    """Return W_t [kg/s] and Pi_t of W_t = scale sqrt(1 - Pi_t^K_t), Pi_t = (p_amb + k_exhaust W_t^2) / p_em."""
    # In the logarithm of Pi_t the one equation that is left is concave, and between its bends nearly straight: six steps of
    # Newton from nearly equal pressures come down to the solution from one side.
    strength, logarithm = k_exhaust / p_em * scale**2, log(0.9999)
    for _ in range(6):
        Pi_t, power = exp(logarithm), exp(K_t * logarithm)
        excess = p_amb / p_em + strength * (1.0 - power) - Pi_t
        logarithm = min(logarithm + excess / (strength * K_t * power + Pi_t), log(0.9999))
    return scale * sqrt(1.0 - exp(K_t * logarithm)), exp(logarithm)


@njit(cache=True)
def turbine_power(plant: Plant, W_t: float, Pi_t: float, omega_t: float, T_em: float) -> float:
    """Return P_t eta_m [W] of Eq. (2)."""
    c = plant.engine
    drop = c.c_pe * T_em * (1.0 - Pi_t ** (1.0 - 1.0 / c.gamma_e))
    blade_speed_ratio = c.R_t * omega_t / sqrt(2.0 * drop)
    c_m = c.c_m
    if c.turbine_form == ROTOR_SPEED:
        c_m = c.c_m1 * max(0.0, omega_t - c.c_m2) ** c.c_m3  # Wahlstrom and Eriksson (2011)
    eta_tm = c.eta_tm_max - c_m * (blade_speed_ratio - c.bsr_opt) ** 2
    return plant.condition.turbine_efficiency * min(max(eta_tm, c.eta_tm_min), 1.0) * W_t * drop  # Eq. (2)
