"""An engine that logs what series vehicles do: a diesel without turbine speed and exhaust pressure."""

from functools import partial

from lpvobs.engines.base import EngineKind
from lpvobs.engines.channels import Below, Exchanged, Suspects, recorded
from lpvobs.engines.residual_model import DayToDay
from lpvobs.engines.series.constants import SeriesEngine
from lpvobs.engines.series.effects import residual_model
from lpvobs.engines.series.lpv import Series
from lpvobs.engines.series.obd import OBD

__all__ = ["ENGINE", "OBD"]

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
