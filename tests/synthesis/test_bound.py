"""The proven bound on the error of the state: by hand, against worst cases, and refused where it was changed."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from lpvobs.errors import DataError
from lpvobs.synthesis.certificate import StateBound, comparison, prove_bound, state_bound
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region
from lpvobs.synthesis.solve import synthesise

WARM = {"T_im": (280.0, 400.0), "T_em": (300.0, 1200.0)}


def two_states(low=-1.0, high=2.0):
    """Return dx1/dt = -x1 + r x2, dx2/dt = 1/2 x1 - 4 x2, both measured, and the map in a third output."""

    def system(point):
        r, one = point[0], Fraction(1)
        return [[-one, r], [one / 2, -4 * one]], [[one, 0 * one], [0 * one, one], [one, one]]

    return GainProblem(system, Region(("r",), (low,), (high,)), 2)


L = np.array([[3.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def test_by_hand():
    # A - L C = [[-4, r], [1/2, -5]], |r| <= 2: N = [[-4, 2], [1/2, -5]], det 19.
    assert comparison(two_states(), L).tolist() == [[-4, 2], [Fraction(1, 2), -5]]
    found = state_bound(two_states(), L)
    np.testing.assert_allclose(found.of_rates, np.array([[5.0, 2.0], [0.5, 4.0]]) / 19.0, rtol=1e-8)
    np.testing.assert_allclose(found.of_outputs, np.array([[15.0, 2.0, 0.0], [1.5, 4.0, 0.0]]) / 19.0, rtol=1e-8)
    assert prove_bound(two_states(), L, found) == ""


@pytest.mark.parametrize("name", ["of_rates", "of_outputs"])
@pytest.mark.parametrize("place", [(0, 0), (1, 1), (0, 1)])
def test_a_bound_that_is_a_little_too_small_is_not_proven(name, place):
    found = state_bound(two_states(), L)
    smaller = getattr(found, name).copy()
    smaller[place] *= 1.0 - 1e-7
    assert prove_bound(two_states(), L, replace(found, **{name: smaller})) != ""


def test_numbers_that_do_not_fit_are_refused():
    found = state_bound(two_states(), L)
    with pytest.raises(DataError, match="arrays of shapes"):
        prove_bound(two_states(), L, StateBound(found.of_rates, found.of_outputs[:, :2]))
    with pytest.raises(DataError, match="finite"):
        prove_bound(two_states(), L, replace(found, of_rates=np.full((2, 2), np.nan)))
    assert "negative" in prove_bound(two_states(), L, replace(found, of_rates=-found.of_rates))


def test_where_neighbours_drive_each_other_too_much_there_is_none():
    assert state_bound(two_states(high=50.0), L) is None


@pytest.mark.parametrize("h", [1e-3, 0.1, 10.0])
def test_no_course_of_parameters_and_disturbances_gets_beyond_it(h):
    problem, rng = two_states(), np.random.default_rng(1)
    bound, W = state_bound(problem, L).of_rates @ np.array([1.0, 3.0]), np.array([1.0, 3.0])
    reached = np.zeros(2)
    for course in range(40):
        e, r = np.zeros(2), 2.0
        for _ in range(round(3.0 / h) + 5 if course == 0 else 100):  # the first has the worst of both at all times
            r = rng.choice([-1.0, 2.0]) if course and rng.random() < 0.05 else r
            w = W * np.where(rng.random(2) < 0.03 * (course > 0), -1.0, 1.0)
            closed = np.array([[-4.0, r], [0.5, -5.0]])
            e = np.linalg.solve(np.eye(2) - h * closed, e + h * w)  # backward Euler
            reached = np.maximum(reached, np.abs(e))
    assert np.all(reached <= bound)
    assert np.all(reached >= 0.9 * bound)


def test_the_gain_of_the_diesel_has_one_and_a_step_of_the_observer_keeps_it(diesel):
    problem = diesel("ETC", p_em=True, **WARM)
    gain = synthesise(problem, cascade=True, decay=1000.0)
    assert prove_bound(problem, gain.L, gain.bound) == ""
    W, rng = np.array([2e4, 1.5e5, 500.0]), np.random.default_rng(2)
    b = gain.bound.of_rates @ W
    A, C = problem.matrices()
    for closed in A - gain.L @ C:
        for h in (1e-4, 1e-2, 1.0):
            e = b * rng.choice([-1.0, 1.0], 3)
            after = np.linalg.solve(np.eye(3) - h * closed, e + h * W * rng.choice([-1.0, 1.0], 3))
            assert np.all(np.abs(after) <= b * (1 + 1e-12))
