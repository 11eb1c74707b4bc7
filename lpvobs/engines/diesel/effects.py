"""The effects of the contract that a diesel with EGR and VGT may have, each written from physics; no injection reads this."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lpvobs.engines.diesel.balances import BALANCES, CHANNELS, IN_ORDER, Lacks, imbalances, known_inputs
from lpvobs.engines.diesel.constants import DieselEngine, constants_of
from lpvobs.engines.effects import Effect, Plant, Scene
from lpvobs.records import Array

SENSOR = "W_maf"
AIR_AT_CALIBRATION = 298.0
"""[K], air temperature at which a sensor whose gain depends on temperature reads right."""
PIVOT = 0.02
"""[kg/s], flow at which a contaminated film reads right: too much below, too little above."""
FILTER = 2.08e5
"""[Pa/(kg/s)^2], depression of the air filter over the squared flow: 3 kPa at 0.12 kg/s."""
PULSATION_SPEED = 2000.0
"""[rpm] above which the flow at the sensor no longer pulsates backward."""
PULSATION_FUEL = 40.0
"""[mg/cycle], full load at low speed."""
LITTLE = 1e-3
"""[kg/s], flow below which the other effects on a reading are not told from its noise."""
Factor = Callable[[Scene, float], Array]
Change = Callable[[Scene, float], Scene]


def gain(channel: str) -> Change:
    """Return the correction of a channel that reads a multiple of the truth."""
    return lambda s, factor: s.corrected(channel, s[channel] / factor, s.rate_of(channel) / factor)


def offset(channel: str) -> Change:
    """Return the correction of a channel that reads too much by a constant."""
    return lambda s, shift: s.corrected(channel, s[channel] - shift)


def lacking(name: str) -> Change:
    """Return the engine with an area added, or a flow or power multiplied."""
    i = Lacks._fields.index(name)

    def change(s: Scene, x: float) -> Scene:
        lacks = s.lacks.copy()
        lacks[i] = lacks[i] + x if IN_ORDER[i] == 0.0 else lacks[i] * x
        return replace(s, lacks=lacks)

    return change


def reading(over_truth: Factor) -> Change:
    """Return the correction of a sensor whose reading over the truth is known."""
    return lambda s, x: s.corrected(SENSOR, s[SENSOR] / over_truth(s, x))


def lag(s: Scene, tau: float) -> Scene:
    """Return the flow before a first-order response: tau dW_m/dt = W - W_m solved for W."""
    return s.corrected(SENSOR, s[SENSOR] + tau * s.rate_of(SENSOR))


def delay(s: Scene, dead_time: float) -> Scene:
    """Return the flow before a dead time: what the sensor says that much later, behind other effects on its reading."""
    now = s.later(0.0)
    other = np.where(np.abs(now) > LITTLE, np.clip(s[SENSOR] / np.where(now == 0.0, 1.0, now), 0.5, 2.0), 1.0)
    return s.corrected(SENSOR, s[SENSOR] + other * (s.later(dead_time) - now))


def temperature_lag(s: Scene, tau: float) -> Scene:
    """Return the temperature before a slow sensor; its rate is read through a wide window."""
    return s.corrected("T_im", s["T_im"] + tau * s.slow("T_im"))


def contamination(s: Scene, x: float) -> Scene:
    """Return the flow behind a film whose King's law has lost a share x of its slope: sqrt W_m = (1 - x) sqrt W + x sqrt PIVOT."""
    above = np.sqrt(np.maximum(s[SENSOR], 0.0)) - x * np.sqrt(PIVOT)
    backward = np.minimum(
        s[SENSOR] - x * x * PIVOT, 0.0
    )  # no film tells which way the air goes: the curve goes on straight
    return s.corrected(SENSOR, np.where(above > 0.0, above**2, backward) / (1.0 - x) ** 2)


def bypass(s: Scene, area: float) -> Scene:
    """Return the flow before a hole that draws air in behind the filter, whose depression grows with the square of its flow.

    The hole takes a fixed share of what passes the sensor, whatever the sensor's own error: the flow is that of the filling.
    """
    share = area * np.sqrt(2.0 * s["p_amb"] / (s.constants.R_a * s["T_amb"]) * FILTER)
    filling = s[SENSOR] - imbalances(s.constants, s.value, s.rate, s.lacks)[1]
    return s.corrected(SENSOR, s[SENSOR] + share / (1.0 + share) * np.maximum(filling, 0.0))


def pulsating(s: Scene, x: float) -> Array:
    """Return reading over truth where the flow pulsates backward: x at 1000 rpm and full load."""
    slow = np.clip((PULSATION_SPEED - s["n_e"]) / 1000.0, 0.0, None)
    return np.asarray(1.0 + x * slow * np.maximum(s["u_delta"], 0.0) / PULSATION_FUEL)


