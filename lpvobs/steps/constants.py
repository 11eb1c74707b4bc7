"""The engine's constants of a refined model: where a search starts from, and what comes of several refinements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpvobs.discovery.residual import MapPrior
from lpvobs.engines.effects import Plant
from lpvobs.io.results.refinements import StoredRefinement
from lpvobs.records import Log

LEAST_LEFT = 1.0 / 3.0
"""Of a constant's tolerance: what refinements may narrow it to. Their own interval is of a model linear around its optimum, with
noise less independent than it takes it for."""


@dataclass(frozen=True)
class Start:
    """What a search starts from.

    Attributes
    ----------
    plant : Plant
        With the constants of the model.
    prior : MapPrior
        The map as it is at these constants.
    tolerance : mapping of str to float
        Around them.
    constants : mapping of str to float
        Their relative deviation from the configured ones.
    of_map : mapping of str to float
        The same of those that the stored map was estimated with.
    """

    plant: Plant
    prior: MapPrior
    tolerance: Mapping[str, float]
    constants: Mapping[str, float]
    of_map: Mapping[str, float]

    def total(self, found: Mapping[str, float]) -> dict[str, float]:
        """Return deviations from this start as deviations from the configured constants."""
        return {name: (1.0 + self.constants.get(name, 0.0)) * (1.0 + b) - 1.0 for name, b in found.items()}


def start_of(
    plant: Plant, prior: MapPrior, tolerance: Mapping[str, float], refined: StoredRefinement | None, logs: Sequence[Log]
) -> Start:
    """Return where the search on logs starts.

    Logs that have not told of the effects of a refined model begin with its constants, and with what it left of their tolerance;
    on logs that have, all is estimated from the configured ones anew, so that nothing counts twice. Either way a map that stands is
    moved to these constants by its sensitivity to them.
    """
    if refined is None:
        return Start(plant, prior, tolerance, {}, {})
    if any(effect.took_part(logs) for effect in refined.effects):
        moved, left = dict.fromkeys(tolerance, 0.0), dict(tolerance)
    else:
        moved = {name: refined.constants.get(name, 0.0) for name in tolerance}
        left = {name: _left(width, refined.deviations.get(name)) for name, width in tolerance.items()}
    shift = np.array([moved[name] - refined.of_map.get(name, 0.0) for name in tolerance])
    if not prior.free:
        prior = replace(prior, mean=prior.mean + prior.sensitivity @ shift)
    values = {name: getattr(plant.constants, name) * (1.0 + b) for name, b in moved.items()}
    return Start(replace(plant, constants=plant.constants._replace(**values)), prior, left, moved, refined.of_map)


def _left(width: float, deviation: float | None) -> float:
    """Return what is left of a tolerance when the standard deviation is known to be so much, as if uniform."""
    return width if deviation is None else float(np.clip(np.sqrt(3.0) * deviation, LEAST_LEFT * width, width))
