"""A plant of another structure: what real diesels do and the model's equations do not say, each form with an amplitude.

The forms of filling, EGR valve, turbocharger and pipes: scalars, SI units, speed in rpm; those of sensors stand in `instruments`.
They were written and frozen before anything that corrects a model for them. Each depends on an input that a curve over the
component's own inputs lacks, or is finer than the knots of such a curve.
"""

from math import cos, exp, pi, sin, sqrt, tanh
from typing import NamedTuple

from lpvobs.compiled import njit
from lpvobs.simulation import plant as relation
from lpvobs.simulation.parameters import Amplitudes
from lpvobs.simulation.plant import Inputs, Plant

RUNNER = 0.45  # m, intake runner from plenum to valve; 0.3 to 0.6 in passenger cars
CROWDED = 20.0  # kg/(s m^3), at which the charge is heated as the constants say: middle of the range


@njit(cache=True)
def filling_factor(
    s: Amplitudes, n_e: float, p_im: float, p_em: float, T_im: float, T_wall: float, crowd: float, r_c: float
) -> float:
    """Return the flow into the cylinders over that of the model [-]."""
    # `T_wall` [K] of the intake ports follows coolant and load slowly; `crowd` is the flow per displacement [kg/(s m^3)],
    # `r_c` the compression ratio.
    rings = 1.0 + s.wave * wave(n_e, p_im, T_im)
    fresh = 1.0 - s.residual_gas * residual_gas(n_e, p_im, p_em, r_c)
    return rings * fresh / (1.0 + s.charge_heating * charge_heating(T_im, T_wall, crowd))


@njit(cache=True)
def wave(n_e: float, p_im: float, T_im: float) -> float:
    """Return what the pressure wave in the runner adds to the filling [-], up to 3 %."""
    # The runner is a quarter-wave pipe that rings q = a_s / (4 l) * 60 / n_e times a revolution; what is left of it when
    # the valve closes pushes or pulls (Ohata and Ishida, SAE 820407, 1982; Heywood, Internal Combustion Engine
    # Fundamentals, 1988, Sec. 6.2). Denser charge rings stronger. Against a curve: crests are 200 to 500 rpm apart, and the
    # speed of sound moves them with T_im.
    q = sqrt(1.4 * 287.0 * T_im) / (4.0 * RUNNER) * 60.0 / n_e
    return 0.03 * exp(-0.12 * (q - 3.0)) * cos(2.0 * pi * q) * (0.6 + 0.4 * min(p_im / 1.5e5, 2.0))


@njit(cache=True)
def residual_gas(n_e: float, p_im: float, p_em: float, r_c: float) -> float:
    """Return the share of the cylinder that residual gas takes from the charge [-], less that at equal pressures.

    The gas of the clearance volume expands by p_em/p_im, (p_em/p_im - 1)/(gamma (r_c - 1)) (Heywood 1988, Eq. 6.2), and the overlap
    of the valves lets exhaust back in, in proportion to sqrt(p_em - p_im) / n_e (Fox, Cheng, Heywood, SAE 931025, 1993, with an
    overlap factor of 0.5 deg/m). Against a curve: three inputs at once.
    """
    expanded = (p_em / p_im - 1.0) / (1.35 * (r_c - 1.0))
    driving = sqrt(abs(p_em - p_im) / 1e5) * (p_em / p_im) ** 0.87
    drawn = 1.266 * 0.5 * 60.0 / n_e * driving
    return expanded + (drawn if p_em > p_im else 0.0)


@njit(cache=True)
def charge_heating(T_im: float, T_wall: float, crowd: float) -> float:
    """Return by which share of its temperature ports and valves heat the charge [-], less that at the point of reference."""
    # A turbulent flow takes up the share 0.18 (W/W_0)^-0.2 of the difference to the wall (Heywood 1988, Sec. 6.2; Eriksson
    # and Nielsen, Modeling and Control of Engines and Drivelines, 2014, Ch. 7). Against a curve: the wall follows coolant
    # and load within half a minute, which no balance sees.
    uptake = 0.18 * (min(max(crowd, 2.0), 100.0) / CROWDED) ** -0.2
    return uptake * (T_wall - T_im) / T_im - 0.18 * (370.0 - 320.0) / 320.0


PHASES = (cos(0.125 * pi), cos(0.375 * pi), -cos(0.375 * pi), -cos(0.125 * pi))
"""Of a cosine; the mean over them is that over eight phases of the pulse."""
TRACT = 0.8  # m, exhaust manifold from valve to turbine and back to the EGR valve


