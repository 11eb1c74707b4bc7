"""How well a result follows a log that it was made from: the model's prediction of the reading, balance by balance."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from lpvobs.api.known_engine import known_engine
from lpvobs.api.search_start import known_from, nominal_start
from lpvobs.discovery.imbalances import imbalances_at, scenes_with
from lpvobs.discovery.known_effects import term_on
from lpvobs.discovery.residual import lay_out
from lpvobs.errors import DataError
from lpvobs.io.results.hdf import reading
from lpvobs.io.results.mapping import read_if_there
from lpvobs.io.results.refinements import StoredRefinement
from lpvobs.io.results.results import KIND, REMEDY, StoredResult
from lpvobs.report.fit import ResidualFit, fit_along


def fits_of(name: str, stored: StoredResult, path: Path) -> Iterator[ResidualFit]:
    """Yield the fit of every balance that predicts the reading; none where the method of the map does not tell of the engine."""
    # The prediction is the flow past the sensor by the balance, with the constants that were found, plus the map: y - e.
    engine = known_engine(stored)
    model = engine.residual_model()
    log = engine.read(path)
    with reading(stored.path, KIND, REMEDY) as file:
        refined = read_if_there(file.get("refinement"), StoredRefinement)
    try:
        known = known_from(stored, model, engine.config.estimate.prior_map, engine.calibrated)
        start = nominal_start(model, known, refined, [log])
        problem = lay_out(start.model, stored.grid, start.prior, [log])
    except DataError:  # another method, or too short: the other tables say so
        return
    terms = [term_on(effect, problem, [log]) for effect in (() if refined is None else refined.effects)]
    at = np.zeros(len(problem.covariance))
    left = imbalances_at(problem, scenes_with(problem, terms, at), at)
    left = left if left.shape[1] == problem.K else 0.5 * (left[:, : problem.K] + left[:, problem.K :])
    fuel, speed = (problem.along(axis.channel) for axis in engine.air_path.axes)
    mean = np.where(stored.supported, start.prior.mean.reshape(stored.grid.shape), np.nan)
    theta = stored.grid.interpolate(mean, fuel, speed)
    measured = problem.along(engine.air_path.sensor)
    inputs = problem.inputs()
    for balance, e, slope, shown in zip(model.balances, left, problem.by_reading, problem.shown, strict=True):
        if np.any(slope != 0.0):
            with np.errstate(divide="ignore", invalid="ignore"):
                predicted = np.where(shown, measured - (e / slope - theta), np.nan)
            found = fit_along((name, log.name, balance), problem.time, measured, predicted, inputs)
            if found is not None:
                yield replace(found, log=next(own.name for own in stored.logs if own.sha256 == log.sha256))
