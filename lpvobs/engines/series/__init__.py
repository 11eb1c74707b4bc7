"""Engines that log what series vehicles do: a diesel without turbine speed and exhaust pressure, and one that says still less."""

from functools import partial

from lpvobs.engines.base import EngineKind
from lpvobs.engines.channels import Below, Exchanged, Suspects, recorded
from lpvobs.engines.residual_model import DayToDay
from lpvobs.engines.series.constants import SeriesEngine
from lpvobs.engines.series.effects import confounded, residual_model
from lpvobs.engines.series.lpv import Series, SpeedDensity

ENGINE = EngineKind(
    air_path=Series,
    tables={"engine": SeriesEngine, "trace": DayToDay},
    recorded=partial(recorded, "components", "series"),
    example="series.toml",
    residual_model=residual_model,
    suspects=Suspects(
        checks=(Below("T_im", "T_amb", 0.5, slack=5.0, unit="K"),),
        mix_ups=(Exchanged("p_im", "p_amb"), Exchanged("T_im", "T_amb")),
    ),
)
OBD = EngineKind(
    air_path=SpeedDensity,
    tables=ENGINE.tables,
    recorded=ENGINE.recorded,
    example="speed_density.toml",
    residual_model=confounded,
    caveat="errors of EGR flow, filling and sensor are confounded in this map: compare it with the map of another day, but do not "
    "read it as the sensor's error; logging the EGR valve's position, lambda and fuel would separate them",
)
