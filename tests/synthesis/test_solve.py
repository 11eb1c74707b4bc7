"""From a problem to a proven gain and back to its units, on systems of one or two states whose answer is known."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are
from scipy.optimize import minimize_scalar

from lpvobs.errors import DataError, NotProven
from lpvobs.synthesis import lmi, solve
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region
from lpvobs.synthesis.solve import certify_fixed_gain, largest_feasible, synthesise

CLOSE = 1e-5  # the solver stops at 1e-8 of the cost
POINT = Region(("a",), (4.0,), (4.0,))


def one_state(c=3, low=4.0, high=4.0):
    """dx/dt = -a x, and the map's output c x."""
    return GainProblem(lambda p: ([[-p[0]]], [[c]]), Region(("a",), (low,), (high,)), 0)


@pytest.mark.parametrize("eps", [0.49, 0.98])
@pytest.mark.parametrize(("a", "c"), [(4.0, 3), (0.25, 3), (7.0, 200)])
def test_of_what_a_cascade_loses_half_goes_into_Q_and_a_quarter_to_the_map(a, c, eps, monkeypatch):
    monkeypatch.setattr(solve, "EPSILON", eps)
    gain = synthesise(one_state(c, a, a), cascade=True)
    assert gain.L.tolist() == [[0.0]]
    assert (gain.eps_1, gain.eps_2) == (eps, eps)
    share = c**2 / eps
    np.testing.assert_allclose([2.0 * a * gain.P[0, 0], gain.Q[0, 0]], [4.0 * share, 2.0 * share], rtol=CLOSE)
    assert gain.certificate.proven
    # -M = [[4 - 2, 0, -c], [0, eps, 0], [-c, 0, eps]] in those shares: 1 - 1/2 is the least pivot
    assert gain.certificate.smallest_pivot == pytest.approx(0.5, rel=CLOSE)
    assert gain.region == Region(("a",), (a,), (a,))


def test_the_slowest_vertex_decides():
    gain = synthesise(one_state(3, 1.0, 4.0), cascade=True)
    assert 2.0 * gain.P[0, 0] == pytest.approx(4.0 * 9.0 / 0.49, rel=CLOSE)


@pytest.mark.parametrize("decay", [1.0, 2.0, 3.5])
def test_decay_is_taken_from_what_P_may_count_on(decay):
    gain = synthesise(one_state(), cascade=True, decay=decay)
    assert 2.0 * (4.0 - decay) * gain.P[0, 0] == pytest.approx(4.0 * 9.0 / 0.49, rel=CLOSE)


def test_no_faster_decay_than_the_plant_s_without_a_measurement():
    with pytest.raises(
        NotProven,
        match=r"no gain was found that can be proven .*infeasible.* on the region a \[4, 4\]; expected the matrix inequality Eq",
    ):
        synthesise(one_state(), cascade=True, decay=4.5)


@pytest.mark.parametrize("epsilon", [0.49, 0.25, 0.7])
def test_one_state_seen_through_the_map_gets_the_gain_of_a_search(epsilon, monkeypatch):
    monkeypatch.setattr(solve, "EPSILON", epsilon)
    k = epsilon**2

    # In units of 1/a and with C = 1: least P + Y^2 / P with 2 P + 2 Y >= 1 + beta + Y^2 / (k beta), beta >= 1/4
    def P(Y):
        beta = max(0.25, abs(Y) / np.sqrt(k))
        return (1.0 + beta + Y**2 / (k * beta) - 2.0 * Y) / 2.0

    Y = minimize_scalar(lambda Y: P(Y) + Y**2 / P(Y), bounds=(-1.0, 1.0), options={"xatol": 1e-10}, method="bounded").x
    gain = synthesise(one_state(), cascade=False)
    np.testing.assert_allclose(
        gain.L, [[4.0 / 3.0 * Y / P(Y)]], rtol=0, atol=2e-4
    )  # the root of 1e-8 at a flat minimum
    assert (gain.eps_1, gain.eps_2) == (epsilon, epsilon)
    np.testing.assert_allclose(gain.P / gain.Q, [[2.0 * P(Y) / 4.0]], rtol=1e-3)  # as flat
    assert gain.certificate.proven


OSCILLATOR, SEEN = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[1.0, 0.0], [0.0, 1.0]])
T, S, RATE = np.array([1024.0, 0.125]), np.array([16.0, 0.25]), 8.0  # powers of two: no rounding


def in_odd_units(A, C):
    """A and C of balanced states and outputs, in x = T z, y = S w and seconds."""
    exact = [
        [[Fraction(float(entry)) for entry in row] for row in matrix]
        for matrix in (RATE * A * T[:, None] / T, C * S[:, None] / T)
    ]
    return GainProblem(lambda _: tuple(exact), POINT, 1)


