"""The convex problem on systems so small that its solution is known: by hand, from Riccati, from a search in one number."""

import warnings

import cvxpy
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are, solve_continuous_lyapunov
from scipy.optimize import minimize_scalar

from lpvobs.synthesis.lmi import LmiSolution, fixed_gain, free_gain

EVERYTHING = np.ones((1, 2), dtype=bool)
CLOSE = 1e-6  # the solver stops at 1e-8 of the cost, and P is known to a small multiple of that where the cost is linear in it
FLAT = 1e-4  # at a minimum the cost is flat, and a gain known to the root of 1e-8


def one_state(a, c, k, *, cascade=False):
    return free_gain(np.array([[[a]]]), np.array([[[c]]]), 0, k, EVERYTHING, cascade)


@pytest.mark.parametrize(("a", "c", "P"), [(-1.0, 1.0, 0.5), (-4.0, 3.0, 0.125), (-0.25, -0.5, 2.0), (-1.0, 0.0, 0.5)])
def test_a_cascade_of_one_state_is_left_alone(a, c, P):
    found = one_state(a, c, 0.25, cascade=True)  # -2 a P >= 1
    np.testing.assert_allclose(found.P, [[P]], rtol=CLOSE)
    assert found.L.tolist() == [[0.0]]
    assert found.beta == (0.25 / c**2 if c else 1.0)


def test_a_cascade_of_an_unstable_state_has_no_gain():
    word = one_state(0.5, 1.0, 0.25, cascade=True)
    assert word.startswith("status of the solver: infeasible")


def by_search(a, c, k):
    """Least P + Y^2 / P with 2 (Y c - a P) >= 1 + beta c^2 + Y^2 / (k beta), beta >= 1 / (4 c^2): Y, P and beta of one state.

    For a Y, the best beta is |Y| / (|c| sqrt(k)), or the bound.
    """

    def beta(Y):
        return max(0.25 / c**2, abs(Y) / (abs(c) * np.sqrt(k)))

    def P(Y):
        return (1.0 + beta(Y) * c**2 + Y**2 / (k * beta(Y)) - 2.0 * Y * c) / (-2.0 * a)

    Y = minimize_scalar(lambda Y: P(Y) + Y**2 / P(Y), bounds=(-1.0, 1.0), options={"xatol": 1e-10}, method="bounded").x
    return Y, P(Y), beta(Y)


@pytest.mark.parametrize(("a", "c", "k"), [(-1.0, 1.0, 0.25), (-0.5, 1.0, 0.8), (-0.1, -2.0, 0.9), (-3.0, 0.5, 0.05)])
def test_one_state_seen_through_the_map_gets_what_a_search_finds(a, c, k):
    found = one_state(a, c, k)
    Y, P, _ = by_search(a, c, k)
    np.testing.assert_allclose(found.P, [[P]], rtol=FLAT)
    np.testing.assert_allclose(found.L, [[Y / P]], rtol=0, atol=FLAT)
    # beta is free between what Y needs and what the vertex leaves, so only its bounds are known
    assert found.beta >= 0.25 / c**2 * (1.0 - CLOSE)
    left = -2.0 * a * P + 2.0 * Y * c - 1.0 - found.beta * c**2 - Y**2 / (k * found.beta)
    assert left == pytest.approx(0.0, abs=1e-3)  # a flat minimum again, times what multiplies it


def test_an_unstable_state_seen_through_the_map_alone_has_no_gain():
    # 2 Y (1 - 1 / sqrt(k)) > 2 P would be needed, and k < 1
    assert "infeasible" in one_state(0.1, 1.0, 0.9)


def test_a_state_with_a_sensor_of_its_own_gets_the_kalman_filter():
    # dx/dt = -x, y_1 = x: X = sqrt(2) - 1 = L; then 2 P (1 + L) = 1. The map's output sees nothing.
    A, C = np.array([[[-1.0]]]), np.array([[[1.0], [0.0]]])
    for cascade in (False, True):
        found = free_gain(A, C, 1, 0.25, np.array([[True, True, False]]), cascade)
        np.testing.assert_allclose(found.L, [[np.sqrt(2.0) - 1.0, 0.0]], rtol=0, atol=FLAT)
        np.testing.assert_allclose(found.P, [[0.5 / np.sqrt(2.0)]], rtol=FLAT)
        assert found.L[0, 1] == 0.0


COUPLED = np.array([[[-1.0, 2.0], [-0.5, 0.25]]])
SEEN = np.array([[[0.5, 1.0], [1.0, -1.0]]])


