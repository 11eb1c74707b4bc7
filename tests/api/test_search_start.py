"""Constants of refined models: nothing counts twice, several refinements add up, and a map that stands follows its constants."""

import numpy as np
import pytest
from repository import DIESEL

from lpvobs.api.search_start import LEAST_LEFT, start_of
from lpvobs.discovery.known_effects import KnownEffect, Span
from lpvobs.discovery.residual import MapPrior, free_map
from lpvobs.engines.diesel.effects import diesel_model
from lpvobs.io.configuration.config import load_config
from lpvobs.io.results.refinements import StoredRefinement
from lpvobs.maps.grid import Grid
from lpvobs.records import Defects, Log

TOLERANCE = {"V_d": 0.01, "V_im": 0.02}
LAG = KnownEffect("maf.lag", "sensor", "tau", "s", 0.08, (0.07, 0.09), (Span("a", "1", -np.inf, np.inf),), True, None)
REFINED = StoredRefinement(
    (LAG,), {"V_d": 0.004, "V_im": -0.01}, {"V_d": 0.0001, "V_im": 0.009}, {"V_d": 0.001, "V_im": 0.0}, True, "{}"
)


@pytest.fixture(scope="module")
def model():
    return diesel_model(load_config(DIESEL)[0].engine, TOLERANCE)


@pytest.fixture(scope="module")
def prior():
    sensitivity = np.array([[1.0, 2.0], [0.0, -1.0]])
    return MapPrior(np.array([0.01, 0.02]), np.eye(2), sensitivity, False)


def log(sha256):
    time = np.arange(3.0)
    return Log("a", sha256, time, {}, {}, ((0, 3),), np.arange(3), Defects(3))


def test_a_result_that_was_not_refined_starts_as_configured(model, prior):
    start = start_of(model, prior, None, [log("2")])
    assert (start.model, start.prior) == (model, prior)
    assert start.total({"V_d": 0.003}) == pytest.approx({"V_d": 0.003})


def test_other_logs_start_from_the_refined_constants_and_the_map_at_them(model, prior):
    start = start_of(model, prior, REFINED, [log("2")])
    assert start.model.constants.V_d == pytest.approx(1.004 * model.constants.V_d)
    again = start.model.with_unknowns(np.array([0.01, 0.0]))
    assert again.V_d == pytest.approx(1.004 * 1.01 * model.constants.V_d)
    # No refinement narrows a tolerance below a third; a deviation above it narrows to itself.
    assert start.model.spread == pytest.approx([LEAST_LEFT * 0.01 / np.sqrt(3.0), 0.009])
    assert start.prior.mean == pytest.approx(prior.mean + prior.sensitivity @ [0.004 - 0.001, -0.01])
    assert start.total({"V_d": 0.01})["V_d"] == pytest.approx(1.004 * 1.01 - 1.0)


def test_logs_that_told_already_start_as_configured_with_the_map_brought_back(model, prior):
    start = start_of(model, prior, REFINED, [log("1")])
    assert start.model.constants == model.constants
    np.testing.assert_allclose(start.model.covariance, model.covariance)
    assert start.prior.mean == pytest.approx(prior.mean + prior.sensitivity @ [-0.001, 0.0])


def test_a_free_map_is_not_moved(model):
    free = free_map(Grid(np.array([0.0, 1.0]), np.array([0.0, 1.0])), 2, 0.1)
    assert start_of(model, free, REFINED, [log("2")]).prior is free
