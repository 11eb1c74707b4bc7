"""What engines with an intake manifold and exhaust gas recirculation share as the loop sees them: effects, and what is found."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvobs.engines.base import MapAxis
from lpvobs.engines.effects import (
    ALTITUDE,
    BOOST,
    FILTER,
    SENSOR,
    Change,
    Effect,
    Signals,
    fuel_gain,
    gain,
    lacking,
    offset,
    on_the_reading,
)
from lpvobs.engines.unknowns import LoopUnknowns
from lpvobs.records import Array

FUEL_AXIS = MapAxis("u_delta", "mg/cycle", "injected fuel per cylinder and cycle")
EGR = "the same operating points, once with the EGR valve open and once with it shut"


@dataclass(frozen=True, eq=False)
class AsFound:
    """An engine's constants, and the values of its corrections; none where nothing is known beyond the configuration."""

    constants: Any
    values: Array


def found_around(constants: Any, point: LoopUnknowns) -> Callable[[Array], AsFound]:
    """Return what gives the engine from deviations of its unknowns, shape (q,): constants, then modes of the corrections."""
    names = point.names[: len(point.names) - point.modes.shape[1]]

    def found(beta: Array) -> AsFound:
        shares = zip(names, beta[: len(names)].tolist(), strict=True)
        moved = {name: getattr(constants, name) * (1.0 + share) for name, share in shares}
        values = point.values + point.modes @ beta[len(names) :] if point.values.size else point.values
        return AsFound(constants._replace(**moved), values)

    return found


def temperature_lag(s: Signals, tau: float) -> Signals:
    """Return the temperature before a slow sensor; its rate is read through a wide window."""
    return s.corrected("T_im", s["T_im"] + tau * s.slow("T_im"))


def lacks(in_order: Mapping[str, float], name: str) -> Change:
    """Return the engine that lacks something by its name, given the sizes of all in order."""
    return lacking(list(in_order).index(name), in_order[name])


def on_the_intake(in_order: Mapping[str, float], unfilled: Callable[[AsFound, Signals], Array]) -> Mapping[str, Effect]:
    """Return by name the effects on readings, intake and EGR; `unfilled` is what the balance of the filling leaves.

    `in_order` are sizes of what the engine's model lacks, `leak_intake`, `egr_leak` [m^2], `egr_area` and `eta_vol` among them.
    """

    def bypass(s: Signals, area: float) -> Signals:
        """Return the flow before a hole that draws air in behind the filter, whose depression grows with the squared flow."""
        # The hole takes a fixed share of what passes the sensor, whatever the sensor's own error: of the filling's flow.
        share = area * np.sqrt(2.0 * s["p_amb"] / (s.constants.constants.R_a * s["T_amb"]) * FILTER)
        filling = s[SENSOR] - unfilled(s.constants, s)
        return s.corrected(SENSOR, s[SENSOR] + share / (1.0 + share) * np.maximum(filling, 0.0))

    found = (
        Effect("leak.inlet", "area", "m^2", 0.0, 3e-5, -3e-5, 5e-4, "sensor", bypass, ALTITUDE, True),
        fuel_gain("u_delta.gain", "u_delta"),
        Effect("p_im.offset", "offset", "Pa", 0.0, 1e3, -2e4, 2e4, "p_im", offset("p_im"), BOOST),
        Effect("p_im.gain", "factor", "1", 1.0, 0.01, 0.7, 1.3, "p_im", gain("p_im"), BOOST),
        Effect("T_im.lag", "tau", "s", 0.0, 3.0, -0.3, 20.0, "T_im", temperature_lag, EGR),
        Effect("leak.intake", "area", "m^2", 0.0, 5e-6, -2e-6, 2e-4, "intake", lacks(in_order, "leak_intake"), BOOST),
        Effect("egr.leak", "area", "m^2", 0.0, 3e-6, -1e-6, 1e-4, "EGR", lacks(in_order, "egr_leak"), EGR, needs=("u_egr",)),
        Effect("egr.area", "factor", "1", 1.0, 0.1, 0.2, 1.5, "EGR", lacks(in_order, "egr_area"), EGR, needs=("u_egr",)),
        Effect("eta_vol.factor", "factor", "1", 1.0, 0.03, 0.6, 1.3, "cylinders", lacks(in_order, "eta_vol"), EGR),
    )  # fmt: skip
    return {**on_the_reading(), **{effect.id: effect for effect in found}}
