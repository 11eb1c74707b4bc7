"""The effects of the contract that a throttled engine may have, each written from physics; no injection reads this."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lpvobs.engines.throttled.balances import Scene
from lpvobs.engines.throttled.constants import ThrottledEngine
from lpvobs.engines.throttled.relations import flow_function
from lpvobs.records import Array

SENSOR = "W_maf"
AIR_AT_CALIBRATION = 298.0
"""[K], at which a sensor whose gain depends on temperature reads right."""
PIVOT = 0.02
"""[kg/s], flow at which a contaminated film reads right."""
FILTER = 2.08e5
"""[Pa/(kg/s)^2], depression of the air filter over the squared flow."""
Change = Callable[[ThrottledEngine, Scene, float], Scene]


@dataclass(frozen=True)
class Effect:
    """An effect of one parameter.

    Attributes
    ----------
    id, parameter, unit : str
    null : float
        The parameter of an engine in order.
    sizes : tuple of float
        Where the search looks first, rising.
    needs : tuple of str
        Channels that it changes or depends on, which the log must have.
    undo : callable
        Takes the engine, a scene and the parameter; returns the scene as it would be without the effect.
    """

    id: str
    parameter: str
    unit: str
    null: float
    sizes: tuple[float, ...]
    needs: tuple[str, ...]
    undo: Change


def gain(channel: str) -> Change:
    """Return the correction of a channel that reads a multiple of the truth."""
    return lambda _, s, factor: s.corrected(channel, s.x[channel] / factor)


def offset(channel: str) -> Change:
    """Return the correction of a channel that reads too much by a constant; a positive quantity stays positive."""

    def undo(_: ThrottledEngine, s: Scene, shift: float) -> Scene:
        floor = 0.02 * float(np.max(np.abs(s.x[channel])))
        return s.corrected(channel, np.maximum(s.x[channel] - shift, floor))

    return undo


def opening(_: ThrottledEngine, s: Scene, shift: float) -> Scene:
    """Return the throttle's opening with its zero moved back."""
    return s.corrected("alpha_th", s.x["alpha_th"] - shift)


def lag(_: ThrottledEngine, s: Scene, tau: float) -> Scene:
    """Return the flow before a first-order response: tau dW_m/dt = W - W_m solved for W."""
    return s.corrected(SENSOR, s.x[SENSOR] + tau * np.gradient(s.x[SENSOR], s.time))


def delay(_: ThrottledEngine, s: Scene, dead_time: float) -> Scene:
    """Return the flow before a dead time: what the sensor says that much later."""
    return s.corrected(SENSOR, np.interp(s.time + dead_time, s.time, s.x[SENSOR]))


def drift(_: ThrottledEngine, s: Scene, rate: float) -> Scene:
    """Return the flow before a gain that moves with time."""
    return s.corrected(SENSOR, s.x[SENSOR] / (1.0 + rate * s.time))


def temperature(_: ThrottledEngine, s: Scene, coefficient: float) -> Scene:
    """Return the flow before a gain that follows the ambient temperature."""
    return s.corrected(SENSOR, s.x[SENSOR] / (1.0 + coefficient * (s.x["T_amb"] - AIR_AT_CALIBRATION)))


def contamination(_: ThrottledEngine, s: Scene, x: float) -> Scene:
    """Return the flow behind a film whose King's law lost a share x of its slope: sqrt W_m = (1 - x) sqrt W + x sqrt PIVOT."""
    root = np.sqrt(np.maximum(s.x[SENSOR], 0.0))
    return s.corrected(SENSOR, np.maximum((root - x * np.sqrt(PIVOT)) / (1.0 - x), 0.0) ** 2)


def inlet_leak(engine: ThrottledEngine, s: Scene, area: float) -> Scene:
    """Return the flow of sensor and hole behind the filter, whose depression grows with the squared flow."""
    density = s.x["p_amb"] / (engine.air.R_a * s.x["T_amb"])
    return s.corrected(SENSOR, s.x[SENSOR] * (1.0 + area * np.sqrt(2.0 * density * FILTER)))


