"""The engines that exist, by the name that configurations, gains and results use."""

from lpvobs.engines import diesel, series, throttled
from lpvobs.engines.base import EngineKind

ENGINES: dict[str, EngineKind] = {
    diesel.ENGINE.name: diesel.ENGINE,
    throttled.ENGINE.name: throttled.ENGINE,
    series.ENGINE.name: series.ENGINE,
    series.OBD.name: series.OBD,
}


def usual_engine() -> EngineKind:
    """Return the kind that is meant where nothing says which: the first one, the paper's."""
    return next(iter(ENGINES.values()))
