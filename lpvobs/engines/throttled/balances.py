"""Four balances of a throttled engine over blocks of a log, with room for what the model lacks.

    throttle       ln (W - V_ic s_ic)                       - ln W_th(alpha, p_ic, p_im)
    speed-density  ln (W - V_ic s_ic - V_im s_im + W_leak)  - ln W_cyl(n, p_im)
    fuel           ln (W - V_ic s_ic - V_im s_im + W_leak)  - ln W_fuel(m_f, n)
    ambient        ln (p_ic / p_amb), where the flow is so small that neither compressor nor filter changes the pressure

with W the sensor's flow and s = dp/dt / (R T). Relative, because the errors of curves and sensors are.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.throttled import relations as relation
from lpvobs.engines.throttled.blocks import Blocks
from lpvobs.engines.throttled.constants import Learned, ThrottledEngine
from lpvobs.records import Array, Log

BALANCES = ("throttle", "speed-density", "fuel", "ambient")
NEEDS: Mapping[str, tuple[str, ...]] = {
    "throttle": ("W_maf", "alpha_th", "p_ic", "p_im", "T_ic"),
    "speed-density": ("W_maf", "p_im", "n_e", "T_ic"),
    "fuel": ("W_maf", "m_f", "n_e"),
    "ambient": ("p_ic", "p_amb", "W_maf"),
}
"""Channels without which a balance cannot be drawn up."""
LEAST_FLOW = 2e-4
"""[kg/s]; smaller flows count as this, a logarithm knows no zero."""
CALM = 0.15
"""Share of the largest flow of the healthy log below which the air before the throttle is at ambient pressure."""


@dataclass(frozen=True)
class Scene:
    """The signals of a log as an effect, undone, would have left them, and what the engine lacks.

    Attributes
    ----------
    time : ndarray, shape (N,)
        [s] since the start of the log.
    x : mapping of str to ndarray, shape (N,)
        Channels.
    extra : ndarray, shape (N,)
        [kg/s], air that enters the manifold past throttle and sensor.
    filling : float
        Factor on the volumetric efficiency.
    """

    time: Array
    x: Mapping[str, Array]
    extra: Array
    filling: float = 1.0

    def corrected(self, channel: str, values: Array) -> "Scene":
        """Return the scene with other values of a channel."""
        return replace(self, x={**self.x, channel: values})


def scene_of(log: Log) -> Scene:
    """Return the signals as recorded."""
    return Scene(log.time - log.time[0], log.channels, np.zeros(len(log)))


def present(log: Log) -> NDArray[np.bool_]:
    """Return which balances the channels of a log allow, shape (4,)."""
    return np.array([all(name in log.channels for name in NEEDS[balance]) for balance in BALANCES])


class Balancer:
    """Draws up the balances of one log again and again, and only those parts anew whose channels have changed.

    Parameters
    ----------
    engine : ThrottledEngine
    learned : Learned
    blocks : Blocks
    scene : Scene
        As recorded.
    """

    def __init__(self, engine: ThrottledEngine, learned: Learned, blocks: Blocks, scene: Scene) -> None:
        self._engine, self._learned, self._blocks, self._as_recorded = engine, learned, blocks, scene
        self._own = {name: self._part(name, scene) for name in PARTS if self._known(name)}

    def __call__(self, scene: Scene) -> Array:
        """Return what is left of each balance, shape (blocks, 4); zero where channels are missing."""
        out = np.zeros((self._blocks.count, len(BALANCES)))
        part = {name: self._now(name, scene) for name in self._own}
        if "flow" not in part:
            return out
        none = np.zeros(self._blocks.count)
        before = part["flow"] - part.get("before", none)
        extra = self._blocks.mean(scene.extra) if scene.extra.any() else none
        into = before - part.get("behind", none) + extra
        if "throttle" in part:
            out[:, 0] = _log(before) - _log(part["throttle"])
        if "speed-density" in part:
            out[:, 1] = _log(into) - _log(scene.filling * part["speed-density"])
        if "fuel" in part:
            out[:, 2] = _log(into) - _log(part["fuel"])
        if "ambient" in part:
            out[:, 3] = part["ambient"]
        return out

    def _known(self, name: str) -> bool:
        return all(channel in self._as_recorded.x for channel in PARTS[name])

    def _now(self, name: str, scene: Scene) -> Array:
        same = all(scene.x[channel] is self._as_recorded.x[channel] for channel in PARTS[name])
        return self._own[name] if same else self._part(name, scene)

    def _part(self, name: str, scene: Scene) -> Array:
        engine, learned, blocks, x = self._engine, self._learned, self._blocks, scene.x
        if name in FLOWS:
            return blocks.mean(FLOWS[name](engine, learned, x))
        if name == "flow":
            return blocks.mean(x["W_maf"])
        if name == "ambient":
            return np.asarray(np.log(np.maximum(blocks.mean(x["p_ic"]), 1.0) / blocks.mean(x["p_amb"])))
        volume, channel = (learned.V_ic, "p_ic") if name == "before" else (learned.V_im, "p_im")
        return volume * blocks.rate(x[channel]) / (engine.air.R_a * blocks.mean(x["T_ic"]))


PARTS: Mapping[str, tuple[str, ...]] = {
    "flow": ("W_maf",),
    "before": ("p_ic", "T_ic"),
    "behind": ("p_im", "T_ic"),
    "throttle": ("alpha_th", "p_ic", "p_im", "T_ic"),
    "speed-density": ("p_im", "n_e", "T_ic"),
    "fuel": ("m_f", "n_e"),
    "ambient": ("p_ic", "p_amb"),
}
"""Of what the balances consist, and the channels of each part: the sensor, the stores before and behind the throttle, ..."""
FLOWS = {
    "throttle": relation.throttle_flow,
    "speed-density": relation.cylinder_flow,
    "fuel": relation.fuelled_flow,
}


def imbalances(engine: ThrottledEngine, learned: Learned, blocks: Blocks, scene: Scene) -> Array:
    """Return what is left of each balance, shape (blocks, 4); zero where channels are missing."""
    return Balancer(engine, learned, blocks, scene)(scene)


def curve_columns(engine: ThrottledEngine, learned: Learned, blocks: Blocks, scene: Scene) -> Array:
    """Return how the first three balances move with each relative deviation of the curves, shape (3, blocks, m); volumes apart."""
    x, where = scene.x, learned.deviations()
    out = np.zeros((3, blocks.count, where["volumes"].start))
    parts = (
        ("throttle", "throttle", relation.throttle_nodes, relation.throttle_per_area, learned.area),
        ("speed-density", "filling", relation.filling_nodes, relation.swept, learned.eta_vol),
        ("fuel", "fuel", relation.fuel_nodes, relation.fuel_strokes, learned.fuel),
    )
    for b, (balance, curve, nodes, per, values) in enumerate(parts):
        if _has(x, balance):
            shares = blocks.sums(nodes(engine, x), values.size, per(engine, x)) * values.reshape(-1)
            out[b][:, where[curve]] = -shares / np.maximum(shares.sum(1), LEAST_FLOW)[:, None]
    return out


def _has(x: Mapping[str, Array], balance: str) -> bool:
    return all(name in x for name in NEEDS[balance])


def _log(flow: Array) -> Array:
    return np.asarray(np.log(np.maximum(flow, LEAST_FLOW)))
