"""Form of the EGR valve: another area over the opening, and an exhaust pressure that pulsates."""

from math import cos, exp, pi, sqrt, tanh

from lpvobs.compiled import njit
from lpvobs.simulation.plant import Plant, egr_flow

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
        flow += 0.25 * egr_flow(plant, p_im, p_em * (1.0 + pulse * phase), u_egr, T_im, T_em, factor)
    return flow


@njit(cache=True)
def area_factor(amplitude: float, u_egr: float, c_egr1: float, c_egr2: float) -> float:
    """Return the effective area of the valve over that of the model [-].

    A poppet valve passes through its curtain at small lift and through its seat at large, and its discharge coefficient falls from
    0.70 to 0.46 with a step where the flow leaves the seat (Heywood 1988, Sec. 6.3.2). The model has the parabola c_egr1 u^2 +
    c_egr2 u up to its vertex; they meet half way there. Against a curve: the step is 5 % of the stroke wide.
    """
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
    """Return the amplitude of the pulses of p_em over their mean [-], 3 to 20 %.

    Load makes them, and they ring in the tract a_s / (4 l) * 30 / n_e times between two exhaust strokes (Heywood 1988, Sec. 6.5;
    Guzzella and Onder, Introduction to Modeling and Control of Internal Combustion Engine Systems, 2010, Ch. 2). Against a curve:
    load and speed are no inputs of a valve, and crests are some 500 rpm apart.
    """
    q = sqrt(1.32 * 286.0 * T_em) / (4.0 * TRACT) * 30.0 / n_e
    ringing = 1.0 + 0.5 * exp(-0.15 * q) * cos(2.0 * pi * q)
    return amplitude * (0.04 + 0.08 * min(u_delta / 40.0, 1.5)) * ringing
