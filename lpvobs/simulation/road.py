"""The surroundings of a real drive, and the channels that a recorder takes along with them.

Without it a drive takes place on a test bench: constant air, nothing but the engine. On the road the altitude changes and with it
pressure and temperature of the air, the intake soaks heat while the car stands, coolant warms up, the air conditioning switches on
and off. All of it follows from the seed. A slope changes the air but not the load: the cycle prescribes speed or torque.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, pi, sqrt
from typing import NamedTuple

import numpy as np

from lpvobs.records import Array
from lpvobs.simulation.instruments import Quality, read_with, stream_of
from lpvobs.simulation.vehicle import mean_over

GRID = 0.5  # s, of what changes slowly
GRAVITY = 9.81  # m/s^2
LAPSE = 6.5e-3  # K/m
STANDING = 0.5  # m/s
SOAK = 14.0  # K, by which the air in a standing car's intake ends up warmer
SOAK_RISE, SOAK_FALL = 90.0, 45.0  # s
HEAT_CAPACITY = 6.0e4  # J/K, coolant and what it wets
COOLANT_SHARE = 0.28  # of the fuel's heat
THERMOSTAT = (358.0, 366.0)  # K, begins to open, is open
RADIATOR, BLOCK = 600.0, 12.0  # W/K, radiator with open thermostat, and engine to air
AC_TORQUE = 8.0  # Nm, compressor of the air conditioning
AC_ON, AC_OFF = 22.0, 38.0  # s, typical
CHARGE_LAG = 3.0  # s, charge air cooler and thermometer

AUXILIARY = {
    "T_coolant": ("K", Quality(0.2, 1.0)),
    "T_charge": ("K", Quality(0.3, 0.5)),
    "humidity": ("%", Quality(0.3, 0.5)),
    "v_veh": ("km/h", Quality(0.0, 0.1)),  # counted at the wheels, and nothing to count at rest
    "ac_switch": ("1", Quality(0.0, 1.0)),
    "p_baro": ("Pa", Quality(30.0, 100.0)),
}
"""Unit and sensor of every channel beyond those that the engine needs."""
AMBIENT = {"p_amb": Quality(10.0, 10.0), "T_amb": Quality(0.05, 0.1)}
"""Sensors of the surroundings where these are not constant."""


@dataclass(frozen=True)
class Auxiliary:
    """A drive on the road, and which of `AUXILIARY` are logged; none: all of the cycle. Raises ValueError for others."""

    channels: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if strange := [name for name in self.channels if name not in AUXILIARY]:
            known = ", ".join(AUXILIARY)
            raise ValueError(f"channels: '{strange[0]}' is not an auxiliary channel; expected some of {known}")
        if len(set(self.channels)) < len(self.channels):
            raise ValueError(f"channels: {', '.join(self.channels)} lists a channel twice; name each channel once")


class Road(NamedTuple):
    """What happens around the engine, at every action of its control, shape (M,)."""

    p_amb: Array  # [Pa] of the air that the engine takes in
    T_amb: Array  # [K] of the same
    torque: Array  # [Nm] that the air conditioning takes from the crankshaft
    channels: Mapping[str, Array]  # true values of auxiliary channels, in the units of `AUXILIARY`


def road(period: float, p_0: float, T_0: float, speed: Array, measured: bool, heat: Array, seed: int) -> Road:
    """Return one road; it begins at the configured pressure [Pa], and at the configured temperature [K] but for heat soak.

    `speed` [m/s] of the vehicle is a likely one where the cycle has none; `measured` says whether there is one to be logged.
    `heat` [W] is that of the fuel; both have shape (M,), `period` seconds apart. Every part draws from a stream of its own.
    """
    time = np.linspace(0.0, (speed.size - 1) * period, speed.size)
    slow = np.arange(0.0, time[-1] + 2.0 * GRID, GRID)
    coarse_speed, coarse_heat = np.interp(slow, time, speed), np.interp(slow, time, mean_over(heat, GRID / period))
    height = altitude(np.cumsum(coarse_speed) * GRID, seed)
    air = T_0 + wander(slow.size, 1.5, 300.0, stream_of(seed, "road weather")) - LAPSE * height
    T_amb = air + heat_soak(coarse_speed, seed)
    p_amb = p_0 * np.exp(-GRAVITY * height / (287.0 * T_0))
    on = air_conditioning(time, np.interp(time, slow, air), seed)
    front = wander(slow.size, 8.0, 250.0, stream_of(seed, "road front"))
    damp = stream_of(seed, "road humidity").uniform(35.0, 75.0) + front
    coarse = {"T_coolant": coolant(coarse_heat, air, seed), "humidity": np.clip(damp, 5.0, 98.0), "p_baro": p_amb}
    channels = {name: np.interp(time, slow, values) for name, values in coarse.items()} | {"ac_switch": on}
    if measured:
        channels["v_veh"] = 3.6 * speed
    return Road(channels["p_baro"], np.interp(time, slow, T_amb), AC_TORQUE * on, channels)


def altitude(distance: Array, seed: int) -> Array:
    """Return the height over the start [m] after a distance [m]: three waves of hills, each up to 4 % steep."""
    stream = stream_of(seed, "road altitude")
    height = np.zeros(distance.size)
    for length in stream.uniform((1500.0, 3000.0, 6000.0), (3000.0, 6000.0, 12000.0)):
        steepness, phase = stream.uniform(0.01, 0.04), stream.uniform(0.0, 2.0 * pi)
        height += steepness * length / (2.0 * pi) * (np.sin(2.0 * pi * distance / length + phase) - np.sin(phase))
    return height


def wander(size: int, spread: float, memory: float, stream: np.random.Generator) -> Array:
    """Return a random course from zero, shape (size,) every `GRID` seconds, that forgets within `memory` seconds."""
    # Twice low-passed white noise, so that it bends but has no corners; `spread` is its standard deviation far from the
    # start.
    left = exp(-GRID / (0.5 * memory))
    # two equal poles: variance of the output per variance of white noise at the input is (1 - a)^4 (1 + a^2) / (1 - a^2)^3
    noise = spread * sqrt((1.0 - left**2) ** 3 / ((1.0 - left) ** 4 * (1.0 + left**2))) * stream.standard_normal(size)
    course, first, second = np.empty(size), 0.0, 0.0
    for k in range(size):
        course[k] = second
        first += (1.0 - left) * (noise[k] - first)
        second += (1.0 - left) * (first - second)
    return course


def heat_soak(speed: Array, seed: int) -> Array:
    """Return by how much the intake warms the air [K], shape (M,) every `GRID` seconds: much after standing, little under way."""
    warmer = stream_of(seed, "road soak").uniform(0.0, SOAK)
    course = np.empty(speed.size)
    for k in range(speed.size):
        course[k] = warmer
        target, memory = (SOAK, SOAK_RISE) if speed[k] < STANDING else (0.0, SOAK_FALL)
        warmer += GRID / memory * (target - warmer)
    return course


def coolant(heat: Array, air: Array, seed: int) -> Array:
    """Return the coolant's temperature [K], shape (M,) every `GRID` seconds: warm-up from a random start to the thermostat."""
    now = air[0] + stream_of(seed, "road coolant").uniform(0.0, 40.0)
    opens, is_open = THERMOSTAT
    course = np.empty(heat.size)
    for k in range(heat.size):
        course[k] = now
        opening = min(max((now - opens) / (is_open - opens), 0.0), 1.0)
        now += GRID / HEAT_CAPACITY * (COOLANT_SHARE * heat[k] - (BLOCK + RADIATOR * opening) * (now - air[k]))
    return course


def air_conditioning(time: Array, air: Array, seed: int) -> Array:
    """Return 1 where the compressor of the air conditioning runs, else 0, shape (M,): the evaporator's thermostat."""
    # The hotter it is outside, the longer it takes to cool down and the sooner it has to begin again.
    stream = stream_of(seed, "road air conditioning")
    on, moment = bool(stream.random() < 0.5), float(-stream.uniform(0.0, AC_ON))
    running = np.zeros(time.size)
    while moment < time[-1]:
        warmth = exp(0.03 * (float(np.interp(moment, time, air)) - 298.0))
        lasts = (AC_ON * warmth if on else AC_OFF / warmth) * float(stream.lognormal(0.0, 0.25))
        if on:
            running[(time >= moment) & (time < moment + lasts)] = 1.0
        on, moment = not on, moment + lasts
    return running


def measure_road(truth: Mapping[str, Array], logged: tuple[str, ...], seed: int) -> dict[str, Array]:
    """Return the readings of the surroundings' sensors and of the logged auxiliary channels, each of shape (N,)."""
    qualities = AMBIENT | {name: AUXILIARY[name][1] for name in logged}
    return {name: read_with(name, truth[name], quality, seed) for name, quality in qualities.items()}
