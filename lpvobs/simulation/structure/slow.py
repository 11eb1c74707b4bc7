"""What is slow or follows the vehicle: walls, intercooler, thermocouple, hot film."""

from collections.abc import Mapping
from math import exp, log, sqrt

import numpy as np

from lpvobs.compiled import njit
from lpvobs.records import Array
from lpvobs.simulation.courses import lagged
from lpvobs.simulation.structure.amplitudes import Structure
from lpvobs.simulation.structure.pulses import ripple

WALL_LAG = 25.0  # s, ports and valves behind coolant and load
WALL_RISE = 3.0e-7  # K per W of fuel and m^3 of displacement: 50 K at full load
FAN = 3.0  # m/s, air through a standing car's intercooler
FREE = 20.0  # m/s, at which the configured effectiveness holds


def wall_temperature(period: float, coolant: Array, heat: Array) -> Array:
    """Return the temperature of the intake ports [K], shape (M,) every `period` seconds.

    It follows the coolant [K] and the fuel's heat per displacement [W/m^3] within half a minute (Heywood 1988, Sec. 12.7).
    """
    return coolant + lagged(WALL_RISE * heat, period, WALL_LAG)


@njit(cache=True)
def cooler_effectiveness(amplitude: float, configured: float, v_air: float, crowd: float) -> float:
    """Return the intercooler's effectiveness [-] at a vehicle's speed [m/s] and a flow per displacement [kg/(s m^3)].

    1 - exp(-NTU), NTU over the cooling air's speed to the power of one half and the charge's flow to that of -0.3 (Kays and
    London, Compact Heat Exchangers, 1984; Eriksson and Nielsen 2014, Ch. 7). Against a curve: the vehicle's speed.
    """
    units = -log(1.0 - min(configured, 0.99))
    flow = (min(max(crowd, 4.0), 80.0) / 20.0) ** -0.3
    found = 1.0 - exp(-units * sqrt((v_air + FAN) / (FREE + FAN)) * flow)
    return min(max(configured + amplitude * (found - configured), 0.1), 0.95)


def shown_late(
    structure: Structure, truth: Mapping[str, Array], shown: Mapping[str, Array], V_d: float, n_cyl: int, step: float
) -> dict[str, Array]:
    """Return what slow sensors show in place of fast ones, each of shape (M,) every `step` seconds.

    `truth` are the engine's signals, `shown` what fast sensors show of them; the displacement is in m^3.
    """
    late = {}
    if structure.thermocouple > 0.0:
        late["T_em"] = thermocouple(structure.thermocouple, shown["T_em"], truth["W_ei"] / V_d, step)
    if structure.maf_element > 0.0:
        pulsing = ripple(structure.maf_element, truth["n_e"], truth["u_delta"], n_cyl, step)
        late["W_maf"] = hot_film(structure.maf_element, shown["W_maf"], truth["W_c"] / V_d, pulsing, step)
    return late


def thermocouple(amplitude: float, T_em: Array, crowd: Array, step: float) -> Array:
    """Return what the thermocouple shows [K], shape (M,) every `step` seconds: late by 1 to 3 s, less at high flow.

    Its time constant goes with the inverse of the film coefficient, flow to the power of -0.5 (Benedict, Fundamentals of
    Temperature, Pressure, and Flow Measurements, 1984; data sheets of sheathed elements: 1 to 3 s). Against a fixed lag: the flow.
    """
    tau = amplitude * np.clip(2.0 * (20.0 / np.maximum(crowd, 1.0)) ** 0.5, 1.0, 3.0)
    return _followed(T_em, np.exp(-step / tau))


def hot_film(amplitude: float, W: Array, crowd: Array, ripple: Array, step: float) -> Array:
    """Return the reading of the air flow sensor [kg/s], shape (M,) every `step` seconds: late by 15 to 30 ms, and with ripple.

    The film cools as A + B W^0.5 (King, Phil. Trans. R. Soc. A 214, 1914), so it is faster at high flow; data sheets give 15 ms
    at rated flow (Bosch HFM 5). A fifth of the ripple gets through the averaging over a stroke.
    """
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
