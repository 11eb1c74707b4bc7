"""Forms of the filling: factors on the flow into the cylinders. All scalars, SI units, speed in rpm."""

from math import cos, exp, pi, sqrt

from lpvobs.compiled import njit
from lpvobs.simulation.structure.amplitudes import Amplitudes

RUNNER = 0.45  # m, intake runner from plenum to valve; 0.3 to 0.6 in passenger cars
CROWDED = (
    20.0  # kg/(s m^3), flow per displacement at which the charge is heated as the constants say: middle of the range
)


@njit(cache=True)
def filling_factor(
    s: Amplitudes, n_e: float, p_im: float, p_em: float, T_im: float, T_wall: float, crowd: float, r_c: float
) -> float:
    """Return the flow into the cylinders over that of the model [-].

    `T_wall` [K] of the intake ports follows coolant and load slowly; `crowd` is the flow per displacement [kg/(s m^3)], `r_c`
    the compression ratio.
    """
    factor = 1.0
    if s.wave > 0.0:
        factor *= 1.0 + s.wave * wave(n_e, p_im, T_im)
    if s.residual_gas > 0.0:
        factor *= 1.0 - s.residual_gas * residual_gas(n_e, p_im, p_em, r_c)
    if s.charge_heating > 0.0:
        factor /= 1.0 + s.charge_heating * charge_heating(T_im, T_wall, crowd)
    return factor


@njit(cache=True)
def wave(n_e: float, p_im: float, T_im: float) -> float:
    """Return what the pressure wave in the runner adds to the filling [-], up to 3 %.

    The runner is a quarter-wave pipe that rings q = a_s / (4 l) * 60 / n_e times a revolution; what is left of it when the valve
    closes pushes or pulls (Ohata and Ishida, SAE 820407, 1982; Heywood, Internal Combustion Engine Fundamentals, 1988, Sec. 6.2).
    Denser charge rings stronger. Against a curve: crests are 200 to 500 rpm apart, and the speed of sound moves them with T_im.
    """
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
    """Return by which share of its temperature ports and valves heat the charge [-], less that at the point of reference.

    A turbulent flow takes up the share 0.18 (W/W_0)^-0.2 of the difference to the wall (Heywood 1988, Sec. 6.2; Eriksson and
    Nielsen, Modeling and Control of Engines and Drivelines, 2014, Ch. 7). Against a curve: the wall follows coolant and load
    within half a minute, which no balance sees.
    """
    uptake = 0.18 * (min(max(crowd, 2.0), 100.0) / CROWDED) ** -0.2
    return uptake * (T_wall - T_im) / T_im - 0.18 * (370.0 - 320.0) / 320.0
