"""A diesel with EGR and VGT: the paper's engine."""

from functools import partial

from lpvobs.engines.base import EngineKind
from lpvobs.engines.channels import Below, Exchanged, Suspects, recorded
from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.engines.diesel.effects import diesel_model, pulsating
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.diesel.published import PUBLISHED, drive
from lpvobs.engines.residual_model import DayToDay

# On 24 simulated drives (three cycles, sea level to 2000 m, -5 to 35 degrees) p_em was below p_im for 9 % of the time at most, T_im
# 5 K below T_amb never; with the channels exchanged for 91 and 78 % at least. On a bench a cooler may hold T_im at T_amb.
SUSPECTS = Suspects(
    checks=(Below("p_em", "p_im", 0.5), Below("T_im", "T_amb", 0.5, slack=5.0, unit="K")),
    mix_ups=tuple(Exchanged(*pair.split()) for pair in ("p_im p_em", "p_im p_amb", "T_im T_amb", "u_egr u_vgt")),
)
ENGINE = EngineKind(
    air_path=Diesel,
    tables={"engine": DieselEngine, "trace": DayToDay},
    recorded=partial(recorded, "components", "diesel"),
    example="diesel.toml",
    residual_model=lambda config, path, _healthy, _taught, known: diesel_model(
        path.engine, config.estimate.tolerance, config.trace, known
    ),
    plant="nine states",
    published=PUBLISHED,
    known_drive=drive,
    suspects=SUSPECTS,
    pulsation=pulsating,
    in_c=lambda path: path.constants._asdict(),
)
