"""The test bench: from an engine cycle's normalised speed and torque to engine speed and fuel."""

import numpy as np

from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.simulation.cycles import EngineCycle
from lpvobs.simulation.parameters import FullLoad
from lpvobs.simulation.vehicle import Work, fuel, smooth, torque

SMOOTHING = 0.3  # s, width of each of two moving averages over the cycle's straight pieces
CURVE_STEP = 1.0  # rpm


def drive_engine_cycle(full_load: FullLoad, work: Work, cycle: EngineCycle, raster: float) -> tuple[Array, Array]:
    """Return n_e [rpm] and u_delta [mg/cycle] before the smoke limit, both of shape (M,), every `raster` seconds from zero."""
    n_e, u_delta = denormalise(full_load, work, cycle)
    time = np.arange(round(cycle.time[-1] / raster) + 1) * raster
    speed, quantity = (np.interp(time, cycle.time, column) for column in (n_e, u_delta))
    return smooth(speed, SMOOTHING / raster), smooth(quantity, SMOOTHING / raster)


def denormalise(full_load: FullLoad, work: Work, cycle: EngineCycle) -> tuple[Array, Array]:
    """Return n_e [rpm] and u_delta [mg/cycle] in every row of the cycle; motoring is no fuel."""
    span = (harmonised_span if cycle.world_harmonised else european_span)(full_load, work)
    fastest = full_load.n_e[-1]
    n_e = np.clip(full_load.idle_speed + span * cycle.speed / 100.0, full_load.idle_speed, fastest)
    most = np.interp(n_e, full_load.n_e, full_load.u_delta)
    wanted = cycle.torque / 100.0 * np.array([torque(work, n, u) for n, u in zip(n_e, most, strict=True)])
    burnt = np.array([fuel(work, n, M) for n, M in zip(n_e, wanted, strict=True)])
    return n_e, np.where(cycle.motoring, 0.0, np.minimum(burnt, most))


def european_span(full_load: FullLoad, work: Work) -> float:
    """Return reference minus idle speed [rpm] of the ETC: n_ref = n_lo + 0.95 (n_hi - n_lo), at 50 and 70 % of rated power."""
    n_lo, n_hi = speed_at_power(full_load, work, 0.50, first=True), speed_at_power(full_load, work, 0.70, first=False)
    return n_lo + 0.95 * (n_hi - n_lo) - full_load.idle_speed


def harmonised_span(full_load: FullLoad, work: Work) -> float:
    """Return the speed [rpm] that 100 % of the WHTC's norm speed adds to idle.

    From n_lo at 55 % and n_hi at 70 % of rated power and the preferred speed n_pref, at which 51 % of the area under the curve of
    full-load torque are reached, counted from idle to the highest speed with 95 % of rated power.
    """
    n_lo, n_hi = speed_at_power(full_load, work, 0.55, first=True), speed_at_power(full_load, work, 0.70, first=False)
    curve = np.arange(full_load.idle_speed, speed_at_power(full_load, work, 0.95, first=False), CURVE_STEP)
    area = np.cumsum(full_load_torque(full_load, work, curve))
    n_pref = float(np.interp(0.51 * area[-1], area, curve))
    return (0.45 * n_lo + 0.45 * n_pref + 0.1 * n_hi - full_load.idle_speed) * 2.0327


def speed_at_power(full_load: FullLoad, work: Work, share: float, first: bool) -> float:
    """Return the lowest (`first`) or highest speed [rpm] at which full load gives this share of rated power.

    Raises UsageError if full load gives no power.
    """
    curve = np.arange(full_load.n_e[0], full_load.n_e[-1], CURVE_STEP)
    power = full_load_torque(full_load, work, curve) * curve
    if not power.max() > 0:
        raise UsageError("[simulation.full_load]: the engine gives no power at full load; raise u_delta")
    reached = curve[power >= share * power.max()]
    return float(reached[0] if first else reached[-1])


def full_load_torque(full_load: FullLoad, work: Work, n_e: Array) -> Array:
    """Return the torque [Nm] at full load for each speed [rpm], shape (M,)."""
    most = np.interp(n_e, full_load.n_e, full_load.u_delta)
    return np.array([torque(work, n, u) for n, u in zip(n_e, most, strict=True)])
