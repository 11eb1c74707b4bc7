"""What the sensors make of the truth: noise and rounding; of another structure also lags, pulses, rasters of a control unit."""

import zlib
from collections.abc import Mapping
from math import exp, expm1, log, sqrt
from typing import NamedTuple

import numpy as np
import scipy

from lpvobs.compiled import njit
from lpvobs.engines.channels import Sensor
from lpvobs.records import Array
from lpvobs.simulation.parameters import Sensors, Structure


class Quality(NamedTuple):
    """What is random and coarse about a sensor, in its channel's unit."""

    spread: float | Array  # () or (N,), standard deviation of white noise
    step: float  # to which it rounds


def measure(name: str, values: Array, sensors: Sensors, seed: int) -> Array:
    """Return the readings of a noise-free channel, shape (N,)."""
    spread: float | Array = getattr(sensors, name, 0.0)
    if name == "W_maf":
        spread = np.hypot(sensors.W_maf_absolute, sensors.W_maf_relative * np.abs(values))
    return read_with(name, values, Quality(spread, getattr(sensors.quantisation, name, 0.0)), seed)


def stream_of(seed: int, name: str) -> np.random.Generator:
    """Return the random numbers of one channel, constant or part of a road: one more of them changes no other."""
    return np.random.Generator(np.random.PCG64([seed, zlib.crc32(name.encode())]))


def read_with(name: str, values: Array, quality: Quality, seed: int) -> Array:
    """Return the readings of a sensor, shape (N,)."""
    noisy = values + quality.spread * stream_of(seed, name).standard_normal(values.size)
    return np.asarray(np.round(noisy / quality.step) * quality.step if quality.step > 0 else noisy)


def lagged(W: Array, step: float, tau: float) -> Array:
    """Return y of tau dy/dt = W - y, shape (M,), from rest: exact for a W that runs straight between its samples."""
    if W.size == 0:
        return W
    left, mean = exp(-step / tau), tau / step * -expm1(-step / tau)
    return np.asarray(scipy.signal.lfilter([1.0 - mean, mean - left], [1.0, -left], W, zi=[mean * W[0]])[0])


def pulses(amplitude: float, n_e: Array, u_delta: Array) -> Array:
    """Return the amplitude of the flow's pulses at the air flow sensor over the mean flow [-], shape (M,)."""
    # The inlet resonates near 1300 rpm, and load drives it (Heywood 1988, Sec. 7.6.2; Guzzella and Onder 2010, Ch. 2).
    resonance = 0.06 + 0.34 * np.exp(-(((n_e - 1300.0) / 350.0) ** 2))
    return np.asarray(amplitude * resonance * np.clip(0.3 + u_delta / 40.0, 0.3, 1.2))


def rectified(amplitude: float, n_e: Array, u_delta: Array) -> Array:
    """Return the mean error of a pulsating flow over the flow [-], shape (M,): King's root makes it read -m^2/8 for pulses of m."""
    return np.asarray(-(pulses(amplitude, n_e, u_delta) ** 2) / 8.0)


def ripple(amplitude: float, n_e: Array, u_delta: Array, n_cyl: int, step: float) -> Array:
    """Return the pulses themselves over the mean flow [-], shape (M,) every `step` seconds, in the phase of the crankshaft."""
    strokes = np.cumsum(n_e) * step * n_cyl / 120.0
    return np.asarray(pulses(amplitude, n_e, u_delta) * np.sin(2.0 * np.pi * strokes))


WALL_LAG = 25.0  # s, ports and valves behind coolant and load
WALL_RISE = 3.0e-7  # K per W of fuel and m^3 of displacement: 50 K at full load
FAN = 3.0  # m/s, air through a standing car's intercooler
FREE = 20.0  # m/s, at which the configured effectiveness holds


def wall_temperature(period: float, coolant: Array, heat: Array) -> Array:
    """Return the temperature of the intake ports [K], shape (M,) every `period` seconds."""
    # They follow coolant [K] and heat per displacement [W/m^3] within half a minute (Heywood 1988, Sec. 12.7).
    return coolant + lagged(WALL_RISE * heat, period, WALL_LAG)


@njit(cache=True)
def cooler_effectiveness(amplitude: float, configured: float, v_air: float, crowd: float) -> float:
    """Return the intercooler's effectiveness [-] at a vehicle's speed [m/s] and a flow per displacement [kg/(s m^3)]."""
    # 1 - exp(-NTU), NTU over the cooling air's speed to the power of one half and the charge's flow to that of -0.3 (Kays
    # and London, Compact Heat Exchangers, 1984; Eriksson and Nielsen 2014, Ch. 7). Against a curve: the vehicle's speed.
    units = -log(1.0 - min(configured, 0.99))
    flow = (min(max(crowd, 4.0), 80.0) / 20.0) ** -0.3
    found = 1.0 - exp(-units * sqrt((v_air + FAN) / (FREE + FAN)) * flow)
    return min(max(configured + amplitude * (found - configured), 0.1), 0.95)