@njit(cache=True)
def other_egr(
    plant: Plant, p_im: float, p_em: float, u_egr: float, T_im: float, T_em: float, n_e: float, u_delta: float
) -> float:
    """Return W_egr [kg/s] through another area, the mean over a pulse of the exhaust pressure."""
    amplitude = plant.structure.egr
    factor = area_factor(amplitude, u_egr, plant.engine.c_egr1, plant.engine.c_egr2)
    pulse, flow = pulsation(amplitude, n_e, u_delta, T_em), 0.0
    for phase in PHASES:
        flow += 0.25 * relation.egr_flow(plant, p_im, p_em * (1.0 + pulse * phase), u_egr, T_im, T_em, factor)
    return flow


@njit(cache=True)
def area_factor(amplitude: float, u_egr: float, c_egr1: float, c_egr2: float) -> float:
    """Return the effective area of the valve over that of the model [-]."""
    # A poppet valve passes through its curtain at small lift and through its seat at large, and its discharge coefficient
    # falls from 0.70 to 0.46 with a step where the flow leaves the seat (Heywood 1988, Sec. 6.3.2). The model has the
    # parabola c_egr1 u^2 + c_egr2 u up to its vertex; they meet half way there. Against a curve: the step is 5 % of the
    # stroke wide.
    vertex = -0.5 * c_egr2 / c_egr1
    opened = min(max(u_egr / vertex, 0.01), 1.0)
    parabola = opened * (2.0 - opened) / 0.75
    return 1.0 + amplitude * (poppet_area(opened) / poppet_area(0.5) / parabola - 1.0)


@njit(cache=True)
def poppet_area(opened: float) -> float:
    """Return the effective area of a poppet valve over that of its seat [-]; it lifts by up to 0.4 of its diameter."""
    lift = 0.4 * opened
    curtain = 4.0 * lift / (1.0 + (4.0 * lift) ** 3) ** (1.0 / 3.0)
    return curtain * (0.70 - 0.5 * lift - 0.02 * (1.0 + tanh((lift - 0.11) / 0.01)))


@njit(cache=True)
def pulsation(amplitude: float, n_e: float, u_delta: float, T_em: float) -> float:
    """Return the amplitude of the pulses of p_em over their mean [-], 3 to 20 %."""
    # Load makes them, and they ring in the tract a_s / (4 l) * 30 / n_e times between two exhaust strokes (Heywood 1988,
    # Sec. 6.5; Guzzella and Onder, Introduction to Modeling and Control of Internal Combustion Engine Systems, 2010, Ch.
    # 2). Against a curve: load and speed are no inputs of a valve, and crests are some 500 rpm apart.
    q = sqrt(1.32 * 286.0 * T_em) / (4.0 * TRACT) * 30.0 / n_e
    ringing = 1.0 + 0.5 * exp(-0.15 * q) * cos(2.0 * pi * q)
    return amplitude * (0.04 + 0.08 * min(u_delta / 40.0, 1.5)) * ringing


STEPS = 3  # of the secant between flow and pressure losses; they leave less than 1e-6 of the flow
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
    """Return the air through filter, compressor and intercooler."""
    # Losses are those of incompressible restrictions, dp = k W^2 / rho (Eriksson and Nielsen 2014, Ch. 7; Guzzella and
    # Onder 2010, Sec. 2.3): 1.5 kPa in the filter and 4 to 6 kPa in the intercooler at high flow. Against a curve: the
    # pressure ratio that is logged is not the compressor's, by an amount that follows flow and density.
    s, U = plant.structure, plant.engine.R_c * omega_t
    inlet, warming = soaked(s.compressor, U, T_em - T_amb)
    T_in = T_amb + inlet
    W_c = stage_flow(plant, p_im, p_amb, omega_t, T_in)
    if s.pipes > 0.0:
        W_c = flow_with_losses(plant, W_c, p_im, p_amb, omega_t, T_amb, T_in)
    p_in, p_out = behind_losses(plant, W_c, p_im, p_amb, T_amb)
    return Stage(W_c, p_in, p_out, T_in, reynolds(s.compressor, U, p_in, T_in), warming)


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
    """Return W_c [kg/s] on speed lines of another family, at the Reynolds number of the inlet."""
    # The family is psi = (k_1 + k_2 phi) / (k_3 - phi) with k_3 over the blade's Mach number (Jensen, Kristensen, Sorenson,
    # Houbak and Hendricks, SAE 910070, 1991), through the model's points of no flow and of no head: lines bend less at low
    # speed and more at high. Flow follows half of what Reynolds' number does to efficiency (Casey, J. Eng. Gas Turbines
    # Power 107, 1985).
    W_c = relation.compressor_flow(plant, p_out, omega_t, p_in, T_in)
    amplitude = plant.structure.compressor
    if amplitude == 0.0:
        return W_c
    U = plant.engine.R_c * omega_t
    widest = relation.compressor_flow(plant, p_in, omega_t, p_in, T_in)
    if W_c < widest:
        x = W_c / widest
        head = sqrt(1.0 - x * x)  # over the head of no flow, on the model's ellipse
        k_3 = 1.27 - 0.12 * min(U / 400.0, 1.2)  # over the flow coefficient of no head
        W_c = widest * ((1.0 - amplitude) * x + amplitude * k_3 * (1.0 - head) / (k_3 - head))
    return max(0.0, W_c * (1.0 - 0.15 * (reynolds(amplitude, U, p_in, T_in) - 1.0)))


