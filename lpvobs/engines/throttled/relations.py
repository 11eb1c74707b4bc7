"""Relations of a throttled engine's intake: throttle, cylinders, fuel, one per function, on whole channels.

Throttle and filling are the textbook's (Heywood, Internal Combustion Engine Fundamentals, Sec. 6.2 and 7.6). Curves come from a
healthy log.
"""

from collections.abc import Mapping

import numpy as np

from lpvobs.engines.curves import Weights, on_line, on_surface, values_at
from lpvobs.engines.throttled.constants import Learned, ThrottledEngine
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


def throttle_nodes(engine: ThrottledEngine, x: Channels) -> Weights:
    """Return the nodes behind the throttle's area."""
    return on_line(np.array(engine.curves.alpha_th), x["alpha_th"])


def filling_nodes(engine: ThrottledEngine, x: Channels) -> Weights:
    """Return the nodes behind the volumetric efficiency."""
    return on_surface(np.array(engine.curves.n_e), np.array(engine.curves.p_im), x["n_e"], x["p_im"])


def fuel_nodes(engine: ThrottledEngine, x: Channels) -> Weights:
    """Return the nodes behind the air per unit of fuel."""
    return on_surface(np.array(engine.curves.m_f), np.array(engine.curves.fuel_n_e), x["m_f"], x["n_e"])


# Of throttle, filling and fuel: the nodes of the curve, and the flow per unit of it.
CURVES = ((throttle_nodes, throttle_per_area), (filling_nodes, swept), (fuel_nodes, fuel_strokes))


def throttle_flow(engine: ThrottledEngine, learned: Learned, x: Channels) -> Array:
    """Return the flow through the throttle [kg/s]."""
    return values_at(throttle_nodes(engine, x), learned.area) * throttle_per_area(engine, x)


def cylinder_flow(engine: ThrottledEngine, learned: Learned, x: Channels) -> Array:
    """Return the flow into the cylinders from pressure and speed [kg/s]."""
    return values_at(filling_nodes(engine, x), learned.eta_vol) * swept(engine, x)


def fuelled_flow(engine: ThrottledEngine, learned: Learned, x: Channels) -> Array:
    """Return the flow into the cylinders from the fuel that burns with it [kg/s]."""
    return values_at(fuel_nodes(engine, x), learned.fuel) * fuel_strokes(engine, x)