def shown_late(
    structure: Structure, truth: Mapping[str, Array], shown: Mapping[str, Array], V_d: float, n_cyl: int, step: float
) -> dict[str, Array]:
    """Return what slow sensors show in place of fast ones, each of shape (M,) every `step` seconds."""
    # `truth` are the engine's signals, `shown` what fast sensors show of them; the displacement is in m^3.
    late = {}
    if structure.thermocouple > 0.0:
        late["T_em"] = thermocouple(structure.thermocouple, shown["T_em"], truth["W_ei"] / V_d, step)
    if structure.maf_element > 0.0:
        pulsing = ripple(structure.maf_element, truth["n_e"], truth["u_delta"], n_cyl, step)
        late["W_maf"] = hot_film(structure.maf_element, shown["W_maf"], truth["W_c"] / V_d, pulsing, step)
    return late


def thermocouple(amplitude: float, T_em: Array, crowd: Array, step: float) -> Array:
    """Return what the thermocouple shows [K], shape (M,) every `step` seconds: late by 1 to 3 s, less at high flow."""
    # Its time constant goes with the inverse of the film coefficient, flow to the power of -0.5 (Benedict, Fundamentals of
    # Temperature, Pressure, and Flow Measurements, 1984; data sheets of sheathed elements: 1 to 3 s). Against a fixed lag:
    # the flow.
    tau = amplitude * np.clip(2.0 * (20.0 / np.maximum(crowd, 1.0)) ** 0.5, 1.0, 3.0)
    return _followed(T_em, np.exp(-step / tau))


def hot_film(amplitude: float, W: Array, crowd: Array, ripple: Array, step: float) -> Array:
    """Return the reading of the air flow sensor [kg/s], shape (M,) every `step` seconds: late by 15 to 30 ms, and with ripple."""
    # The film cools as A + B W^0.5 (King, Phil. Trans. R. Soc. A 214, 1914), so it is faster at high flow; data sheets give
    # 15 ms at rated flow (Bosch HFM 5). A fifth of the ripple gets through the averaging over a stroke.
    tau = amplitude * np.clip(0.030 / (0.4 + 0.6 * np.sqrt(np.maximum(crowd, 0.0) / 10.0)), 0.015, 0.030)
    return _followed(W * (1.0 + 0.2 * ripple), np.exp(-step / tau))


@njit(cache=True)
def _followed(values: Array, left: Array) -> Array:
    """Return a first-order lag that keeps the share `left` of its distance at each step; from rest."""
    shown = np.empty(values.size)
    for k in range(values.size):
        before = shown[k - 1] if k else values[0]
        aim = 0.5 * (values[k] + values[k - 1]) if k else values[0]
        shown[k] = aim + left[k] * (before - aim)
    return shown


RECORDER = {
    "n_e": (0.0, 0.25), "u_delta": (0.0, 0.02), "p_im": (0.010, 100.0), "p_em": (0.020, 200.0), "omega_t": (0.020, 0.42),
    "T_im": (0.100, 0.5), "T_em": (0.100, 1.0), "W_maf": (0.010, 2.8e-5), "u_egr": (0.020, 0.39), "u_vgt": (0.020, 0.40),
}  # fmt: skip
"""[s] between two readings, and the step of the readings in the channel's unit.

Tasks as measurement lists of control units have them (ASAM MCD-1 XCP); speed and fuel, without one, change with each stroke
(Guzzella and Onder 2010, Ch. 3). Steps: rpm and valves as SAE J1979 writes them, turbocharger speed (4 rpm) and vanes as J1939-71,
the rest 1 hPa, half a degree, one degree, 0.1 kg/h.
"""
PHASE = 0.4  # of a raster, by which the recorder's clock is behind the control unit's


def record(
    amplitude: float,
    known: Mapping[str, Sensor],
    shown: Mapping[str, Array],
    n_cyl: int,
    fine: int,
    step: float,
    sensors: Sensors,
    seed: int,
) -> dict[str, Array]:
    """Return the readings at the samples, shape (N,), as a control unit hands them on.

    Rasters and steps have the same amplitude; those of known sensors are what is known of them. `shown` is what noise-free sensors
    show, shape (M,) every `step` seconds; every `fine`-th is a sample.
    """
    time = np.arange(shown["n_e"].size) * step
    stroke = np.floor(np.cumsum(shown["n_e"]) * step * n_cyl / 120.0 / amplitude) if amplitude else time
    rasters, steps = ({name: amplitude * each[i] for name, each in RECORDER.items()} for i in range(2))
    rasters |= {name: sensor.raster for name, sensor in known.items() if sensor.raster}
    steps |= {name: sensor.quantisation for name, sensor in known.items() if sensor.quantisation}
    readings = {}
    for name, values in shown.items():
        period = rasters.get(name, 0.0)
        tick = stroke if name in RECORDER else np.arange(time.size)
        tick = np.floor((time + PHASE * period) / period) if period else tick
        new = np.concatenate([[True], np.diff(tick) > 0])
        taken = np.maximum.accumulate(np.where(new, np.arange(time.size), 0))[::fine]
        moments, again = np.unique(taken, return_inverse=True)
        held = measure(name, values[moments], sensors, seed)[again]
        least = steps.get(name, 0.0)
        readings[name] = np.round(held / least) * least if least else held
    return readings
