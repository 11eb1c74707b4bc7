"""Where a search starts: map and engine as the stored model has them, a map that stands or not, or what refinements have left.

What the drives that made a map show of the engine beside it is learned when the map is estimated.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lpvobs.api.known_engine import known_engine
from lpvobs.discovery.healthy_drive import HealthyDrive
from lpvobs.discovery.healthy_learning import learned
from lpvobs.discovery.map_prior import MapPrior, free_map, nominal_map
from lpvobs.discovery.thresholds import HEALTHY_LEAST, HEALTHY_SECONDS, LEAST_LEFT
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.engines.unknowns import LeftAtNodes, Unknowns
from lpvobs.errors import DataError
from lpvobs.io.logs.reading import read_log
from lpvobs.io.results.engines import EngineOfMap
from lpvobs.io.results.mapping import write
from lpvobs.io.results.refinements import StoredRefinement
from lpvobs.io.results.results import StoredResult, read_result, update
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Log


@dataclass(frozen=True)
class Start:
    """What a search starts from: a model around the constants or curves of the stored one, and the map as it is there."""

    model: ResidualModel
    prior: MapPrior
    # relative deviation from the configured or learned value, of each unknown that the map goes with; none: all as configured
    constants: Mapping[str, float]

    def total(self, found: Mapping[str, float]) -> dict[str, float]:
        """Return deviations from this start as deviations from the configured or learned values."""
        names = self.model.names
        own, further = (np.array([values.get(name, 0.0) for name in names]) for values in (self.constants, found))
        return dict(zip(names, self.model.both(own, further).tolist(), strict=True))


def known_from(
    stored: StoredResult, model: ResidualModel, prior_map: float, calibrated: Unknowns | None = None
) -> Start:
    """Return a stored map that stands, and the engine that it was estimated with.

    With S = cov(map, constants) cov(constants)^-1 the map is theta + S (beta - found) + error. Constants that are no unknowns
    of the model are as configured there, so everything is conditional on that. The others keep their covariance, and
    `LEAST_LEFT` of their tolerance on top of it. Where curves are learned, their nodes stand for their levels, and the map owes
    them nothing. Raises DataError if the method of the map does not tell of the engine.
    """
    found = stored.engine
    if found is None or found.constants != stored.constants or not np.isfinite(stored.covariance).all():
        raise DataError(
            f"{stored.path}: a map can only be kept if its covariance with the engine's constants is stored, but the method "
            f"'{stored.method}' stores none; run `lpvobs estimate` with the default method"
        )
    left = None if calibrated is None else calibrated.at_nodes
    # What is not known of what was left at the nodes is an error of the change alone: the balances show both together.
    covariance = stored.covariance if left is None else stored.covariance - left.covariance
    prior = nominal_map(stored.theta, covariance, stored.sensitivity, found.covariance, prior_map)
    if calibrated is not None and left is not None:
        prior = _with_left(prior, found, calibrated, left)
    deviation, own, conditional = _of_model(found, model.names)
    moved = deviation - found.deviation
    covariance, S = model.covariance.copy(), np.zeros((prior.mean.size, len(model.names)))
    place = [model.names.index(found.constants[i]) for i in own]
    seen = np.where(np.array(place) < len(model.names) - model.adding, 1.0 + deviation[own], 1.0)
    relative = conditional / np.outer(seen, seen)
    covariance[np.ix_(place, place)] = relative + LEAST_LEFT**2 * model.covariance[np.ix_(place, place)]
    S[:, place] = prior.sensitivity[:, own]
    constants = {found.constants[i]: float(deviation[i]) for i in own}
    there = replace(prior.beside(moved), sensitivity=S)
    return _started(model, there, constants, covariance)


def nothing_known(model: ResidualModel, grid: Grid, prior_map: float, calibrated: Unknowns | None = None) -> Start:
    """Return what is known where the logs make the map anew, of an engine as it is configured or calibrated."""
    free = free_map(grid, len(model.names), prior_map)
    return _started(model, free, {} if calibrated is None else calibrated.deviation(), model.covariance)


def _started(model: ResidualModel, prior: MapPrior, constants: Mapping[str, float], covariance: Array) -> Start:
    """Return a start at these constants, with the covariance (q, q) of all unknowns of the model relative to them."""
    return Start(model.restarted(constants, covariance) if constants else model, prior, constants)


def _with_left(prior: MapPrior, found: EngineOfMap, calibrated: Unknowns, left: LeftAtNodes) -> MapPrior:
    """Return a map of changes as what the balances leave in all: with what they left when the air flow was known."""
    moved, n = found.deviation.copy(), len(calibrated.constants)
    moved[:n] = (1.0 + moved[:n]) / (1.0 + calibrated.mean[:n]) - 1.0
    response = left.response @ calibrated.reduction
    mean = prior.mean + left.mean + response @ moved
    return replace(prior, mean=mean, sensitivity=prior.sensitivity + response)


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


def search_start(model: ResidualModel, known: Start, refined: StoredRefinement | None, logs: Sequence[Log]) -> Start:
    """Return where the search on logs starts: at the constants that the stored model of effects was estimated with.

    Logs that have not told of the effects of a refined model begin with its constants, and with what it left of their tolerance;
    a map that stands is moved there by its sensitivity to them. On logs that have, nothing may count twice: a free map begins
    with the configured or calibrated constants again.
    """
    if refined is None or any(effect.took_part(logs) for effect in refined.effects):
        return known
    widths = dict(zip(model.names, model.spread.tolist(), strict=True))
    left = [np.clip(refined.deviations.get(name, width), LEAST_LEFT * width, width) for name, width in widths.items()]
    share = np.array(left) / model.spread
    moved = {name: refined.constants.get(name, 0.0) for name in model.names}
    shift = np.array([moved[name] - known.constants.get(name, 0.0) for name in model.names])
    return _started(model, known.prior.beside(shift), moved, model.covariance * np.outer(share, share))


def beside_healthy(known: Start, healthy: HealthyDrive) -> Start:
    """Return the start at the engine's unknowns as healthy drives show them, with what these leave of their tolerance."""
    found = known.total(dict(zip(known.model.names, healthy.deviation.tolist(), strict=True)))
    model = healthy.engine(known.model)
    return Start(model, known.prior.beside(healthy.deviation), found)


