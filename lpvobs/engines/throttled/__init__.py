"""A throttled spark-ignition engine with intercooler."""

from lpvobs.engines.base import EngineKind
from lpvobs.engines.residual_model import DayToDay
from lpvobs.engines.throttled.constants import ThrottledEngine
from lpvobs.engines.throttled.effects import residual_model
from lpvobs.engines.throttled.known import in_c
from lpvobs.engines.throttled.lpv import Throttled
from lpvobs.engines.throttled.recorded import RECORDED
from lpvobs.engines.throttled.suspects import SUSPECTS
from lpvobs.engines.throttled.taught import errors_of

ENGINE = EngineKind(
    air_path=Throttled,
    tables={"engine": ThrottledEngine, "trace": DayToDay},
    recorded=RECORDED,
    example="liu-ice.toml",
    residual_model=residual_model,
    errors=errors_of,
    suspects=SUSPECTS,
    in_c=lambda path: in_c(path.engine, path.learned),
)
