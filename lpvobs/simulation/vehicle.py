"""A car and its driver: from a speed cycle to engine speed and fuel, and the torque in between that test benches think in, too.

The driver follows the cycle's speed with some delay, asks the engine for the force that is missing, and shifts on thresholds: at
2000 to 2800 rpm upward in normal driving, but never into a gear that needs more than most of the pedal, and downward when the
engine runs slow or the pedal is at its limit. Fuel is cut while shifting and in overrun.
"""

from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.engines.constants import flat, flat_type, names_of
from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.records import Array
from lpvobs.simulation.cycles import SpeedCycle
from lpvobs.simulation.parameters import SimulationParameters, Vehicle


class Work(NamedTuple):
    """Work per cycle of the whole engine: what a mg/cycle of fuel gives, and losses, a parabola over n_e [rpm]."""

    per_fuel: float  # J/(mg/cycle)
    loss_0: float  # J
    loss_1: float  # J/rpm
    loss_2: float  # J/rpm^2


def work_of(engine: DieselEngine, parameters: SimulationParameters) -> Work:
    """Return the engine's work balance, with gas exchange against the p_em - p_im that the vanes hold."""
    fire, V_d = parameters.combustion, engine.geometry.V_d
    f_0, f_1, f_2 = fire.friction_bar
    dp_0, dp_1 = parameters.setpoints.delta_p
    ideal = 1.0 - fire.compression_ratio ** (1.0 - fire.gamma_cyl)
    per_fuel = 1e-6 * engine.geometry.n_cyl * fire.q_HV * fire.eta_ig * ideal
    return Work(per_fuel, V_d * (1e5 * f_2 + dp_0), V_d * (1e5 * f_1 / 1e3 + dp_1), V_d * 1e5 * f_0 / 1e6)


@njit(cache=True)
def torque(work: Work, n_e: float, u_delta: float) -> float:
    """Return the torque at the crankshaft [Nm]; negative when the engine brakes."""
    return (work.per_fuel * u_delta - work.loss_0 - work.loss_1 * n_e - work.loss_2 * n_e * n_e) / (4.0 * pi)


@njit(cache=True)
def fuel(work: Work, n_e: float, wanted: float) -> float:
    """Return the fuel [mg/cycle] for a torque [Nm]; zero where the engine brakes that much by itself."""
    losses = work.loss_0 + work.loss_1 * n_e + work.loss_2 * n_e * n_e
    return max(0.0, (4.0 * pi * wanted + losses) / work.per_fuel)


@njit(cache=True)
def interpolate(x: Array, y: Array, at: float) -> float:
    """Return y at one point of a rising x, held outside."""
    i = min(max(int(np.searchsorted(x, at)) - 1, 0), x.size - 2)
    share = min(max((at - x[i]) / (x[i + 1] - x[i]), 0.0), 1.0)
    return (1.0 - share) * y[i] + share * y[i + 1]


SMOOTHING = 0.8  # s, width of each of two moving averages over the cycle's straight pieces
CLUTCH_TIME = 0.1  # s, engine speed behind that of the gearbox
IDLE_BAND = 150.0  # rpm above idle speed, over which the idle governor fades out
STANDSTILL = 0.3  # m/s
RPM = 60.0 / (2.0 * pi)


class Car(flat_type([*names_of(Vehicle), "ratio", "road_0", "road_2"])):  # type: ignore[misc]
    """The vehicle's constants as the compiled functions read them.

    `ratio` is the engine speed [rad/s] per vehicle speed [m/s], a value per gear; road load is road_0 [N] + road_2 [N/(m/s)^2] v^2.
    """


class Moment(NamedTuple):
    """Vehicle and driver at one instant; gears count from zero."""

    speed: float  # m/s
    n_e: float  # rpm
    u_delta: float  # mg/cycle
    gear: int
    since_shift: float  # s
    engaged: bool


