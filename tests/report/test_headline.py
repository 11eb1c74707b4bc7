"""The sentence that says what a map says."""

import numpy as np

from lpvobs.engines.base import MapAxis
from lpvobs.maps.grid import Grid
from lpvobs.report.spoken import headline

GRID = Grid(np.array([0.0, 10.0, 20.0]), np.array([1000.0, 1500.0]))
AXES = (MapAxis("u_delta", "mg/cycle", "fuel"), MapAxis("n_e", "rpm", "engine speed"))
THETA = 1e-3 * np.array([[1.0, 2.0, np.nan], [np.nan, -4.0, np.nan]])
DRIVEN = np.isfinite(THETA)


def test_errors_of_neighbours_are_not_taken_as_independent():
    together = np.full((6, 6), 4e-8) + 1e-12 * np.eye(6)  # all nodes are off by the same 0.2 g/s
    said = headline(GRID, AXES, THETA, together, DRIVEN)
    # mean of 1, 2 and -4; 1.645 times 0.2 to either side
    assert "-0.33 g/s on average over the 3 nodes that were driven (90 %: -0.66 to 0.00)" in said
    assert "-4 g/s at most, at 1500 rpm and 10 mg/cycle; the middle node is known to 0.33 g/s" in said


def test_a_method_without_errors_claims_none():
    said = headline(GRID, AXES, THETA, np.full((6, 6), np.nan), DRIVEN)
    assert said == "the sensor's error is -0.33 g/s on average over the 3 nodes that were driven"


def test_nothing_driven_is_said():
    assert headline(GRID, AXES, THETA, np.eye(6), np.zeros((2, 3), bool)) == "the drives say nothing of the map"