def intake_leak(engine: ThrottledEngine, s: Scene, area: float) -> Scene:
    """Return the scene with air that an orifice draws into the manifold, or lets out where it is under boost."""
    p_amb, p_im, R, gamma = s.x["p_amb"], s.x["p_im"], engine.air.R_a, engine.air.gamma_a
    drawn = p_amb * flow_function(gamma, p_im / p_amb) / np.sqrt(R * s.x["T_amb"])
    lost = p_im * flow_function(gamma, p_amb / p_im) / np.sqrt(R * s.x["T_ic"])
    # In the last per cent before equal pressures the flow function is held; the flow changes its sign there without a jump.
    near = np.clip((p_amb - p_im) / (0.01 * p_amb), -1.0, 1.0)
    return replace(s, extra=s.extra + area * np.where(p_im < p_amb, drawn, lost) * near)


def filling(_: ThrottledEngine, s: Scene, factor: float) -> Scene:
    """Return the scene with cylinders that breathe differently."""
    return replace(s, filling=s.filling * factor)


def _around_one(low: float, high: float, step: float) -> tuple[float, ...]:
    """Return factors in equal relative steps, one among them."""
    down = np.arange(0.0, np.log(low) - 1e-9, -step)[::-1]
    return tuple(np.exp(np.concatenate([down, np.arange(step, np.log(high) + 1e-9, step)])).tolist())


def _around_zero(reach: float, steps: int) -> tuple[float, ...]:
    return tuple((reach * np.arange(-steps, steps + 1) / steps).tolist())


def _from_zero(reach: float, steps: int) -> tuple[float, ...]:
    """Return sizes that grow faster than linearly: small ones matter most."""
    share: Array = np.arange(steps + 1) / steps
    return tuple((reach * share**1.5).tolist())


FACTORS = _around_one(0.5, 1.8, 0.06)
CATALOGUE = (
    Effect("maf.gain", "factor", "1", 1.0, FACTORS, (SENSOR,), gain(SENSOR)),
    Effect("maf.offset", "offset", "kg/s", 0.0, _around_zero(0.01, 20), (SENSOR,), offset(SENSOR)),
    Effect("maf.lag", "tau", "s", 0.0, _from_zero(1.0, 8), (SENSOR,), lag),
    Effect("maf.delay", "delay", "s", 0.0, _from_zero(1.0, 8), (SENSOR,), delay),
    Effect("maf.drift", "rate", "1/s", 0.0, _around_zero(4e-4, 16), (SENSOR,), drift),
    Effect("maf.temperature", "coefficient", "1/K", 0.0, _around_zero(0.01, 6), (SENSOR, "T_amb"), temperature),
    Effect("maf.contamination", "coefficient", "1", 0.0, _around_zero(0.3, 12), (SENSOR,), contamination),
    Effect("leak.intake", "area", "m^2", 0.0, _from_zero(6e-5, 40), ("p_im", "p_amb", "T_amb", "T_ic"), intake_leak),
    Effect("leak.inlet", "area", "m^2", 0.0, _from_zero(1e-3, 20), ("p_amb", "T_amb"), inlet_leak),
    Effect("eta_vol.factor", "factor", "1", 1.0, FACTORS, ("p_im", "n_e"), filling),
    Effect("p_im.gain", "factor", "1", 1.0, FACTORS, ("p_im",), gain("p_im")),
    Effect("p_im.offset", "offset", "Pa", 0.0, _around_zero(3e4, 30), ("p_im",), offset("p_im")),
    Effect("p_ic.gain", "factor", "1", 1.0, FACTORS, ("p_ic",), gain("p_ic")),
    Effect("p_ic.offset", "offset", "Pa", 0.0, _around_zero(3e4, 30), ("p_ic",), offset("p_ic")),
    Effect("alpha_th.offset", "offset", "%", 0.0, _around_zero(4.0, 40), ("alpha_th",), opening),
    Effect("u_delta.gain", "factor", "1", 1.0, FACTORS, ("m_f",), gain("m_f")),
)
"""`u_delta.gain` is the gain of the fuel reading, here the channel m_f."""
