"""Constants of refined models: nothing counts twice, several refinements add up, and a map that stands follows its constants."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from repository import DIESEL

from lpvobs.api.search_start import Start, known_from, nothing_known, search_start
from lpvobs.discovery.known_effects import KnownEffect, Span
from lpvobs.discovery.map_prior import MapPrior
from lpvobs.discovery.thresholds import LEAST_LEFT, LIKENESS
from lpvobs.engines.diesel.effects import diesel_model
from lpvobs.engines.unknowns import LeftAtNodes, Unknowns, loop_unknowns, unknowns_of
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import load_config
from lpvobs.io.results.engines import EngineOfMap
from lpvobs.io.results.refinements import StoredRefinement
from lpvobs.maps.grid import Grid
from lpvobs.records import Defects, Log

TOLERANCE = {"V_d": 0.01, "c_vol3": 0.02}
LAG = KnownEffect("maf.lag", "sensor", "tau", "s", 0.08, (0.07, 0.09), (Span("a", "1", -np.inf, np.inf),), True, None)
REFINED = StoredRefinement((LAG,), {"V_d": 0.004, "c_vol3": -0.01}, {"V_d": 0.0001, "c_vol3": 0.009}, True, "{}")


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


@pytest.fixture(scope="module")
def known(model, prior):
    """Return a map that was estimated with a displacement 0.1 % above the configured one."""
    moved = {"V_d": 0.001}
    return Start(model.restarted(moved, np.array([[1e-6, 2e-7], [2e-7, 4e-6]])), prior, moved)


def test_a_result_that_was_not_refined_starts_where_the_map_has_the_engine(model, prior, known):
    start = search_start(model, known, None, [log("2")])
    assert start.model.constants.constants.V_d == pytest.approx(1.001 * model.constants.constants.V_d)
    np.testing.assert_array_equal(start.model.covariance, [[1e-6, 2e-7], [2e-7, 4e-6]])
    assert start.prior is prior
    assert start.total({"V_d": 0.003})["V_d"] == pytest.approx(1.001 * 1.003 - 1.0)


def test_other_logs_start_from_the_refined_constants_and_the_map_at_them(model, prior, known):
    start = search_start(model, known, REFINED, [log("2")])
    assert start.model.constants.constants.V_d == pytest.approx(1.004 * model.constants.constants.V_d)
    again = start.model.with_unknowns(np.array([0.01, 0.0]))
    assert again.constants.V_d == pytest.approx(1.004 * 1.01 * model.constants.constants.V_d)
    # No refinement narrows a tolerance below a third; a deviation above it narrows to itself.
    assert start.model.spread == pytest.approx([LEAST_LEFT * 0.01 / np.sqrt(3.0), 0.009])
    assert start.prior.mean == pytest.approx(prior.mean + prior.sensitivity @ [0.004 - 0.001, -0.01])
    assert start.total({"V_d": 0.01})["V_d"] == pytest.approx(1.004 * 1.01 - 1.0)


def test_logs_that_told_already_start_with_the_engine_of_the_map(model, prior, known):
    start = search_start(model, known, REFINED, [log("1")])
    assert start.model.constants.constants.V_d == pytest.approx(1.001 * model.constants.constants.V_d)
    assert start.prior is prior


def test_a_free_map_is_not_moved(model):
    known = nothing_known(model, Grid(np.array([0.0, 1.0]), np.array([0.0, 1.0])), 0.1)
    moved = search_start(model, known, REFINED, [log("2")]).prior
    assert moved.free
    np.testing.assert_array_equal(moved.mean, known.prior.mean)
    assert search_start(model, known, None, [log("2")]).model is model
    assert search_start(model, known, REFINED, [log("1")]).model is model


@dataclass(frozen=True)
class Result:
    """What `known_from` asks of a stored result: two nodes, and constants of which the last is none of the model's."""

    theta: np.ndarray
    covariance: np.ndarray
    sensitivity: np.ndarray
    constants: tuple[str, ...]
    engine: EngineOfMap | None
    path: str = "r.h5"
    method: str = "observer"


