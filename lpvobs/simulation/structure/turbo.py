"""Forms of the turbocharger and of the pipes at the compressor."""

from math import exp, pi, sin, sqrt
from typing import NamedTuple

from lpvobs.compiled import njit
from lpvobs.simulation.plant import Inputs, Plant, compressor_flow, turbine_flow, turbine_power, vgt_area_ratio

STEPS = 3
"""Of the secant between flow and pressure losses; they leave less than 1e-6 of the flow."""
FILTER, COOLER = 0.76, 3.0
"""Pressure losses [Pa m^6/(kg/s)^2 per displacement squared] at 98 kPa and 298 K, and at 100 kPa and 300 K."""


class Stage(NamedTuple):
    """The air on its way through the compressor."""

    W_c: float  # kg/s
    p_in: float  # Pa, behind the air filter
    p_out: float  # Pa, before the intercooler
    T_in: float  # K
    loss: float  # of (1 - efficiency), over that of the model
    warming: float  # K, by the hot turbine, on top of compression


@njit(cache=True)
def compressor_stage(plant: Plant, p_im: float, omega_t: float, p_amb: float, T_amb: float, T_em: float) -> Stage:
    """Return the air through filter, compressor and intercooler.

    Losses are those of incompressible restrictions, dp = k W^2 / rho (Eriksson and Nielsen 2014, Ch. 7; Guzzella and Onder 2010,
    Sec. 2.3): 1.5 kPa in the filter and 4 to 6 kPa in the intercooler at high flow. Against a curve: the pressure ratio that is
    logged is not the compressor's, by an amount that follows flow and density.
    """
    s = plant.structure
    T_in, warming = T_amb, 0.0
    if s.compressor > 0.0:
        inlet, warming = soaked(s.compressor, plant.engine.R_c * omega_t, T_em - T_amb)
        T_in += inlet
    W_c = stage_flow(plant, p_im, p_amb, omega_t, T_in)
    p_in, p_out = p_amb, p_im
    if s.pipes > 0.0:
        W_c = flow_with_losses(plant, W_c, p_im, p_amb, omega_t, T_amb, T_in)
        p_in, p_out = behind_losses(plant, W_c, p_im, p_amb, T_amb)
    loss = reynolds(s.compressor, plant.engine.R_c * omega_t, p_in, T_in) if s.compressor > 0.0 else 1.0
    return Stage(W_c, p_in, p_out, T_in, loss, warming)


@njit(cache=True)
def behind_losses(plant: Plant, W_c: float, p_im: float, p_amb: float, T_amb: float) -> tuple[float, float]:
    """Return the pressures [Pa] before and behind the compressor at a flow [kg/s]."""
    squared = plant.structure.pipes * (W_c / plant.engine.V_d) ** 2
    return p_amb - FILTER * squared * (98e3 / p_amb) * (T_amb / 298.0), p_im + COOLER * squared * (1e5 / p_im)


@njit(cache=True)
def flow_with_losses(
    plant: Plant, lossless: float, p_im: float, p_amb: float, omega_t: float, T_amb: float, T_in: float
) -> float:
    """Return W_c [kg/s] that makes the very losses against which it flows; excess falls by more than the flow rises."""
    last, excess_last, W_c = lossless, 0.0, lossless
    for step in range(STEPS + 1):
        p_in, p_out = behind_losses(plant, W_c, p_im, p_amb, T_amb)
        excess = stage_flow(plant, p_out, p_in, omega_t, T_in) - W_c
        slope = -1.3 if step == 0 or W_c == last else min((excess - excess_last) / (W_c - last), -1.0)
        last, excess_last, W_c = W_c, excess, max(W_c - excess / slope, 0.0)
    return W_c


@njit(cache=True)
def stage_flow(plant: Plant, p_out: float, p_in: float, omega_t: float, T_in: float) -> float:
    """Return W_c [kg/s] on speed lines of another family, at the Reynolds number of the inlet.

    The family is psi = (k_1 + k_2 phi) / (k_3 - phi) with k_3 over the blade's Mach number (Jensen, Kristensen, Sorenson, Houbak
    and Hendricks, SAE 910070, 1991), through the model's points of no flow and of no head: lines bend less at low speed and more at
    high. Flow follows half of what Reynolds' number does to efficiency (Casey, J. Eng. Gas Turbines Power 107, 1985).
    """
    W_c = compressor_flow(plant, p_out, omega_t, p_in, T_in)
    amplitude = plant.structure.compressor
    if amplitude == 0.0:
        return W_c
    U = plant.engine.R_c * omega_t
    widest = compressor_flow(plant, p_in, omega_t, p_in, T_in)
    if W_c < widest:
        x = W_c / widest
        head = sqrt(1.0 - x * x)  # over the head of no flow, on the model's ellipse
        k_3 = 1.27 - 0.12 * min(U / 400.0, 1.2)  # over the flow coefficient of no head
        W_c = widest * ((1.0 - amplitude) * x + amplitude * k_3 * (1.0 - head) / (k_3 - head))
    return max(0.0, W_c * (1.0 - 0.15 * (reynolds(amplitude, U, p_in, T_in) - 1.0)))