HEALTHY = "healthy"


def learn_healthy(out: Path, names: Mapping[Path, str], outliers: Sequence[str]) -> None:
    """Write `/healthy` into a new result: what the first hour of its own logs leaves, without those that stand out.

    A result stays as it is where nothing can be learned: by an engine that knows its healthy errors already, from logs of less
    than `HEALTHY_LEAST`, or beside a map whose method does not tell of the engine.
    """
    stored = read_result(out)
    engine = known_engine(stored)
    if engine.healthy is not None:
        return
    with suppress(DataError):
        model = engine.residual_model()
        known = known_from(stored, model, engine.config.estimate.prior_map, engine.calibrated)
        logs: list[Log] = []
        digest = {log.name: log.sha256 for log in stored.logs}
        missing = HEALTHY_SECONDS
        for path in sorted(names, key=lambda path: digest.get(names[path], "")):  # the same bytes in any order
            if names[path] in outliers or missing < HEALTHY_LEAST:
                continue
            with suppress(DataError):
                logs.append(
                    read_log(path, engine.air_path.channels, engine.config.reading, auxiliary=True, seconds=missing)
                )
                missing -= logs[-1].time[-1] - logs[-1].time[0]
        if model.blocks or HEALTHY_SECONDS - missing < HEALTHY_LEAST:
            return
        found = learned(known.model, engine.config.grid(), known.prior, logs)
        update(stored, lambda file: write(file, HEALTHY, found) and None)