def test_a_stored_map_and_its_engine_are_conditional_on_what_the_model_takes_as_configured(model):
    """Against the conditional mean and covariance of the joint distribution, node by node and constant by constant."""
    rng = np.random.default_rng(1)
    root = 1e-3 * rng.standard_normal((3, 3))
    C, S = root @ root.T, rng.standard_normal((2, 3))
    noise = np.diag([1e-6, 4e-6])
    found = EngineOfMap(("c_vol3", "R_a", "V_d"), np.array([2e-3, 5e-4, -1e-3]), C, (), ())
    result = Result(
        np.array([[0.01, 0.02]]), noise + S @ C @ S.T, S.T.reshape(3, 1, 2), ("c_vol3", "R_a", "V_d"), found
    )
    known = known_from(result, model, 0.1)
    joint = np.block([[result.covariance, S @ C], [C @ S.T, C]])
    kept, gone = [0, 1, 4, 2], 3  # map, V_d, c_vol3; R_a is as configured
    answer = joint[kept, gone] / joint[gone, gone]
    mean = np.array([0.01, 0.02, -1e-3, 2e-3]) - answer * 5e-4
    covariance = joint[np.ix_(kept, kept)] - np.outer(answer, joint[gone, kept])
    assert known.prior.mean == pytest.approx(mean[:2], rel=1e-9)
    assert known.constants == pytest.approx({"V_d": mean[2], "c_vol3": mean[3]}, rel=1e-9)
    width = LEAST_LEFT * np.array([0.01, 0.02]) / np.sqrt(3.0)
    relative = covariance[2:, 2:] / np.outer(1.0 + mean[2:], 1.0 + mean[2:])
    np.testing.assert_allclose(known.model.covariance, relative + np.diag(width**2), rtol=1e-9)
    S_kept = known.prior.sensitivity
    np.testing.assert_allclose(S_kept @ covariance[2:, 2:], covariance[:2, 2:], rtol=1e-6, atol=1e-12)
    left = covariance[:2, :2] - S_kept @ covariance[2:, 2:] @ S_kept.T + LIKENESS**2 * np.eye(2)
    np.testing.assert_allclose(np.linalg.inv(known.prior.precision), left, rtol=1e-6, atol=1e-12)


def test_what_the_formulas_left_is_added_to_a_map_of_changes(model):
    """The loop compares readings with flows, so its map is all that the balances leave: of then, and what has changed since."""
    at_nodes = LeftAtNodes(np.zeros(2), np.zeros(1), np.array([3e-3, -1e-3]), np.array([[0.2], [0.5]]), np.eye(2))
    calibrated = Unknowns(("V_d",), (), np.array([0.002]), np.eye(1), True, at_nodes)
    found = EngineOfMap(("V_d",), np.array([0.005]), np.array([[1e-6]]), (), ())
    theta, S = np.array([0.01, 0.02]), np.array([[1.5], [-1.0]])
    covariance = np.diag([1e-6, 4e-6]) + S @ found.covariance @ S.T
    total = Result(theta[None], covariance, S.T.reshape(1, 1, 2), ("V_d",), found)
    change = replace(total, covariance=covariance + at_nodes.covariance)
    plain, known = known_from(total, model, 0.1), known_from(change, model, 0.1, calibrated)
    since = 1.005 / 1.002 - 1.0
    assert known.prior.mean == pytest.approx(plain.prior.mean + np.array([3e-3 + 0.2 * since, 0.5 * since - 1e-3]))
    own = model.names.index("V_d")
    assert known.prior.sensitivity[:, own] == pytest.approx([1.7, -0.5])
    np.testing.assert_allclose(known.prior.precision, plain.prior.precision)


def test_a_map_that_does_not_tell_of_its_engine_cannot_stand(model):
    result = Result(np.zeros((1, 2)), np.eye(2), np.zeros((0, 1, 2)), (), None, method="published")
    with pytest.raises(DataError, match="its covariance with the engine's constants is stored"):
        known_from(result, model, 0.1)


def test_the_loop_knows_a_volume_as_well_as_its_tolerance_says():
    tolerance = {"V_d": 0.01, "V_im": 0.15}
    for known in (None, unknowns_of(tolerance, ())):
        found = loop_unknowns(tolerance, known)
        assert found.names == ("V_d", "V_im")
        assert np.sqrt(3.0 * np.diag(found.covariance)) == pytest.approx([0.01, 0.15], rel=1e-12)
