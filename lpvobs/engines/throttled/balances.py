"""Four balances of a throttled engine over blocks of a log, with room for what the model lacks.

    throttle   ln (W - V_ic s_ic)                       - ln W_th(alpha, p_ic, p_im)
    filling    ln (W - V_ic s_ic - V_im s_im + W_leak)  - ln W_cyl(n, p_im)
    fuel       ln (W - V_ic s_ic - V_im s_im + W_leak)  - ln W_fuel(m_f, n)
    ambient    ln (p_ic / p_amb), where the flow is so small that neither compressor nor filter changes the pressure

with W the sensor's flow and s = dp/dt / (R T). Relative, because the errors of curves and sensors are.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.blocks import Blocks
from lpvobs.engines.curves import Knowledge
from lpvobs.engines.effects import SENSOR, Signals
from lpvobs.engines.throttled import relations as relation
from lpvobs.engines.throttled.constants import ThrottledEngine
from lpvobs.records import Array

BALANCES = ("throttle", "filling", "fuel", "ambient")
PARTS: Mapping[str, tuple[str, ...]] = {
    "flow": (SENSOR,),
    "before": ("p_ic", "T_ic"),
    "behind": ("p_im", "T_ic"),
    "throttle": ("alpha_th", "p_ic", "p_im", "T_ic"),
    "filling": ("p_im", "n_e", "T_ic"),
    "fuel": ("m_f", "n_e"),
    "ambient": ("p_ic", "p_amb"),
}
"""The parts of the balances with the channels of each: the sensor's flow, the stores around the throttle, the flows."""
NEEDS = {name: (*PARTS[name], SENSOR) for name in BALANCES}  # channels without which a balance cannot be drawn up
FLOWS = {part.name: part.flow for part in relation.PARTS}
LEAST_FLOW = 2e-4  # [kg/s] Smaller flows count as this, because zero has no logarithm
UNEQUAL = 0.01
"""Scatter of the pressure ratio within a block. Near a ratio of one the throttle's flow depends on it strongly."""
LACKS = {"leak_intake": 0.0, "eta_vol": 1.0, "throttle": 1.0}
"""Sizes of what the model may lack (a leak in m^2, factors on filling and throttle) on an engine in order."""
REMEMBERED = 4
"""Versions of a part that are kept: an effect changes few channels, and the other parts need no new computation."""


@dataclass(frozen=True)
class Imbalances:
    """Draws up the balances of logs again and again, and only those parts anew whose channels have changed."""

    engine: ThrottledEngine
    kept: dict[str, list[tuple[tuple[object, ...], Array]]] = field(default_factory=dict)

    def __call__(self, learned: Knowledge, s: Signals, blocks: Blocks | None) -> Array:
        """Return what is left of each balance, shape (4, K); zero where channels are missing."""
        blocks = needed(blocks)
        out = np.zeros((len(BALANCES), blocks.count))
        part = {name: self._part(name, learned, s, blocks) for name in PARTS if all(c in s.value for c in PARTS[name])}
        if "flow" not in part:
            return out
        before = part["flow"] - part.get("before", 0.0)
        into = before - part.get("behind", 0.0)
        leak, filling, throttle = s.lacks
        if leak.any():
            into = into + blocks.mean(leak * drawn_per_area(self.engine, s))
        flows = {"throttle": (before, throttle), "filling": (into, filling), "fuel": (into, np.ones(1))}
        for b, (name, (flow, factors)) in enumerate(flows.items()):
            if name in part:
                factor = 1.0 if np.all(factors == 1.0) else blocks.mean(factors)
                out[b] = _log(flow) - _log(factor * part[name])
        if "ambient" in part:
            out[3] = part["ambient"]
        return out

    def _part(self, name: str, learned: Knowledge, s: Signals, blocks: Blocks) -> Array:
        inputs = (learned, blocks, *(s.value[channel] for channel in PARTS[name]))
        kept = self.kept.setdefault(name, [])
        for known, value in kept:
            if all(a is b for a, b in zip(known, inputs, strict=True)):
                return value
        value = self._anew(name, learned, s, blocks)
        kept[:] = [(inputs, value), *kept[: REMEMBERED - 1]]
        return value

    def _anew(self, name: str, learned: Knowledge, s: Signals, blocks: Blocks) -> Array:
        if name in FLOWS:
            return blocks.mean(FLOWS[name](self.engine, learned, s.value))
        if name == "flow":
            return blocks.mean(s[SENSOR])
        if name == "ambient":
            return np.asarray(np.log(np.maximum(blocks.mean(s["p_ic"]), 1.0) / blocks.mean(s["p_amb"])))
        volume, channel = ("V_ic", "p_ic") if name == "before" else ("V_im", "p_im")
        return learned[volume] * blocks.rate(s[channel]) / (self.engine.air.R_a * blocks.mean(s["T_ic"]))