@pytest.mark.parametrize("decay", [0.0, 4.0])
def test_two_states_in_odd_units_get_the_kalman_filter(decay):
    gain = synthesise(in_odd_units(OSCILLATOR, SEEN), cascade=True, decay=decay)
    X = solve_continuous_are((OSCILLATOR + decay / RATE * np.eye(2)).T, SEEN[:1].T, np.eye(2), np.eye(1))
    back = gain.L / T[:, None] * S / RATE
    np.testing.assert_allclose(
        back, X @ SEEN[:1].T * [1.0, 0.0], rtol=0, atol=2e-4
    )  # the root of 1e-8 at a flat minimum
    assert gain.L[:, 1].tolist() == [0.0, 0.0]
    # Q is the unit matrix in balanced units, up to one factor
    np.testing.assert_allclose(gain.Q * np.outer(T, T) / (gain.Q[0, 0] * T[0] ** 2), np.eye(2), rtol=1e-12, atol=0)


@pytest.mark.parametrize("cascade", [True, False])
def test_units_are_taken_back_exactly(cascade):
    """The scales are powers of two, so even the rounding to 12 digits sees the same numbers but for the last place."""
    A = OSCILLATOR - np.array([[0.5, 0.0], [0.0, 0.25]])
    odd = synthesise(in_odd_units(A, SEEN), cascade=cascade)
    plain = GainProblem(lambda _: ((A * 4).astype(int).tolist(), SEEN.astype(int).tolist()), POINT, 1)
    even = synthesise(plain, cascade=cascade)  # the rate is 4 here
    np.testing.assert_allclose(
        odd.L / T[:, None] * S / 2.0, even.L, rtol=1e-6, atol=1e-9
    )  # the solver's path, see above
    # V is counted in the map's output: P in 1 / T T', times S^2 per rate
    scale = S[1] ** 2 / np.outer(T, T)
    np.testing.assert_allclose(odd.P / scale * 2.0, even.P, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(odd.Q / scale, even.Q, rtol=1e-6, atol=1e-6)


def test_a_gain_of_nothing_is_proven_like_a_cascade():
    for problem in (one_state(), one_state(200, 1.0, 7.0)):
        given = certify_fixed_gain(problem, np.zeros((1, 1)))
        made = synthesise(problem, cascade=True)
        np.testing.assert_allclose([given.P, given.Q], [made.P, made.Q], rtol=CLOSE)
        assert given.L.tolist() == [[0.0]]


@pytest.mark.parametrize(("a", "c"), [(4.0, 3), (0.25, 3), (7.0, 200)])
@pytest.mark.parametrize(("epsilon", "root"), [((0.5, 0.5), 0.5), ((0.2, 0.8), 0.4), ((0.49, 0.49), 0.49)])
def test_how_large_a_given_gain_may_be_is_known(a, c, epsilon, root):
    # 2 P (a + L c) > 2 P L c / sqrt(eps_1 eps_2), whatever P: L c < a root / (1 - root)
    limit = a * root / (1.0 - root) / c
    gain = certify_fixed_gain(one_state(c, a, a), np.array([[0.9 * limit]]), epsilon)
    assert gain.L.tolist() == [[0.9 * limit]]
    assert (gain.eps_1, gain.eps_2) == epsilon
    with pytest.raises(NotProven, match=r"no matrices P and Q were found that prove the given gain .*infeasible"):
        certify_fixed_gain(one_state(c, a, a), np.array([[1.1 * limit]]), epsilon)


def test_a_given_gain_in_odd_units_is_proven_like_in_even_ones():
    A = OSCILLATOR - np.array([[0.5, 0.0], [0.0, 0.25]])
    plain = GainProblem(lambda _: ((A * 8).astype(int).tolist(), SEEN.astype(int).tolist()), POINT, 1)
    L = np.array([[4.0, -0.5], [2.0, 0.25]])
    even = certify_fixed_gain(plain, L)
    odd = certify_fixed_gain(in_odd_units(A, SEEN), L * T[:, None] / S)
    scale = S[1] ** 2 / np.outer(T, T)
    np.testing.assert_allclose(odd.P / scale, even.P, rtol=1e-5, atol=1e-5 * even.P.max())  # the solver's path
    np.testing.assert_allclose(odd.Q / scale, even.Q, rtol=1e-5, atol=0)


@pytest.mark.parametrize("L", [[[1.0, 1.0]], [[1.0], [1.0]], [1.0], [[np.nan]], [[np.inf]]])
def test_a_gain_that_does_not_fit_is_refused_before_anything_is_solved(L):
    with pytest.raises(DataError, match=r"expected \(1, 1\) with finite numbers"):
        certify_fixed_gain(one_state(), np.array(L))


def test_one_entry_that_is_no_number_is_enough_to_refuse_a_gain():
    with pytest.raises(DataError, match=r"L has the shape \(2, 2\)"):
        certify_fixed_gain(in_odd_units(OSCILLATOR, SEEN), np.array([[1.0, 0.0], [np.nan, 0.0]]))


@pytest.mark.parametrize("epsilon", [(1.25, 0.75), (0.75, 1.25), (1.5, 1.0), (0.0, 0.25), (-0.25, 0.25), (0.25, -0.25)])
def test_epsilon_outside_the_conditions_proves_nothing(epsilon):
    with pytest.raises(NotProven, match=r"eps_1|prove the given gain"):
        certify_fixed_gain(one_state(), np.zeros((1, 1)), epsilon)


@pytest.mark.parametrize("epsilon", [(0.5, 0.49), (1.25, 0.7), (0.01, 0.02)])
def test_epsilon_inside_the_conditions_is_kept(epsilon):
    gain = certify_fixed_gain(one_state(), np.zeros((1, 1)), epsilon)
    assert (gain.eps_1, gain.eps_2) == epsilon


def lying_solver(P, L):
    return lambda *_: lmi.LmiSolution(np.array([[P]]), np.array([[L]]), 0.25)


def test_what_a_solver_claims_is_not_believed(monkeypatch):
    monkeypatch.setattr(lmi, "free_gain", lying_solver(0.2, 0.0))  # 0.5 would do
    with pytest.raises(
        NotProven, match=r"does not pass the check in exact arithmetic .M is not negative definite at a = 4"
    ):
        synthesise(one_state(), cascade=True)
    monkeypatch.setattr(lmi, "fixed_gain", lying_solver(0.2, 0.0))
    with pytest.raises(NotProven, match="does not pass the check in exact arithmetic"):
        certify_fixed_gain(one_state(), np.zeros((1, 1)))


def test_a_gain_has_no_negative_zeros(monkeypatch):
    monkeypatch.setattr(lmi, "free_gain", lying_solver(0.5, -0.0))  # this one says the truth, with a sign
    assert not np.signbit(synthesise(one_state(), cascade=True).L).any()


def test_the_solver_sees_twelve_digits(monkeypatch):
    seen = []

    def refuses(*arguments):
        seen.extend(argument for argument in arguments[:3] if np.ndim(argument) > 1)
        return "no"

    problem = GainProblem(
        lambda _: ([[Fraction(-1, 3), Fraction(1, 7)], [Fraction(3, 11), -5]], [[1, Fraction(2, 3)]]), POINT, 0
    )
    monkeypatch.setattr(lmi, "free_gain", refuses)
    with pytest.raises(NotProven, match=r"no gain was found that can be proven .no. on"):
        synthesise(problem, cascade=True)
    monkeypatch.setattr(lmi, "fixed_gain", refuses)
    with pytest.raises(NotProven, match=r"prove the given gain .no. on"):
        certify_fixed_gain(problem, np.zeros((2, 1)))
    A, C, closed, _, row = seen
    for matrix in (A, C, closed, row):
        assert np.array_equal(matrix, np.round(matrix, 12))
        assert not np.array_equal(matrix, np.round(matrix, 11))


def edge_at(end):
    """One state that nothing sees, dx/dt = a x, with a from -1 to `end`, and one beside it that decays: a must be negative."""
    return GainProblem(lambda p: ([[p[0], 0], [0, -1]], [[0, 1]]), Region(("a",), (-1.0,), (end,)), 0)


def test_the_largest_part_ends_where_the_hidden_state_stops_to_decay():
    scale, gain = largest_feasible(edge_at(2.0), (-1.0,), cascade=False)  # -1 + 3 s < 0
    assert 1.0 / 3.0 - 0.01 <= scale < 1.0 / 3.0
    assert (gain.region.lower, gain.region.upper) == ((-1.0,), (-1.0 + scale * 3.0,))


@pytest.mark.parametrize(("resolution", "expected"), [(1.0, 0.0), (0.5, 0.0), (0.4, 0.25), (0.2, 0.25)])
def test_bisection_stops_at_the_resolution(resolution, expected, monkeypatch):
    monkeypatch.setattr(solve, "RESOLUTION", resolution)
    scale, _ = largest_feasible(edge_at(2.0), (-1.0,), cascade=True)
    assert scale == expected


def test_no_part_is_tried_twice(monkeypatch):
    solved, original = [], lmi.free_gain

    def counted(A, *others):
        solved.append(A)
        return original(A, *others)

    monkeypatch.setattr(lmi, "free_gain", counted)
    for resolution, parts in ((1.0, 2), (0.5, 3), (0.25, 4)):  # the whole, the centre, and so many halves
        solved.clear()
        monkeypatch.setattr(solve, "RESOLUTION", resolution)
        largest_feasible(edge_at(2.0), (-1.0,), cascade=True)
        assert len(solved) == parts


def test_a_region_that_can_be_had_is_not_shrunk():
    problem = edge_at(-0.25)
    scale, gain = largest_feasible(problem, (-0.5,), cascade=True)
    assert (scale, gain.region) == (1.0, problem.region)


def test_decay_holds_for_the_largest_part_too():
    scale, _ = largest_feasible(edge_at(2.0), (-1.0,), cascade=True, decay=0.25)
    assert 0.24 <= scale < 0.25  # -1 + 3 s + 0.25 < 0


def test_a_centre_without_a_gain_is_the_end_of_it():
    with pytest.raises(NotProven, match=r"on a \[0.5, 0.5\]"):
        largest_feasible(edge_at(2.0), (0.5,), cascade=True)
