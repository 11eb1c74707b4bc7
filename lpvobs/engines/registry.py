"""The engines that exist, by the name that configurations, gains and results use."""

from lpvobs.engines import diesel, series, throttled
from lpvobs.engines.base import EngineKind

ENGINES: dict[str, EngineKind] = {
    kind.name: kind for kind in (diesel.ENGINE, throttled.ENGINE, series.ENGINE, series.OBD)
}


def usual_engine() -> EngineKind:
    """Return the kind that is meant where nothing says which: the first one, the paper's."""
    return next(iter(ENGINES.values()))
