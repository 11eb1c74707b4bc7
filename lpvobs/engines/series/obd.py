"""A vehicle that says no more than speed, intake manifold and air flow: the sensor against the filling, over speed and pressure.

Without fuel and EGR position the map holds the sensor's error less the EGR flow and what the filling is off: all confounded. Maps
of the same vehicle on different days differ by what has changed of the three.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from lpvobs.engines.base import SPEED_AXIS, EngineKind, MapAxis
from lpvobs.engines.channels import Channel, channels, recorded
from lpvobs.engines.components import intake
from lpvobs.engines.residual_model import DayToDay
from lpvobs.engines.series.constants import SeriesEngine
from lpvobs.engines.series.lpv import TOLERANCE, SeriesPath
from lpvobs.engines.unknowns import Correction
from lpvobs.errors import DataError
from lpvobs.records import Array, Log

USUAL = channels("components")


@dataclass(frozen=True)
class SpeedDensity(SeriesPath):
    """The air path, as if the EGR valve were shut."""

    name = "speed_density"
    calmed = ("p_im",)
    smoothed = ("n_e", "p_im", "T_im")
    balance_names = ("filling",)
    components = (*intake.SHAPE, intake.CHARGE)
    axes = (MapAxis("p_im", "Pa", "intake manifold pressure"), SPEED_AXIS)
    channels: ClassVar[Mapping[str, Channel]] = {name: USUAL[name] for name in ("n_e", "p_im", "T_im", "W_maf")}
    usual_tolerance: ClassVar[Mapping[str, float]] = {
        name: TOLERANCE[name] for name in ("R_a", "V_d", "V_im", "c_vol1", "c_vol2", "c_vol3")
    }

    def corrections(self, log: Log, rates: Mapping[str, Array]) -> tuple[Correction, ...]:
        """Return how the shape of the filling moves it."""
        x = log.channels
        W_ei = intake.cylinder_flow(self.constants, x["p_im"], x["n_e"], x["T_im"])
        shape = (Correction(0, W_ei, weights) for weights in intake.shape_weights(x))
        return (*shape, Correction(0, intake.per_charge(W_ei, x)))

    def flows(self, c: Any, x: Mapping[str, Array], rates: Mapping[str, Array]) -> Array:
        """Return the flow into the cylinders and the manifold, shape (1, n) [kg/s]."""
        stored = c.V_im / (c.R_a * x["T_im"]) * (rates["p_im"] - x["p_im"] / x["T_im"] * rates["T_im"])
        return np.stack([intake.cylinder_flow(c, x["p_im"], x["n_e"], x["T_im"]) + stored])  # Eq. (1)


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