def drive_speed_cycle(vehicle: Vehicle, work: Work, cycle: SpeedCycle, raster: float) -> tuple[Array, Array, Array]:
    """Return n_e [rpm], u_delta [mg/cycle] before the smoke limit, speed [m/s], each (M,), every `raster` seconds."""
    time = np.arange(round(cycle.time[-1] / raster) + 1) * raster
    wanted = smooth(np.interp(time, cycle.time, cycle.speed), SMOOTHING / raster)
    acceleration = np.gradient(wanted, raster)
    delay = round(vehicle.reaction_time / raster)
    foreseen = np.concatenate([np.full(delay, acceleration[0]), acceleration])[: time.size]
    row = np.searchsorted(cycle.time, time + 1e-9, side="right") - 1
    gear = np.where(cycle.gear < 0, -1, np.clip(cycle.gear - 1, 0, len(vehicle.gears) - 1))
    ratio = tuple(gear * vehicle.final_drive / vehicle.wheel_radius for gear in vehicle.gears)
    road_0 = vehicle.road_constant + vehicle.rolling_resistance * vehicle.mass * 9.81
    car = flat(Car, vehicle, ratio=ratio, road_0=road_0, road_2=vehicle.road_quadratic * 3.6**2)
    return _follow(car, work, raster, wanted, foreseen, gear[row], cycle.engaged[row])


