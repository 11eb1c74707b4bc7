"""The simulator's own EGR and VGT control: set-points over speed and fuel, two PI controllers that act at a fixed period."""

from typing import NamedTuple

import numpy as np

from lpvobs.compiled import njit
from lpvobs.engines.flat import flat, flat_type, names_of
from lpvobs.records import Array
from lpvobs.simulation.parameters import Control, Setpoints, SimulationParameters


class Targets(flat_type([*names_of(Setpoints, Control), "n_cyl"])):  # type: ignore[misc]
    """Set-points and gains as the compiled functions read them."""


class Commands(NamedTuple):
    """Commanded openings [%] and the two integrators [%] that led to them."""

    u_egr: float
    u_vgt: float
    egr_integral: float
    vgt_integral: float


def targets_of(parameters: SimulationParameters, n_cyl: int) -> Targets:
    """Return set-points and gains as arrays and floats."""
    return flat(Targets, parameters.setpoints, parameters.control, n_cyl=n_cyl)


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
    return (
        targets.egr_off_below_u_delta <= u_demand <= targets.egr_off_above_u_delta and n_e <= targets.egr_off_above_n_e
    )


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
        egr_integral = min(
            max(last.egr_integral + targets.period * targets.egr_integral * excess, 0.0), targets.egr_max
        )
        u_egr = min(max(egr_integral + targets.egr_proportional * excess, 0.0), targets.egr_max)
        missing = targets.delta_p[0] + targets.delta_p[1] * n_e - (p_em - p_im)
        kp, ki = targets.pressure_proportional, targets.pressure_integral
    else:
        egr_integral, u_egr = last.egr_integral, 0.0
        missing = look_up(targets.boost_n_e, targets.boost_u_delta, targets.boost, n_e, u_demand) * p_amb - p_im
        kp, ki = targets.boost_proportional, targets.boost_integral
    vgt_integral = min(max(last.vgt_integral - targets.period * ki * missing, targets.vgt_min), targets.vgt_max)
    u_vgt = min(max(vgt_integral - kp * missing, targets.vgt_min), targets.vgt_max)
    return Commands(u_egr, u_vgt, egr_integral, vgt_integral)
