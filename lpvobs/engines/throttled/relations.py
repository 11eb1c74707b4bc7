"""Relations of a throttled engine's intake: throttle, cylinders, fuel, one per function, on whole channels.

Throttle and filling are the textbook's (Heywood, Internal Combustion Engine Fundamentals, Sec. 6.2 and 7.6). Curves come from a
healthy log.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import prod

import numpy as np

from lpvobs.engines.blocks import Blocks
from lpvobs.engines.curves import Knowledge, LearnedCurve, Nodes, Weights, on_line, on_surface, values_at
from lpvobs.engines.throttled.constants import ThrottledEngine
from lpvobs.records import Array

NEARLY_EQUAL = 0.999  # pressure ratio at which the flow function is held: its slope is infinite at one
Channels = Mapping[str, Array]


def flow_function(gamma: float, ratio: Array) -> Array:
    """Return Psi(Pi) of a compressible orifice, choked below the critical ratio."""
    critical = (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0))
    ratio = np.clip(ratio, critical, NEARLY_EQUAL)
    inside = ratio ** (2.0 / gamma) - ratio ** ((gamma + 1.0) / gamma)
    return np.asarray(np.sqrt(2.0 * gamma / (gamma - 1.0) * inside))


def throttle_per_area(engine: ThrottledEngine, x: Channels) -> Array:
    """Return the flow through the throttle over its effective area, p_ic Psi(p_im / p_ic) / sqrt(R T_ic) [kg/(s m^2)]."""
    psi = flow_function(engine.air.gamma_a, x["p_im"] / x["p_ic"])
    return np.asarray(x["p_ic"] * psi / np.sqrt(engine.air.R_a * x["T_ic"]))


def swept(engine: ThrottledEngine, x: Channels) -> Array:
    """Return the flow into cylinders that fill wholly, p_im n V_d / (120 R T_ic) [kg/s]."""
    # The temperature before the throttle stands for that in the manifold; heat picked up on the way is part of eta_vol.
    return np.asarray(x["p_im"] * x["n_e"] * engine.geometry.V_d / (120.0 * engine.air.R_a * x["T_ic"]))


def fuel_strokes(engine: ThrottledEngine, x: Channels) -> Array:
    """Return the fuel reading per second: reading per stroke times strokes per second."""
    return np.asarray(x["m_f"] * x["n_e"] * engine.geometry.n_cyl / 120.0)


AXES = {
    "alpha_th": ("%", "throttle opening"),
    "n_e": ("rpm", "engine speed"),
    "p_im": ("Pa", "intake manifold pressure"),
    "m_f": ("1", "fuel reading per stroke"),
}
"""Unit and meaning of the curves' inputs."""


@dataclass(frozen=True)
class LearnedPart:
    """A part of the engine whose flow is a learned curve times a flow per unit of the curve."""

    name: str
    said: tuple[str, str, str]  # name, unit and meaning of the curve's values
    axes: Mapping[str, str]  # channels that are its inputs, each with the key of `[engine.curves]` that has its nodes
    per: Callable[[ThrottledEngine, Channels], Array]  # the flow per unit of the curve, shape (n,)

    def nodes(self, engine: ThrottledEngine) -> list[Array]:
        """Return the nodes along each axis."""
        return [np.array(getattr(engine.curves, key)) for key in self.axes.values()]

    def shape(self, engine: ThrottledEngine) -> tuple[int, ...]:
        """Return how many nodes there are along each axis."""
        return tuple(each.size for each in self.nodes(engine))

    def weights(self, engine: ThrottledEngine, x: Channels) -> Weights:
        """Return the nodes behind the curve's values."""
        nodes, inputs = self.nodes(engine), [x[name] for name in self.axes]
        return on_line(*nodes, *inputs) if len(nodes) == 1 else on_surface(*nodes, *inputs)

    def flow(self, engine: ThrottledEngine, learned: Knowledge, x: Channels) -> Array:
        """Return the flow [kg/s], shape (n,)."""
        return values_at(self.weights(engine, x), learned.curves[self.name].values) * self.per(engine, x)

    def columns(self, engine: ThrottledEngine, x: Channels, blocks: Blocks) -> Array:
        """Return the mean flow over each of B blocks per value of the curve at each node, shape (B, nodes)."""
        return blocks.sums(self.weights(engine, x), prod(self.shape(engine)), self.per(engine, x))

    def curve(self, engine: ThrottledEngine, values: Array, spread: Array) -> LearnedCurve:
        """Return the curve with these values at its nodes and their relative standard errors, each of shape (nodes,)."""
        shape, nodes = self.shape(engine), self.nodes(engine)
        axes = {name: Nodes(each, *AXES[name]) for name, each in zip(self.axes, nodes, strict=True)}
        return LearnedCurve(axes, *self.said, values.reshape(shape), spread.reshape(shape))


THROTTLE = LearnedPart("throttle", ("area", "m^2", "effective area"), {"alpha_th": "alpha_th"}, throttle_per_area)
FILLING = LearnedPart("filling", ("eta_vol", "1", "volumetric efficiency"), {"n_e": "n_e", "p_im": "p_im"}, swept)
FUEL = LearnedPart(
    "fuel",
    ("air", "kg", "air in a cylinder per unit of the fuel reading"),
    {"m_f": "m_f", "n_e": "fuel_n_e"},
    fuel_strokes,
)
PARTS = (THROTTLE, FILLING, FUEL)
"""What is learned, in order: flow through the throttle, into the cylinders from pressure and speed, and from the fuel there."""