def smooth(values: Array, width: float) -> Array:
    """Return values, shape (M,), after two centred moving averages of about `width` samples; the ends are held."""
    odd = 2 * (int(width) // 2) + 1
    return mean_over(mean_over(values, odd), odd)


def mean_over(values: Array, width: float) -> Array:
    """Return a moving average over about `width` samples, the same shape; the ends are held."""
    size = max(1, round(width))
    padded = np.pad(values, (size // 2, size - 1 - size // 2), mode="edge")
    return np.convolve(padded, np.full(size, 1.0 / size), "valid")


@njit(cache=True)
def _follow(
    car: Car, work: Work, dt: float, wanted: Array, foreseen: Array, gear: NDArray[np.int64], engaged: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """Return n_e, u_delta and speed along a wanted speed; a gear of -1 leaves the choice to the driver."""
    n_e, u_delta, speed = np.empty(wanted.size), np.empty(wanted.size), np.empty(wanted.size)
    now = Moment(wanted[0], car.idle_speed, fuel(work, car.idle_speed, car.accessory_torque), 0, 10.0, False)
    for k in range(wanted.size):
        n_e[k], u_delta[k], speed[k] = now.n_e, now.u_delta, now.speed
        missing = car.speed_gain * (wanted[k] - now.speed)
        force = car.mass * (foreseen[k] + missing) + road_load(car, now.speed)
        chosen, since, closed = shifted(car, work, now, force, wanted[k], gear[k], engaged[k])
        now = moved(car, work, Moment(now.speed, now.n_e, now.u_delta, chosen, since, closed), force, dt)
    return n_e, u_delta, speed


@njit(cache=True)
def road_load(car: Car, speed: float) -> float:
    """Return rolling and air resistance [N]."""
    return car.road_0 + car.road_2 * speed * speed


@njit(cache=True)
def fuel_in_gear(car: Car, work: Work, speed: float, force: float, gear: int) -> float:
    """Return the fuel [mg/cycle] for a force [N] at the wheels."""
    n_e = max(car.ratio[gear] * speed * RPM, car.idle_speed)
    return fuel(work, n_e, force / (car.ratio[gear] * car.efficiency) + car.accessory_torque)


@njit(cache=True)
def shifted(
    car: Car, work: Work, now: Moment, force: float, wanted: float, gear: int, engaged: bool
) -> tuple[int, float, bool]:
    """Return gear, time since the shift [s], and whether the clutch transmits, as the driver, or the table, wants them."""
    if gear >= 0:
        since = now.since_shift if gear == now.gear else 0.0
        stalling = force <= 0.0 and car.ratio[gear] * now.speed * RPM < car.idle_speed
        return gear, since, engaged and not stalling and since >= car.shift_time
    gear = now.gear
    standing = wanted < STANDSTILL and now.speed < STANDSTILL
    stalling = force <= 0.0 and car.ratio[gear] * now.speed * RPM < 1.1 * car.idle_speed
    if standing or stalling:
        return gear_for(car, now.speed), 10.0, False
    if now.since_shift < car.shift_time:
        return gear, now.since_shift, False
    chosen = choose_gear(car, work, now, force)
    if chosen != gear:
        return chosen, 0.0, False
    return gear, now.since_shift, True


@njit(cache=True)
def gear_for(car: Car, speed: float) -> int:
    """Return the highest gear in which the engine would not run slow."""
    gear = 0
    while gear + 1 < car.ratio.size and car.ratio[gear + 1] * speed * RPM > 1.1 * car.shift_down_below:
        gear += 1
    return gear


@njit(cache=True)
def choose_gear(car: Car, work: Work, now: Moment, force: float) -> int:
    """Return the gear that the driver wants next, at most one away."""
    gear = now.gear
    n_e = car.ratio[gear] * now.speed * RPM
    top = car.ratio.size - 1
    if n_e > car.shift_up_always and gear < top:
        return gear + 1
    if now.since_shift < car.shift_dwell:
        return gear
    pedal = fuel_in_gear(car, work, now.speed, force, gear) / interpolate(car.pedal_n_e, car.pedal_u_delta, n_e)
    if gear > 0 and (n_e < car.shift_down_below or pedal > 1.0):
        fits = car.ratio[gear - 1] * now.speed * RPM < 0.97 * car.shift_up_always
        return gear - 1 if fits else gear
    light, full = car.shift_up_light, car.shift_up_full
    if gear < top and force > 0.0 and n_e > light + (full - light) * min(pedal, 1.0):
        after = car.ratio[gear + 1] * now.speed * RPM
        limit = interpolate(car.pedal_n_e, car.pedal_u_delta, after)
        needed = fuel_in_gear(car, work, now.speed, force, gear + 1) / limit
        if after > 1.05 * car.shift_down_below and needed < car.shift_reserve:
            return gear + 1
    return gear


@njit(cache=True)
def moved(car: Car, work: Work, now: Moment, force: float, dt: float) -> Moment:
    """Return the moment after a time step: pedal, engine speed, and the car under drive, brakes and road."""
    ratio = car.ratio[now.gear]
    fading = min(max(1.0 - (now.n_e - car.idle_speed) / IDLE_BAND, 0.0), 1.0)
    governed = fuel(work, car.idle_speed, car.accessory_torque) * fading
    asked, target = governed, car.idle_speed
    if now.engaged:
        limit = interpolate(car.pedal_n_e, car.pedal_u_delta, now.n_e)
        asked = max(governed, min(fuel(work, now.n_e, force / (ratio * car.efficiency) + car.accessory_torque), limit))
        launching = min(max(asked / 15.0, 0.0), 1.0) if force > 0.0 and now.gear == 0 else 0.0
        target = max(ratio * now.speed * RPM, car.idle_speed + (car.launch_speed - car.idle_speed) * launching)
    elif now.since_shift < car.shift_time:
        target = max(ratio * now.speed * RPM, car.idle_speed)
    u_delta = now.u_delta + dt / car.pedal_time * (asked - now.u_delta)
    n_e = now.n_e + dt / CLUTCH_TIME * (target - now.n_e)
    drive = (torque(work, n_e, u_delta) - car.accessory_torque) * ratio * car.efficiency if now.engaged else 0.0
    if force < 0.0:
        drive = min(drive, force)  # the brakes give what the engine does not
    speed = max(0.0, now.speed + dt / car.mass * (drive - road_load(car, now.speed)))
    return Moment(speed, n_e, u_delta, now.gear, now.since_shift + dt, now.engaged)
