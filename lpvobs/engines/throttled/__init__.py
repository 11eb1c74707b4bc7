"""A throttled spark-ignition engine with intercooler."""

from lpvobs.engines.base import EngineKind
from lpvobs.engines.throttled.constants import DayToDay, ThrottledEngine
from lpvobs.engines.throttled.lpv import Throttled
from lpvobs.engines.throttled.recorded import RECORDED

ENGINE = EngineKind(
    air_path=Throttled,
    tables={"engine": ThrottledEngine, "trace": DayToDay},
    recorded=RECORDED,
    example="liu-ice.toml",
)
