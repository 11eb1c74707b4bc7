"""What a drive asks of the engine, at every action of its control: an engine cycle on the test bench, or a vehicle on the road."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi

import numpy as np

from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.errors import UsageError
from lpvobs.records import Array
from lpvobs.simulation.cycles import EngineCycle, SpeedCycle, load_cycle
from lpvobs.simulation.instruments import wall_temperature
from lpvobs.simulation.integrate import Course
from lpvobs.simulation.parameters import FullLoad, SimulationParameters
from lpvobs.simulation.road import AUXILIARY, Auxiliary, road
from lpvobs.simulation.vehicle import Work, drive_speed_cycle, fuel, smooth, torque, work_of

SMOOTHING = 0.3  # s, width of each of two moving averages over the cycle's straight pieces
CURVE_STEP = 1.0  # rpm


def drive_engine_cycle(full_load: FullLoad, work: Work, cycle: EngineCycle, raster: float) -> tuple[Array, Array]:
    """Return n_e [rpm] and u_delta [mg/cycle] before the smoke limit, both of shape (M,), every `raster` seconds from zero."""
    slowest, fastest = full_load.idle_speed, full_load.n_e[-1]
    n_e = np.clip(slowest + norm_span(full_load, work, cycle.world_harmonised) * cycle.speed / 100.0, slowest, fastest)
    wanted = cycle.torque / 100.0 * full_load_torque(full_load, work, n_e)
    burnt = np.array([fuel(work, n, M) for n, M in zip(n_e, wanted, strict=True)])
    most = np.interp(n_e, full_load.n_e, full_load.u_delta)
    u_delta = np.where(cycle.motoring, 0.0, np.minimum(burnt, most))
    time = np.arange(round(cycle.time[-1] / raster) + 1) * raster
    speed, quantity = (np.interp(time, cycle.time, column) for column in (n_e, u_delta))
    return smooth(speed, SMOOTHING / raster), smooth(quantity, SMOOTHING / raster)


def norm_span(full_load: FullLoad, work: Work, world_harmonised: bool) -> float:
    """Return the speed [rpm] that 100 % of a cycle's norm speed, the WHTC's or the ETC's, adds to idle."""
    # From n_lo, the lowest speed with 55 % of rated power (ETC: 50 %), and n_hi, the highest with 70 %. The ETC's reference
    # speed is n_lo + 0.95 (n_hi - n_lo). At the WHTC's preferred speed n_pref 51 % of the area under the curve of full-load
    # torque are reached, counted from idle to the highest speed with 95 % of rated power.
    n_lo = speed_at_power(full_load, work, 0.55 if world_harmonised else 0.50, first=True)
    n_hi = speed_at_power(full_load, work, 0.70, first=False)
    if not world_harmonised:
        return n_lo + 0.95 * (n_hi - n_lo) - full_load.idle_speed
    curve = np.arange(full_load.idle_speed, speed_at_power(full_load, work, 0.95, first=False), CURVE_STEP)
    area = np.cumsum(full_load_torque(full_load, work, curve))
    n_pref = float(np.interp(0.51 * area[-1], area, curve))
    return (0.45 * n_lo + 0.45 * n_pref + 0.1 * n_hi - full_load.idle_speed) * 2.0327


def speed_at_power(full_load: FullLoad, work: Work, share: float, first: bool) -> float:
    """Return the lowest (`first`) or highest speed [rpm] with this share of rated power; raises UsageError if there is none."""
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


FASTEST = 30.0  # m/s, a likely vehicle's at the highest engine speed
IDLING = 50.0  # rpm above idle speed, below which a likely vehicle stands


@dataclass(frozen=True)
class DriveCourse:
    """The course of a drive and what a recorder could log along with it."""

    course: Course
    period: float  # [s] between its points
    channels: Mapping[str, Array]  # (M,) true auxiliary channels; none on the test bench
    logged: tuple[str, ...]  # those that the log will have

    @property
    def duration(self) -> float:
        """Length of the drive [s]."""
        return (self.course.n_e.size - 1) * self.period

    def at(self, time: Array, names: tuple[str, ...] = ()) -> dict[str, Array]:
        """Return air and channels, all of them or those named, at given times [s], shape (N,)."""
        actions = np.arange(self.course.n_e.size) * self.period
        everything = {"p_amb": self.course.p_amb, "T_amb": self.course.T_amb, **self.channels}
        return {name: np.interp(time, actions, everything[name]) for name in names or everything}


def scene_of(
    engine: DieselEngine, parameters: SimulationParameters, cycle: str, auxiliary: Auxiliary | None, seed: int
) -> DriveCourse:
    """Return the scene of a cycle, on the road where `auxiliary` is given; raises UsageError for one that cannot be driven."""
    period, work, table = parameters.control.period, work_of(engine, parameters), load_cycle(cycle)
    measured, ambient = isinstance(table, SpeedCycle), parameters.ambient
    if isinstance(table, SpeedCycle):
        if parameters.vehicle is None:
            said = "this cycle is a vehicle's speed over time, but the configuration has no [simulation.vehicle]"
            raise UsageError(f"--cycle {cycle}: {said}; choose an engine cycle such as whtc, or add that table")
        n_e, u_delta, speed = drive_speed_cycle(parameters.vehicle, work, table, period)
    else:
        n_e, u_delta = drive_engine_cycle(parameters.full_load, work, table, period)
        idle, fastest = parameters.full_load.idle_speed, parameters.full_load.n_e[-1]
        speed = np.where(n_e > idle + IDLING, FASTEST * (n_e - idle) / (fastest - idle), 0.0)  # a likely one
    V_d, heat = engine.geometry.V_d, parameters.combustion.q_HV * 1e-6 / 120.0 * u_delta * n_e * engine.geometry.n_cyl
    channels: Mapping[str, Array] = {}
    logged: tuple[str, ...] = ()
    if auxiliary is None:
        still = np.ones_like(n_e)
        p_amb, T_amb, coolant = ambient.p_amb * still, ambient.T_amb * still, parameters.cooling.T_cool * still
    else:
        p_amb, T_amb, load, channels = road(period, ambient.p_amb, ambient.T_amb, speed, measured, heat, seed)
        u_delta, coolant = with_load(work, parameters.full_load, n_e, u_delta, load), channels["T_coolant"]
        if "v_veh" in auxiliary.channels and not measured:
            said = f"[auxiliary]: cycle {cycle} is an engine cycle without a vehicle speed"
            raise UsageError(f"{said}; remove v_veh from channels")
        there = [name for name in AUXILIARY if measured or name != "v_veh"]
        logged = tuple(name for name in there if name in (auxiliary.channels or there))
    wall = wall_temperature(period, coolant, heat / V_d)
    return DriveCourse(Course(n_e, u_delta, p_amb, T_amb, wall, speed), period, channels, logged)


def with_load(work: Work, full_load: FullLoad, n_e: Array, u_delta: Array, load: Array) -> Array:
    """Return the fuel [mg/cycle], shape (M,), that carries another load [Nm] at the crankshaft; none in overrun."""
    # Full load gives no more: there the load takes from what drives the car.
    most = np.maximum(np.interp(n_e, full_load.n_e, full_load.u_delta), u_delta)
    return np.where(u_delta > 0.0, np.minimum(u_delta + 4.0 * pi * load / work.per_fuel, most), u_delta)