def by_reading(balances: Callable[..., Array], learned: Knowledge, s: Signals, blocks: Blocks | None) -> Array:
    """Return the derivative of the balances by the reading [s/kg], shape (4, K): a difference quotient."""
    step = LEAST_FLOW
    more = balances(learned, s.corrected(SENSOR, s[SENSOR] + step), blocks)
    return np.asarray((more - balances(learned, s, blocks)) / step)


def shown(learned: Knowledge, s: Signals, blocks: Blocks | None) -> NDArray[np.bool_]:
    """Return which balances the channels allow, and where they hold, shape (4, K)."""
    blocks = needed(blocks)
    there = np.array([all(channel in s.value for channel in NEEDS[name]) for name in BALANCES])
    counted = np.tile(there[:, None], (1, blocks.count))
    if there[3]:
        counted[3] &= blocks.mean(s[SENSOR]) < learned["calm_flow"]
    return counted


def by_curves(engine: ThrottledEngine, learned: Knowledge, s: Signals, blocks: Blocks | None) -> Array:
    """Return how the balances move with the relative deviation of every node of the curves, shape (m - 2, 4, K)."""
    blocks, where = needed(blocks), learned.places()
    out = np.zeros((len(learned.names), len(BALANCES), blocks.count))
    for b, part in enumerate(relation.PARTS):
        if all(channel in s.value for channel in NEEDS[part.name]):
            shares = part.columns(engine, s.value, blocks) * learned.curves[part.name].values.reshape(-1)
            out[where[part.name], b] = (-shares / np.maximum(shares.sum(1), LEAST_FLOW)[:, None]).T
    return out


def blur(balances: Callable[..., Array], learned: Knowledge, s: Signals, blocks: Blocks | None) -> Array:
    """Return the standard deviation that the scatter of the pressure ratio within a block gives each balance, shape (4, K)."""
    out = np.zeros((len(BALANCES), needed(blocks).count))
    if all(channel in s.value for channel in NEEDS["throttle"]):
        moved = balances(learned, s.corrected("p_im", (1.0 + UNEQUAL) * s["p_im"]), blocks)
        out[0] = np.abs(moved[0] - balances(learned, s, blocks)[0])
    return out


def drawn_per_area(engine: ThrottledEngine, s: Signals) -> Array:
    """Return the air that a leak of the manifold draws in per area [kg/(s m^2)], negative where it is under boost."""
    # In the last per cent before equal pressures the flow function is held; the flow changes its sign there without a jump.
    p_amb, p_im, R, gamma = s["p_amb"], s["p_im"], engine.air.R_a, engine.air.gamma_a
    drawn = p_amb * relation.flow_function(gamma, p_im / p_amb) / np.sqrt(R * s["T_amb"])
    lost = p_im * relation.flow_function(gamma, p_amb / p_im) / np.sqrt(R * s["T_ic"])
    near = np.clip((p_amb - p_im) / (0.01 * p_amb), -1.0, 1.0)
    return np.asarray(np.where(p_im < p_amb, drawn, lost) * near)


def further(engine: ThrottledEngine, learned: Knowledge, s: Signals) -> tuple[Array, Array]:
    """Return what the engine lacks adds to the flows of throttle, filling and fuel, (3, N) [kg/s], and to dx/dt, (3, N)."""
    leak, filling, throttle = s.lacks
    extra = leak * drawn_per_area(engine, s)
    less = (filling - 1.0) * relation.FILLING.flow(engine, learned, s.value)
    more = (throttle - 1.0) * relation.THROTTLE.flow(engine, learned, s.value)
    a_ic, a_im = (engine.air.R_a * s["T_ic"] / volume for volume in (learned["V_ic"], learned["V_im"]))
    inputs = -a_ic * more, a_im * (more + extra - less), np.zeros_like(extra)
    return np.stack([more, less - extra, -extra]), np.stack(inputs)


def needed(blocks: Blocks | None) -> Blocks:
    """Return the blocks, which a throttled engine cannot do without."""
    if blocks is None:
        raise ValueError("the balances of a throttled engine are drawn up over blocks")
    return blocks


def _log(flow: Array) -> Array:
    return np.asarray(np.log(np.maximum(flow, LEAST_FLOW)))