@njit(cache=True)
def reynolds(amplitude: float, U: float, p_in: float, T_in: float) -> float:
    """Return (1 - eta) over that at 150 m/s, 98 kPa and 298 K [-]: 0.3 + 0.7 (Re_0/Re)^0.2 (Casey 1985).

    Against a curve: pressure and temperature of the inlet, altitude and weather, change it at the same corrected speed.
    """
    Re = max(U, 20.0) / 150.0 * (p_in / 98e3) * (298.0 / T_in) ** 1.7
    return 1.0 + amplitude * 0.7 * (Re**-0.2 - 1.0)


@njit(cache=True)
def soaked(amplitude: float, U: float, hotter: float) -> tuple[float, float]:
    """Return by how much [K] the turbine's heat warms the air before and after compression; `hotter` is T_em - T_amb.

    The slower the wheel, the longer the air stays in the housing (Sirakov and Casey, J. Turbomach. 135, 2013). Against a curve: the
    exhaust's temperature is no input of a compressor.
    """
    heat = amplitude * 16.0 * max(hotter, 0.0) / 400.0 * exp(-U / 150.0)
    return 0.25 * heat, 0.75 * heat


@njit(cache=True)
def other_turbine(
    plant: Plant, p_em: float, u_vgt: float, omega_t: float, T_em: float, W_eo: float, given: Inputs
) -> tuple[float, float]:
    """Return the turbine's flow [kg/s] and its power times mechanical efficiency [W]."""
    amplitude = plant.structure.turbine
    T_in = turbine_inlet(amplitude, T_em, given.T_amb, W_eo / plant.engine.V_d)
    area = turbine_area(plant, u_vgt, omega_t, T_in)
    W_t, Pi_t = turbine_flow(plant, p_em, u_vgt, T_in, given.p_amb, area)
    return W_t, turbine_factor(amplitude, u_vgt, given.n_e) * turbine_power(plant, W_t, Pi_t, omega_t, T_in)


@njit(cache=True)
def turbine_inlet(amplitude: float, T_em: float, T_amb: float, crowd: float) -> float:
    """Return the temperature [K] at the rotor: volute and housing take their share before the gas expands.

    5 % of the difference at mean flow, more at less flow (Watson and Janota, Turbocharging the Internal Combustion Engine, 1982;
    Sirakov and Casey 2013).
    """
    share = min(0.05 * sqrt(20.0 / max(crowd, 1.0)), 0.2)
    return T_em - amplitude * share * (T_em - T_amb)


@njit(cache=True)
def turbine_area(plant: Plant, u_vgt: float, omega_t: float, T_in: float) -> float:
    """Return the turbine's effective area over that of the model [-].

    The throat between two vanes is as the sine of their angle, 12 to 78 degrees (Watson and Janota 1982), where the model has an
    ellipse; and the rotor throws the gas back outward, which takes some of the flow at high speed (Futral and Wasserbauer, NASA
    TN D-2621, 1965). Against a curve: turbine speed is no input of a nozzle.
    """
    amplitude, c = plant.structure.turbine, plant.engine
    throat = sin((12.0 + 0.66 * min(max(u_vgt, 0.0), 100.0)) * pi / 180.0) / sin(78.0 * pi / 180.0)
    thrown = 0.15 * ((c.R_t * omega_t) ** 2 / (c.gamma_e * c.R_e * T_in) - 0.16)
    return (1.0 + amplitude * (throat / vgt_area_ratio(plant, u_vgt) - 1.0)) * (1.0 - amplitude * thrown)


@njit(cache=True)
def turbine_factor(amplitude: float, u_vgt: float, n_e: float) -> float:
    """Return the turbine's power over that of the model [-].

    Vanes far from their design angle lose up to 12 % by incidence (Watson and Janota 1982), and the pulses of few cylinders at
    low speed some more (Heywood 1988, Sec. 6.8.4). Against a curve: engine speed is no input of a turbine.
    """
    incidence = 0.12 * min(((u_vgt - 55.0) / 50.0) ** 2, 1.0) - 0.03
    return 1.0 - amplitude * (incidence + 0.05 * (exp(-n_e / 1500.0) - 0.25))
