"""A vehicle that says no more than speed, intake manifold and air flow: the sensor against the filling, over speed and pressure.

Without fuel and EGR position the map holds the sensor's error less the EGR flow and what the filling is off: all confounded. Maps
of the same vehicle on different days differ by what has changed of the three.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from lpvobs.engines.base import SPEED_AXIS, Balances, EngineKind, MapAxis
from lpvobs.engines.channels import Channel, recorded
from lpvobs.engines.components import intake
from lpvobs.engines.residual_model import DayToDay
from lpvobs.engines.series.constants import SeriesEngine
from lpvobs.engines.series.lpv import RELATIVE_STEP, TOLERANCE, Series
from lpvobs.engines.unknowns import Component, Correction, MeasuredPart
from lpvobs.errors import DataError
from lpvobs.records import Array, Log


@dataclass(frozen=True)
class SpeedDensity(Series):
    """The air path, as if the EGR valve were shut."""

    name: ClassVar[str] = "speed_density"
    calmed: ClassVar[tuple[str, ...]] = ("p_im",)
    smoothed: ClassVar[tuple[str, ...]] = ("n_e", "p_im", "T_im")
    balance_names: ClassVar[tuple[str, ...]] = ("filling",)
    components: ClassVar[tuple[Component, ...]] = (*intake.SHAPE, intake.CHARGE)
    measured_parts: ClassVar[tuple[MeasuredPart, ...]] = ()
    usual_tolerance: ClassVar[Mapping[str, float]] = {
        name: TOLERANCE[name] for name in ("R_a", "V_d", "V_im", "c_vol1", "c_vol2", "c_vol3")
    }
    axes: ClassVar[tuple[MapAxis, MapAxis]] = (MapAxis("p_im", "Pa", "intake manifold pressure"), SPEED_AXIS)
    channels: ClassVar[Mapping[str, Channel]] = {
        "n_e": Series.channels["n_e"],
        "p_im": Channel("Pa", 2e4, 6e5, (6e4, 4e5), "intake manifold pressure", 120.0),
        "T_im": Channel("K", 200.0, 500.0, (230.0, 420.0), "intake manifold temperature", 300.0),
        "W_maf": Series.channels["W_maf"],
    }

    def returned(self, x: Mapping[str, Array], W_ei: Array) -> Array:
        """Return no EGR flow, shape (n,): nothing tells it."""
        return np.zeros(W_ei.size)

    def corrections(self, log: Log, rates: Mapping[str, Array]) -> tuple[Correction, ...]:
        """Return how the shape of the filling moves it."""
        x = log.channels
        W_ei = intake.cylinder_flow(self.constants, x["p_im"], x["n_e"], x["T_im"])
        shape = (Correction(0, W_ei, weights) for weights in intake.shape_weights(x))
        return (*shape, Correction(0, intake.per_charge(W_ei, x)))

    def balances(
        self, log: Log, rates: Mapping[str, Array], uncertain: Sequence[str], calm: Mapping[str, Array] | None = None
    ) -> Balances:
        """Return the flow into the cylinders and the manifold, and what it owes to each constant."""
        c = self.constants
        moved = [c, *(c._replace(**{name: getattr(c, name) * (1.0 + RELATIVE_STEP)}) for name in uncertain)]
        flow, *others = (_flow(each, log.channels, rates) for each in moved)
        slope = np.array([(other - flow) / RELATIVE_STEP for other in others]).reshape(1, len(uncertain), len(log))
        return Balances(self.balance_names, flow[None], slope)


def _flow(c: Any, x: Mapping[str, Array], rates: Mapping[str, Array]) -> Array:
    stored = c.V_im / (c.R_a * x["T_im"]) * (rates["p_im"] - x["p_im"] / x["T_im"] * rates["T_im"])
    return np.asarray(intake.cylinder_flow(c, x["p_im"], x["n_e"], x["T_im"]) + stored)  # Eq. (1)


def residual_model(*_: Any) -> Any:
    """Raise DataError: one balance whose EGR is unknown tells no fault from another."""
    raise DataError(
        "engine: engine speed, intake pressure and air flow alone cannot tell faults apart; also record fuel, and the EGR valve's "
        "position or lambda, and use configs/series.toml; or compare the maps of two days"
    )


OBD = EngineKind(
    air_path=SpeedDensity,
    tables={"engine": SeriesEngine, "trace": DayToDay},
    recorded=partial(recorded, "components", "series"),
    example="speed_density.toml",
    residual_model=residual_model,
    caveat="errors of EGR flow, filling and sensor are confounded in this map: compare it with the map of another day, but do not "
    "read it as the sensor's error; logging the EGR valve's position, lambda and fuel would separate them",
)