@pytest.mark.parametrize("map_output", [0, 1])
def test_two_states_get_the_kalman_filter_of_the_other_output(map_output):
    found = free_gain(COUPLED, SEEN, map_output, 0.25, np.ones((2, 4), dtype=bool), True)
    C_1 = SEEN[0][[1 - map_output]]
    X = solve_continuous_are(COUPLED[0].T, C_1.T, np.eye(2), np.eye(1))
    np.testing.assert_allclose(found.L[:, [1 - map_output]], X @ C_1.T, atol=FLAT)
    assert found.L[:, map_output].tolist() == [0.0, 0.0]
    # and P is what Lyapunov's equation says of that gain
    closed = COUPLED[0] - X @ C_1.T @ C_1
    np.testing.assert_allclose(found.P, solve_continuous_lyapunov(closed.T, -np.eye(2)), atol=10 * FLAT)
    assert np.array_equal(found.P, found.P.T)


def test_parts_that_are_not_tied_get_exact_zeros_and_do_not_hear_of_each_other():
    A = np.diag([-1.0, -2.0])[None]
    C = np.array([[[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]])
    linked = np.array([[True, False, True, False, False], [False, True, False, True, False]])
    found = free_gain(A, C, 2, 0.25, linked, True)
    assert found.P[0, 1] == found.P[1, 0] == 0.0
    assert found.L[0, 1:].tolist() == [0.0, 0.0]
    assert found.L[1, [0, 2]].tolist() == [0.0, 0.0]
    # Each is the filter of one state: X = -a + sqrt(a^2 + 1), P = 1 / (2 sqrt(a^2 + 1))
    np.testing.assert_allclose(np.diag(found.L), [np.sqrt(2.0) - 1.0, np.sqrt(5.0) - 2.0], rtol=0, atol=FLAT)
    np.testing.assert_allclose(np.diag(found.P), [0.5 / np.sqrt(2.0), 0.5 / np.sqrt(5.0)], rtol=FLAT)
    assert linked.sum() == 4  # what was given is left as it was


def test_ties_that_are_forbidden_are_not_used():
    # y_1 sees the first state; the second is on its own: 2 * 2 P_22 >= 1
    A, C = np.diag([-1.0, -2.0])[None], np.array([[[1.0, 0.0], [0.0, 0.0]]])
    linked = np.array([[True, False, True, False], [False, True, False, False]])
    found = free_gain(A, C, 1, 0.25, linked, False)
    np.testing.assert_allclose(found.L, [[np.sqrt(2.0) - 1.0, 0.0], [0.0, 0.0]], rtol=0, atol=FLAT)
    np.testing.assert_allclose(found.P, np.diag([0.5 / np.sqrt(2.0), 0.25]), rtol=0, atol=FLAT)


def test_every_vertex_counts():
    # Of -1 and -1/4 the slower decides P = 2; of the lengths 5 and 1 the longer beta = 1/100
    A, C = np.array([[[-1.0]], [[-0.25]]]), np.array([[[1.0]], [[-5.0]]])
    found = free_gain(A, C, 0, 0.25, EVERYTHING, True)
    np.testing.assert_allclose(found.P, [[2.0]], rtol=CLOSE)
    assert found.beta == pytest.approx(0.01, rel=1e-15)


def test_the_length_of_the_map_s_row_is_euclid_s():
    A, linked = -np.eye(2)[None], np.ones((2, 3), dtype=bool)
    assert free_gain(A, np.array([[[3.0, 4.0]]]), 0, 0.25, linked, True).beta == pytest.approx(0.01, rel=1e-15)


def test_vertices_must_come_in_pairs():
    with pytest.raises(ValueError, match="zip"):
        free_gain(-np.ones((2, 1, 1)), np.ones((1, 1, 1)), 0, 0.25, EVERYTHING, False)
    with pytest.raises(ValueError, match="zip"):
        fixed_gain(-np.ones((2, 1, 1)), np.ones((1, 1)), np.ones((1, 1)), 0, 0.25)


def given(closed, L, c, k=0.25):
    return fixed_gain(np.array([[[closed]]]), np.array([[L]]), np.array([[c]]), 0, k)


@pytest.mark.parametrize(("a", "k"), [(1.0, 0.25), (2.0, 0.25), (1.0, 0.64)])
def test_how_much_gain_the_map_s_output_stands_is_known(a, k):
    # P L |c| / sqrt(k) < P (a + L c) with c = 1: L < a sqrt(k) / (1 - sqrt(k))
    limit = a * np.sqrt(k) / (1.0 - np.sqrt(k))
    inside, outside = (given(-(a + L), L, 1.0, k) for L in (0.95 * limit, 1.05 * limit))
    assert isinstance(inside, LmiSolution)
    assert inside.P[0, 0] > 0.0
    assert inside.L.tolist() == [[0.95 * limit]]
    assert "infeasible" in outside


def test_a_given_gain_of_nothing_leaves_lyapunov_s_equation():
    found = fixed_gain(COUPLED - [[0.0, 0.0], [0.0, 2.0]], np.zeros((2, 2)), SEEN[:, 1], 1, 0.25)
    expected = solve_continuous_lyapunov((COUPLED[0] - [[0.0, 0.0], [0.0, 2.0]]).T, -np.eye(2))
    np.testing.assert_allclose(found.P, expected, rtol=CLOSE)
    assert found.beta == pytest.approx(0.125, rel=1e-15)  # 1 / (4 * 2)
    assert np.array_equal(found.P, found.P.T)


def test_a_given_gain_on_the_map_by_hand():
    # 4 P >= 1 + beta + P^2 / (k beta), whose least right side is 1 + 2 P / sqrt(k), at beta = P / sqrt(k): none for k = 1/4
    # (4 P >= 1 + 4 P), and P = beta = 1/2 for k = 1.
    assert "infeasible" in given(-2.0, 1.0, 1.0, 0.25)
    found = given(-2.0, 1.0, 1.0, 1.0)
    np.testing.assert_allclose(found.P, [[0.5]], rtol=FLAT)
    assert found.beta == pytest.approx(0.5, rel=1e-2)  # flat there


def test_only_the_map_s_column_of_a_given_gain_costs():
    closed, C_2 = np.array([[[-2.0]]]), np.array([[1.0]])
    free = fixed_gain(closed, np.array([[7.0, 0.0]]), C_2, 1, 0.25)
    np.testing.assert_allclose(free.P, [[0.25]], rtol=CLOSE)
    assert "infeasible" in fixed_gain(closed, np.array([[7.0, 0.0]]), C_2, 0, 0.25)


def test_an_unstable_loop_has_no_proof():
    assert "infeasible" in given(0.5, 0.0, 1.0)


def test_one_entry_in_the_map_s_column_makes_it_no_cascade():
    # L = (0, 3) on two states that decay alone: P_22 must stand the map, P_11 need not
    L = np.array([[0.0], [3.0]])
    assert "infeasible" in fixed_gain(np.diag([-1.0, -1.0])[None], L, np.array([[0.0, 1.0]]), 0, 0.25)
    assert isinstance(fixed_gain(np.diag([-1.0, -1.0])[None], 0.1 * L, np.array([[0.0, 1.0]]), 0, 0.25), LmiSolution)


def broken_solver(P):
    """A solver that writes one number on every diagonal and zero elsewhere, and is content."""

    def solve(problem, **_):
        for variable in problem.variables():
            variable.value = P * np.eye(*variable.shape) if variable.ndim else 1.0

    return solve


@pytest.mark.parametrize("P", [0.0, -1.0, 1.0])
def test_numbers_of_a_solver_that_are_no_solution_are_not_taken(monkeypatch, P):
    monkeypatch.setattr(cvxpy.Problem, "solve", broken_solver(P))
    for found in (one_state(-1.0, 1.0, 0.25), given(-1.0, 0.1, 1.0)):
        assert isinstance(found, LmiSolution) == (P > 0.0)
        assert getattr(found, "P", found) == (np.eye(1) if P > 0.0 else "status of the solver: None")


@pytest.mark.parametrize("bad", [-1.0, np.inf])
def test_one_bad_direction_of_P_is_enough_to_refuse_it(monkeypatch, bad):
    def solve(problem, **_):
        for variable in problem.variables():
            # As the solver's answer is put there, unlike `value`, which some versions of cvxpy look through with a warning.
            variable.save_value(np.diag([1.0, bad]) if variable.shape == (2, 2) else np.ones(variable.shape))

    monkeypatch.setattr(cvxpy.Problem, "solve", solve)
    assert fixed_gain(-np.eye(2)[None], np.ones((2, 1)), np.ones((1, 2)), 0, 0.25) == "status of the solver: None"


@pytest.mark.parametrize("cascade", [True, False])
def test_a_solver_that_gives_nothing_or_breaks_down_is_quoted(monkeypatch, cascade):
    monkeypatch.setattr(cvxpy.Problem, "solve", lambda *_, **__: None)
    assert one_state(-1.0, 1.0, 0.25, cascade=cascade) == "status of the solver: None"

    def breaks_down(*_, **__):
        raise cvxpy.SolverError("lost its way")

    monkeypatch.setattr(cvxpy.Problem, "solve", breaks_down)
    assert one_state(-1.0, 1.0, 0.25, cascade=cascade) == "the solver stopped with an error"
    assert given(-1.0, 0.0 if cascade else 0.1, 1.0) == "the solver stopped with an error"


def test_an_inaccurate_optimum_is_no_reason_to_warn(monkeypatch):
    original = cvxpy.Problem.solve

    def solve(problem, **options):
        warnings.warn("LmiSolution may be inaccurate.", UserWarning, stacklevel=1)
        return original(problem, **options)

    monkeypatch.setattr(cvxpy.Problem, "solve", solve)
    assert isinstance(one_state(-1.0, 1.0, 0.25), LmiSolution)  # a warning would be an error here
