"""The sentence that says what a map says."""

import numpy as np

from lpvobs.engines.base import MapAxis
from lpvobs.maps.grid import Grid
from lpvobs.observer.estimate import MapEstimate
from lpvobs.observer.information import AlongFlow
from lpvobs.report.content import doubtful_nodes
from lpvobs.report.spoken import headline

GRID = Grid(np.array([0.0, 10.0, 20.0]), np.array([1000.0, 1500.0]))
AXES = (MapAxis("u_delta", "mg/cycle", "fuel"), MapAxis("n_e", "rpm", "engine speed"))
THETA = 1e-3 * np.array([[1.0, 2.0, np.nan], [np.nan, -4.0, np.nan]])
DRIVEN = np.isfinite(THETA)
SURE = 1e-8 * np.eye(6)
ALIKE = DRIVEN.ravel() / 3.0, 0.0  # every node for a third of the time, and no flow to speak of


def said_of(theta=THETA, covariance=SURE, driven=ALIKE, disagreement=np.nan, along=None, axes=AXES):
    none = np.zeros((0, 2, 3))
    nodes = (theta, np.sqrt(np.diag(covariance)), DRIVEN, np.zeros((1, 2)), covariance, covariance, np.zeros((6, 6)))
    return headline(MapEstimate("observer", GRID, *nodes, (), none, (), None, along), axes, driven, disagreement)


def test_errors_of_neighbours_are_not_taken_as_independent():
    together = np.full((6, 6), 4e-8) + 1e-12 * np.eye(6)  # all nodes are off by the same 0.2 g/s
    said = said_of(covariance=together)
    # mean of 1, 2 and -4; 1.645 times 0.2 to either side
    assert "the sensor reads -0.33 g/s on average (90 %: -0.66 to 0.00)" in said
    assert "largest error -4 g/s at 1500 rpm, 10 mg/cycle; half of the 3 nodes are known to +-0.33 g/s (90 %)" in said


def test_the_drive_weights_the_nodes_and_the_air_flow_makes_it_a_share():
    driven = np.array([0.5, 0.5, 0.0, 0.0, 0.0, 0.0]), 0.05  # 1.5 g/s of 50
    said = said_of(driven=driven, disagreement=0.8)
    assert said.startswith("the sensor reads 3 % high, 1.50 g/s on average (90 %: 1.38 to 1.62); largest error -4 g/s")
    assert said.endswith("; the air flow balances agree")
    said = said_of(-THETA, driven=driven, disagreement=2.9)
    assert said.startswith("the sensor reads 3 % low, -1.50 g/s")
    assert said.endswith("; the air flow balances differ by 2.9 times the allowed difference")


def test_an_axis_without_a_unit_has_its_name():
    axes = (MapAxis("m_f", "1", "fuel"), AXES[1])
    assert "at 1500 rpm, m_f 10;" in said_of(axes=axes)


def test_a_method_without_errors_claims_none():
    said = said_of(covariance=np.full((6, 6), np.nan))
    assert said == "the sensor reads -0.33 g/s on average; largest error -4 g/s at 1500 rpm, 10 mg/cycle"


def test_a_node_alone_and_poorly_known_is_doubtful():
    supported = np.array([[1, 1, 0, 1], [1, 1, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]], dtype=bool)
    error = np.where(supported, 0.1, np.nan)
    error[0, 3] = 0.4
    found = doubtful_nodes(supported, error)
    assert np.argwhere(found).tolist() == [[0, 3]]  # the other lone node is known as well as the rest
    assert not doubtful_nodes(np.zeros((3, 3), dtype=bool), np.ones((3, 3))).any()


def test_an_error_that_follows_the_flow_is_said_and_so_is_one_that_would_be_hidden():
    alone = said_of(along=AlongFlow(0.0, 0.0, 0.0191))
    assert alone.endswith("a gain error of less than about 1.9 % cannot be told from the engine's constants")
    seen = said_of(along=AlongFlow(-0.05, 0.01, 0.02))
    assert seen.endswith("at one operating point the error changes by -5 % of a change of the air flow (90 %: +-1.6 %)")
    little = said_of(along=AlongFlow(0.0, 0.0, 0.45))
    assert little.endswith("these logs do not show whether the sensor's gain is wrong")