TRANSIENTS = "fast changes of load at constant speed"
STEADY = "long stays at many operating points, before and after"
BOOST = "the same operating points at low and at high boost"
EGR = "the same operating points with the EGR valve open and shut"
ALTITUDE = "drives at other ambient pressures or temperatures"


CATALOGUE = (
    Effect("maf.delay", "delay", "s", 0.0, 0.03, -0.1, 0.5, "sensor", delay, TRANSIENTS),
    Effect("maf.lag", "tau", "s", 0.0, 0.03, -0.02, 0.5, "sensor", lag, TRANSIENTS),
    Effect("maf.offset", "offset", "kg/s", 0.0, 1e-3, -0.02, 0.02, "sensor", offset(SENSOR), STEADY, True),
    Effect(
        "maf.gain", "factor", "1", 1.0, 0.05, 0.4, 2.0, "sensor",
        reading(lambda s, x: np.broadcast_to(x, s.time.shape)), STEADY, True,
    ),
    Effect("maf.drift", "rate", "1/s", 0.0, 1e-4, -1e-3, 1e-3, "sensor", reading(lambda s, x: 1.0 + x * s.time), STEADY),
    Effect(
        "maf.temperature", "coefficient", "1/K", 0.0, 1e-3, -0.02, 0.02, "sensor",
        reading(lambda s, x: 1.0 + x * (s["T_amb"] - AIR_AT_CALIBRATION)), ALTITUDE,
    ),
    Effect("maf.backflow", "coefficient", "1", 0.0, 0.05, -0.2, 1.0, "sensor", reading(pulsating), STEADY, True),
    Effect("maf.contamination", "coefficient", "1", 0.0, 0.05, -0.5, 0.5, "sensor", contamination, EGR),
    Effect("leak.inlet", "area", "m^2", 0.0, 3e-5, -3e-5, 5e-4, "sensor", bypass, ALTITUDE, True),
    Effect("u_delta.gain", "factor", "1", 1.0, 0.05, 0.6, 1.5, "fuel", gain("u_delta"), STEADY, True, True),
    Effect("p_im.offset", "offset", "Pa", 0.0, 1e3, -2e4, 2e4, "p_im", offset("p_im"), BOOST),
    Effect("p_im.gain", "factor", "1", 1.0, 0.01, 0.7, 1.3, "p_im", gain("p_im"), BOOST),
    Effect("p_em.gain", "factor", "1", 1.0, 0.01, 0.7, 1.3, "p_em", gain("p_em"), EGR),
    Effect("omega_t.gain", "factor", "1", 1.0, 0.005, 0.8, 1.2, "omega_t", gain("omega_t"), BOOST),
    Effect("T_im.lag", "tau", "s", 0.0, 3.0, -0.3, 20.0, "T_im", temperature_lag, EGR),
    Effect("leak.intake", "area", "m^2", 0.0, 5e-6, -2e-6, 2e-4, "intake", lacking("leak_intake"), BOOST),
    Effect("egr.leak", "area", "m^2", 0.0, 3e-6, -1e-6, 1e-4, "EGR", lacking("egr_leak"), EGR),
    Effect("egr.area", "factor", "1", 1.0, 0.1, 0.2, 1.5, "EGR", lacking("egr_area"), EGR),
    Effect("eta_vol.factor", "factor", "1", 1.0, 0.03, 0.6, 1.3, "cylinders", lacking("eta_vol"), EGR),
    Effect("compressor.flow", "factor", "1", 1.0, 0.03, 0.6, 1.3, "compressor", lacking("compressor"), BOOST),
    Effect("turbine.efficiency", "factor", "1", 1.0, 0.03, 0.5, 1.5, "turbine", lacking("turbine"), BOOST),
    Effect("exhaust.restriction", "factor", "1", 1.0, 0.5, 0.3, 10.0, "exhaust", lacking("exhaust"), BOOST),
)  # fmt: skip
"""In the order in which effects are undone: what came last on its way into the log comes first."""


def diesel_plant(engine: DieselEngine) -> Plant:
    """Return the diesel as discovery sees it."""
    return Plant(
        balances=BALANCES,
        mapped=np.array([1.0, 1.0, 0.0, 0.0]),
        channels=CHANNELS,
        hurried=("n_e", "u_delta", "u_egr", "u_vgt", "p_im", "p_em", "omega_t", "T_im", "T_em"),
        sensor=SENSOR,
        fuel="u_delta",
        speed="n_e",
        lacks=tuple(IN_ORDER),
        constants=constants_of(engine),
        imbalances=imbalances,
        catalogue=CATALOGUE,
        carriers=("maf.gain", "maf.offset", "eta_vol.factor", "egr.area", "compressor.flow"),
        inputs=known_inputs,
    )
