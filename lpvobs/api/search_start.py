"""The engine's unknowns in a refined model: where a search starts from, and what comes of several refinements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpvobs.discovery.residual import MapPrior
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.io.results.refinements import StoredRefinement
from lpvobs.records import Log

LEAST_LEFT = 1.0 / 3.0
"""Share of a prior's standard deviation that refinements leave at least. Their own interval is of a model that is linear
around its optimum, and of noise that is less independent than it assumes."""


@dataclass(frozen=True)
class Start:
    """What a search starts from.

    Attributes
    ----------
    model : ResidualModel
        Around the constants or curves of the stored model.
    prior : MapPrior
        The map as it is there.
    constants : mapping of str to float
        Their relative deviation from the configured or learned ones.
    of_map : mapping of str to float
        The same of those that the stored map was estimated with.
    """

    model: ResidualModel
    prior: MapPrior
    constants: Mapping[str, float]
    of_map: Mapping[str, float]

    def total(self, found: Mapping[str, float]) -> dict[str, float]:
        """Return deviations from this start as deviations from the configured or learned values."""
        return {name: (1.0 + self.constants.get(name, 0.0)) * (1.0 + b) - 1.0 for name, b in found.items()}


def start_of(model: ResidualModel, prior: MapPrior, refined: StoredRefinement | None, logs: Sequence[Log]) -> Start:
    """Return where the search on logs starts.

    Logs that have not told of the effects of a refined model begin with its constants, and with what it left of their tolerance;
    on logs that have, all is estimated from the configured ones anew, so that nothing counts twice. Either way a map that stands is
    moved to these constants by its sensitivity to them.
    """
    if refined is None:
        return Start(model, prior, {}, {})
    moved: dict[str, float] = {}
    left: dict[str, float] = {}
    if not any(effect.took_part(logs) for effect in refined.effects):
        moved = {name: refined.constants.get(name, 0.0) for name in model.names}
        own = dict(zip(model.names, model.spread.tolist(), strict=True))
        left = {
            name: float(np.clip(refined.deviations.get(name, width), LEAST_LEFT * width, width))
            for name, width in own.items()
        }
    shift = np.array([moved.get(name, 0.0) - refined.of_map.get(name, 0.0) for name in model.names])
    if not prior.free:
        prior = replace(prior, mean=prior.mean + prior.sensitivity @ shift)
    return Start(model.restarted(moved, left), prior, moved, refined.of_map)
