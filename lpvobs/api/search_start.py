"""Where a search starts: the map and the engine as the stored model has them, and what comes of several refinements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lpvobs.api.nominal import LEAST_LEFT, Known
from lpvobs.discovery.residual import MapPrior
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.engines.unknowns import Unknowns
from lpvobs.io.results.refinements import StoredRefinement
from lpvobs.records import Array, Log


@dataclass(frozen=True)
class Start:
    """What a search starts from."""

    model: ResidualModel  # around the constants or curves of the stored model
    prior: MapPrior  # the map as it is there
    # their relative deviation from the configured or learned ones
    constants: Mapping[str, float] = field(default_factory=dict)

    def total(self, found: Mapping[str, float]) -> dict[str, float]:
        """Return deviations from this start as deviations from the configured or learned values."""
        names = self.model.names
        own, further = (np.array([values.get(name, 0.0) for name in names]) for values in (self.constants, found))
        return dict(zip(names, self.model.both(own, further).tolist(), strict=True))


def free_start(
    model: ResidualModel,
    prior: MapPrior,
    refined: StoredRefinement | None,
    logs: Sequence[Log],
    calibrated: Unknowns | None = None,
) -> Start:
    """Return where the search on logs starts that make the map anew.

    Logs that have not told of the effects of a refined model begin with its constants, and with what it left of their tolerance;
    on logs that have, all is estimated from the configured or calibrated ones anew, so that nothing counts twice.
    """
    if refined is None or any(effect.took_part(logs) for effect in refined.effects):
        if calibrated is None:
            return Start(model, prior)
        found = calibrated.deviation()
        return Start(model.restarted(found, model.covariance), prior, found)
    moved, covariance = _refined_constants(model, refined)
    return Start(model.restarted(moved, covariance), prior, moved)


def nominal_start(model: ResidualModel, known: Known, refined: StoredRefinement | None, logs: Sequence[Log]) -> Start:
    """Return where the search starts on logs that are judged by a map that stands: at the constants that it was estimated with.

    Logs that have not told of the effects of a refined model begin with its constants, and the map is moved there by its
    sensitivity to them.
    """
    if refined is None or any(effect.took_part(logs) for effect in refined.effects):
        return Start(model.restarted(known.constants, known.covariance), known.prior, known.constants)
    moved, covariance = _refined_constants(model, refined)
    shift = np.array([moved[name] - known.constants.get(name, 0.0) for name in model.names])
    prior = replace(known.prior, mean=known.prior.mean + known.prior.sensitivity @ shift)
    return Start(model.restarted(moved, covariance), prior, moved)


def _refined_constants(model: ResidualModel, refined: StoredRefinement) -> tuple[dict[str, float], Array]:
    """Return deviations of the constants of a refined model, and what it left of their covariance."""
    widths = dict(zip(model.names, model.spread.tolist(), strict=True))
    left = [np.clip(refined.deviations.get(name, width), LEAST_LEFT * width, width) for name, width in widths.items()]
    share = np.array(left) / model.spread
    return {name: refined.constants.get(name, 0.0) for name in model.names}, model.covariance * np.outer(share, share)
