"""A throttled spark-ignition engine with intercooler."""

from functools import partial

from lpvobs.engines.base import EngineKind
from lpvobs.engines.channels import Below, Exchanged, Suspects, recorded
from lpvobs.engines.residual_model import DayToDay
from lpvobs.engines.throttled.constants import ThrottledEngine
from lpvobs.engines.throttled.effects import residual_model
from lpvobs.engines.throttled.learning import errors_of
from lpvobs.engines.throttled.lpv import Throttled, in_c

# The intercooler of the LiU-ICE bench holds T_ic within 2 K of T_amb, mostly below it: two thermometers, not two temperatures.
SUSPECTS = Suspects(
    checks=(Below("p_ic", "p_im", 0.5), Below("T_ic", "T_amb", 0.5, slack=5.0, unit="K")),
    mix_ups=tuple(Exchanged(*pair) for pair in (("p_ic", "p_im"), ("p_ic", "p_amb"), ("T_ic", "T_amb"))),
)
ENGINE = EngineKind(
    air_path=Throttled,
    tables={"engine": ThrottledEngine, "trace": DayToDay},
    recorded=partial(recorded, "throttled"),
    example="liu-ice.toml",
    residual_model=residual_model,
    errors=errors_of,
    suspects=SUSPECTS,
    in_c=in_c,
)
