"""A diesel with EGR and VGT: the paper's engine."""

from lpvobs.engines.base import EngineKind
from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.engines.diesel.effects import pulsating, residual_model
from lpvobs.engines.diesel.known_drive import drive
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.engines.diesel.recorded import RECORDED
from lpvobs.engines.diesel.suspects import SUSPECTS
from lpvobs.engines.residual_model import DayToDay

ENGINE = EngineKind(
    air_path=Diesel,
    tables={"engine": DieselEngine, "trace": DayToDay},
    recorded=RECORDED,
    example="diesel.toml",
    residual_model=residual_model,
    plant="nine states",
    published=PUBLISHED,
    known_drive=drive,
    suspects=SUSPECTS,
    pulsation=pulsating,
    in_c=lambda path: path.constants._asdict(),
)
