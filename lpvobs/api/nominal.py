"""A stored map that stands, and the engine that it goes with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpvobs.discovery.residual import MapPrior, nominal_map
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.errors import DataError
from lpvobs.io.results.engines import EngineOfMap
from lpvobs.io.results.results import StoredResult
from lpvobs.records import Array

LEAST_LEFT = 1.0 / 3.0
"""Share of a prior's standard deviation that an estimate or a refinement leaves at least. Their own interval is of a model that is
linear around its optimum, and of noise that is less independent than it assumes."""


@dataclass(frozen=True)
class Known:
    """The stored model before other logs are looked at."""

    prior: MapPrior
    # relative deviation from the configured value, of each unknown of the model that the map goes with
    constants: Mapping[str, float]
    covariance: Array  # (q, q) of all unknowns of the model, relative to where they are found


def known_from(stored: StoredResult, model: ResidualModel, prior_map: float) -> Known:
    """Return a stored map that stands, and the engine that it was estimated with.

    With S = cov(map, constants) cov(constants)^-1 the map is theta + S (beta - found) + error. Constants that are no unknowns
    of the model are as configured there, so everything is conditional on that. The others keep their covariance, and
    `LEAST_LEFT` of their tolerance on top of it. Where curves are learned, their nodes stand for their levels, and the map owes
    them nothing. Raises DataError if the method of the map does not tell of the engine.
    """
    found = stored.engine
    if found is None or found.constants != stored.constants or not np.isfinite(stored.covariance).all():
        raise DataError(
            f"{stored.path}: map of method '{stored.method}' has no covariance over the engine's constants, which a nominal map "
            f"needs; estimate it with the default method"
        )
    prior = nominal_map(stored.theta, stored.covariance, stored.sensitivity, found.covariance, prior_map)
    deviation, own, conditional = _of_model(found, model.names)
    moved = deviation - found.deviation
    covariance, S = model.covariance.copy(), np.zeros((prior.mean.size, len(model.names)))
    place = [model.names.index(found.constants[i]) for i in own]
    seen = np.where(np.array(place) < len(model.names) - model.adding, 1.0 + deviation[own], 1.0)
    relative = conditional / np.outer(seen, seen)
    covariance[np.ix_(place, place)] = relative + LEAST_LEFT**2 * model.covariance[np.ix_(place, place)]
    S[:, place] = prior.sensitivity[:, own]
    constants = {found.constants[i]: float(deviation[i]) for i in own}
    return Known(replace(prior, mean=prior.mean + prior.sensitivity @ moved, sensitivity=S), constants, covariance)


def _of_model(found: EngineOfMap, names: Sequence[str]) -> tuple[Array, list[int], Array]:
    """Return the deviations where constants that are none of `names` are as configured, which ones are, and their covariance."""
    own = [i for i, name in enumerate(found.constants) if name in names]
    others = [i for i, name in enumerate(found.constants) if name not in names]
    C = found.covariance
    answer = np.linalg.lstsq(C[np.ix_(others, others)], C[np.ix_(others, own)], rcond=None)[0].T
    deviation = found.deviation.copy()
    deviation[own] -= answer @ found.deviation[others]
    deviation[others] = 0.0
    return deviation, own, C[np.ix_(own, own)] - answer @ C[np.ix_(others, own)]
