"""The simulator's own EGR and VGT control: set-points over speed and fuel, two PI controllers that act at a fixed period."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lpvobs.simulation.parameters import SimulationParameters

Array = NDArray[np.float64]


class Targets(NamedTuple):
    """Set-points and gains as the compiled functions read them; see `parameters.Setpoints` and `parameters.Control`."""

    boost_n_e: Array
    boost_u_delta: Array
    boost: Array
    air_n_e: Array
    air_u_delta: Array
    air: Array
    off_above_u: float
    off_below_u: float
    off_above_n: float
    delta_p_0: float
    delta_p_1: float
    n_cyl: float
    period: float
    egr_kp: float
    egr_ki: float
    egr_max: float
    pressure_kp: float
    pressure_ki: float
    boost_kp: float
    boost_ki: float
    vgt_min: float
    vgt_max: float


class Commands(NamedTuple):
    """Commanded openings [%] and the two integrators [%] that led to them."""

    u_egr: float
    u_vgt: float
    egr_integral: float
    vgt_integral: float


def targets_of(parameters: SimulationParameters, n_cyl: int) -> Targets:
    """Return set-points and gains as arrays and floats."""
    points, gains = parameters.setpoints, parameters.control
    return Targets(
        boost_n_e=np.array(points.boost_n_e, dtype=float),
        boost_u_delta=np.array(points.boost_u_delta, dtype=float),
        boost=np.array(points.boost, dtype=float),
        air_n_e=np.array(points.air_n_e, dtype=float),
        air_u_delta=np.array(points.air_u_delta, dtype=float),
        air=np.array(points.air, dtype=float),
        off_above_u=float(points.egr_off_above_u_delta),
        off_below_u=float(points.egr_off_below_u_delta),
        off_above_n=float(points.egr_off_above_n_e),
        delta_p_0=float(points.delta_p[0]),
        delta_p_1=float(points.delta_p[1]),
        n_cyl=float(n_cyl),
        period=float(gains.period),
        egr_kp=float(gains.egr_proportional),
        egr_ki=float(gains.egr_integral),
        egr_max=float(gains.egr_max),
        pressure_kp=float(gains.pressure_proportional),
        pressure_ki=float(gains.pressure_integral),
        boost_kp=float(gains.boost_proportional),
        boost_ki=float(gains.boost_integral),
        vgt_min=float(gains.vgt_min),
        vgt_max=float(gains.vgt_max),
    )


@njit(cache=True)
def look_up(rows: Array, columns: Array, values: Array, row: float, column: float) -> float:
    """Return the bilinear value of a table, held outside its axes."""
    i = min(max(int(np.searchsorted(rows, row)) - 1, 0), rows.size - 2)
    j = min(max(int(np.searchsorted(columns, column)) - 1, 0), columns.size - 2)
    a = min(max((row - rows[i]) / (rows[i + 1] - rows[i]), 0.0), 1.0)
    b = min(max((column - columns[j]) / (columns[j + 1] - columns[j]), 0.0), 1.0)
    low = (1.0 - b) * values[i, j] + b * values[i, j + 1]
    high = (1.0 - b) * values[i + 1, j] + b * values[i + 1, j + 1]
    return (1.0 - a) * low + a * high


@njit(cache=True)
def egr_is_active(targets: Targets, n_e: float, u_demand: float) -> bool:
    """Return whether this operating point runs with EGR."""
    return targets.off_below_u <= u_demand <= targets.off_above_u and n_e <= targets.off_above_n


@njit(cache=True)
def fresh_air_error(targets: Targets, n_e: float, u_demand: float, W_c: float) -> float:
    """Return by how much the fresh air exceeds its set-point, relative to that."""
    per_stroke = look_up(targets.air_n_e, targets.air_u_delta, targets.air, n_e, u_demand)
    wanted = 1e-6 * per_stroke * n_e * targets.n_cyl / 120.0
    return W_c / wanted - 1.0


@njit(cache=True)
def control(
    targets: Targets, last: Commands, n_e: float, u_demand: float, p_im: float, p_em: float, W_c: float, p_amb: float
) -> Commands:
    """Return the next commands.

    With EGR active the valve opens while there is more fresh air than wanted, and the vanes hold p_em - p_im; otherwise the valve
    is shut and the vanes hold the boost. The integrators stop at the limits of what they drive; the valve's rests while shut.
    """
    if egr_is_active(targets, n_e, u_demand):
        excess = fresh_air_error(targets, n_e, u_demand, W_c)
        egr_integral = min(max(last.egr_integral + targets.period * targets.egr_ki * excess, 0.0), targets.egr_max)
        u_egr = min(max(egr_integral + targets.egr_kp * excess, 0.0), targets.egr_max)
        missing = targets.delta_p_0 + targets.delta_p_1 * n_e - (p_em - p_im)
        kp, ki = targets.pressure_kp, targets.pressure_ki
    else:
        egr_integral, u_egr = last.egr_integral, 0.0
        missing = look_up(targets.boost_n_e, targets.boost_u_delta, targets.boost, n_e, u_demand) * p_amb - p_im
        kp, ki = targets.boost_kp, targets.boost_ki
    vgt_integral = min(max(last.vgt_integral - targets.period * ki * missing, targets.vgt_min), targets.vgt_max)
    u_vgt = min(max(vgt_integral - kp * missing, targets.vgt_min), targets.vgt_max)
    return Commands(u_egr, u_vgt, egr_integral, vgt_integral)
