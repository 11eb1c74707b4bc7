"""Poles of the closed loop by hand."""

import numpy as np
import pytest

from lpvobs.synthesis.gain import hurwitz_at_vertices, poles
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region


def diagonal(first, second):
    return GainProblem(lambda p: ([[first, 0], [0, second]], [[1, 0]]), Region(("a",), (0.0,), (0.0,)), 0)


def test_poles_at_every_vertex_by_hand():
    problem = GainProblem(lambda p: ([[0, p[0]], [-4, 0]], [[0, 2], [1, 0]]), Region(("a",), (1.0,), (9.0,)), 0)
    free = np.sort_complex(poles(problem, np.zeros((2, 2))))
    np.testing.assert_allclose(free, [[-2j, 2j], [-6j, 6j]], atol=1e-14)  # rounding
    # With L = [[0, 0], [2, 0]]: A - L C = [[0, a], [-4, -4]], double pole -2 at a = 1.
    closed = poles(problem, np.array([[0.0, 0.0], [2.0, 0.0]]))
    np.testing.assert_allclose(closed[0], -2.0, atol=1e-6)  # a double pole: the root of rounding
    np.testing.assert_allclose(closed[1].real, -2.0, rtol=1e-12)  # rounding


@pytest.mark.parametrize(
    ("first", "second", "stable"), [(-1, -2, True), (0, -1, False), (-1, 0, False), (1, -2, False), (-2, 1, False)]
)
def test_every_pole_must_be_left_of_the_axis(first, second, stable):
    assert hurwitz_at_vertices(diagonal(first, second), np.zeros((2, 1))) is stable


def test_every_vertex_counts_and_the_gain_moves_poles():
    problem = GainProblem(lambda p: ([[p[0]]], [[2]]), Region(("a",), (-1.0,), (3.0,)), 0)
    assert not hurwitz_at_vertices(problem, np.array([[1.25]]))  # 3 - 2.5
    assert hurwitz_at_vertices(problem, np.array([[1.75]]))  # 3 - 3.5