@njit(cache=True)
def reynolds(amplitude: float, U: float, p_in: float, T_in: float) -> float:
    """Return (1 - eta) over that at 150 m/s, 98 kPa and 298 K [-]: 0.3 + 0.7 (Re_0/Re)^0.2 (Casey 1985)."""
    # Against a curve: pressure and temperature of the inlet, altitude and weather, change it at the same corrected speed.
    Re = max(U, 20.0) / 150.0 * (p_in / 98e3) * (298.0 / T_in) ** 1.7
    return 1.0 + amplitude * 0.7 * (Re**-0.2 - 1.0)


@njit(cache=True)
def soaked(amplitude: float, U: float, hotter: float) -> tuple[float, float]:
    """Return by how much [K] the turbine's heat warms the air before and after compression; `hotter` is T_em - T_amb."""
    # The slower the wheel, the longer the air stays in the housing (Sirakov and Casey, J. Turbomach. 135, 2013). Against a
    # curve: the exhaust's temperature is no input of a compressor.
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
    W_t, Pi_t = relation.turbine_flow(plant, p_em, u_vgt, T_in, given.p_amb, area)
    return W_t, turbine_factor(amplitude, u_vgt, given.n_e) * relation.turbine_power(plant, W_t, Pi_t, omega_t, T_in)


@njit(cache=True)
def turbine_inlet(amplitude: float, T_em: float, T_amb: float, crowd: float) -> float:
    """Return the temperature [K] at the rotor: volute and housing take their share before the gas expands."""
    # 5 % of the difference at mean flow, more at less flow (Watson and Janota, Turbocharging the Internal Combustion
    # Engine, 1982; Sirakov and Casey 2013).
    share = min(0.05 * sqrt(20.0 / max(crowd, 1.0)), 0.2)
    return T_em - amplitude * share * (T_em - T_amb)


@njit(cache=True)
def turbine_area(plant: Plant, u_vgt: float, omega_t: float, T_in: float) -> float:
    """Return the turbine's effective area over that of the model [-]."""
    # The throat between two vanes is as the sine of their angle, 12 to 78 degrees (Watson and Janota 1982), where the model
    # has an ellipse; and the rotor throws the gas back outward, which takes some of the flow at high speed (Futral and
    # Wasserbauer, NASA TN D-2621, 1965). Against a curve: turbine speed is no input of a nozzle.
    amplitude, c = plant.structure.turbine, plant.engine
    throat = sin((12.0 + 0.66 * min(max(u_vgt, 0.0), 100.0)) * pi / 180.0) / sin(78.0 * pi / 180.0)
    thrown = 0.15 * ((c.R_t * omega_t) ** 2 / (c.gamma_e * c.R_e * T_in) - 0.16)
    return (1.0 + amplitude * (throat / relation.vgt_area_ratio(plant, u_vgt) - 1.0)) * (1.0 - amplitude * thrown)


@njit(cache=True)
def turbine_factor(amplitude: float, u_vgt: float, n_e: float) -> float:
    """Return the turbine's power over that of the model [-]."""
    # Vanes far from their design angle lose up to 12 % by incidence (Watson and Janota 1982), and the pulses of few
    # cylinders at low speed some more (Heywood 1988, Sec. 6.8.4). Against a curve: engine speed is no input of a turbine.
    incidence = 0.12 * min(((u_vgt - 55.0) / 50.0) ** 2, 1.0) - 0.03
    return 1.0 - amplitude * (incidence + 0.05 * (exp(-n_e / 1500.0) - 0.25))
