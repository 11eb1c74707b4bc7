"""The observer with the sensor's state: proven where it is stable, refused where it is not, and no solver near."""

from fractions import Fraction

import numpy as np
import pytest

from lpvobs.errors import NotProven
from lpvobs.synthesis.certificate import Certificate, Gain
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region
from lpvobs.synthesis.sensor_state import augmented, prove, with_sensor_state
from lpvobs.synthesis.solve import synthesise

TAU = (0.05, 0.12)  # s


@pytest.fixture(scope="module")
def cascade(diesel):
    problem = diesel("FTP75", p_em=True)
    return problem, synthesise(problem, cascade=True, decay=100.0)


def test_four_states_are_proven_and_the_sensor_corrects_its_own_alone(cascade):
    problem, gain = cascade
    found = with_sensor_state(problem, gain, TAU, 40.0)
    assert found.vertices == 2 * len(problem.region.vertices())
    assert found.smallest_pivot > 0.0
    assert np.array_equal(found.L[:3], gain.L)
    assert list(found.L[3]) == [0.0, 0.0, 0.0, 40.0]
    assert prove(problem, found.L, found.P, TAU).smallest_pivot == found.smallest_pivot  # from the numbers alone


def test_the_closed_loop_is_stable_inside_the_region_too(cascade):
    problem, gain = cascade
    found = with_sensor_state(problem, gain, TAU, 0.0)
    rng = np.random.default_rng(2)
    lower, upper = np.array(problem.region.lower), np.array(problem.region.upper)
    for _ in range(50):
        parameters = lower + rng.random(lower.size) * (upper - lower)
        A, C = (np.array(part, dtype=float) for part in problem.system(parameters))
        tau = rng.uniform(*TAU)
        A_4, C_4 = np.zeros((4, 4)), np.zeros((4, 4))
        A_4[:3, :3], A_4[3, :3], A_4[3, 3] = A, C[3] / tau, -1.0 / tau
        C_4[:3, :3], C_4[3, 3] = C[:3], 1.0
        assert np.linalg.eigvals(A_4 - found.L @ C_4).real.max() < 0.0


def test_numbers_that_prove_nothing_are_refused(cascade):
    problem, gain = cascade
    found = with_sensor_state(problem, gain, TAU, 40.0)
    heavy = found.P.copy()
    heavy[3, 3] *= 1e6  # the sensor's error now outweighs what the others take away
    with pytest.raises(NotProven, match="the Lyapunov function does not decrease at rho_1 = "):
        prove(problem, found.L, heavy, TAU)
    with pytest.raises(NotProven, match="the Lyapunov function does not decrease"):
        prove(problem, -found.L, found.P, TAU)


def test_a_sensor_that_corrects_the_engine_is_refused(cascade):
    problem, gain = cascade
    L = gain.L.copy()
    L[0, 3] = 1.0
    other = Gain(L, gain.P, gain.Q, gain.eps_1, gain.eps_2, gain.region, gain.certificate)
    with pytest.raises(NotProven, match="set cascade = true"):
        with_sensor_state(problem, other, TAU, 40.0)


def engine(entries, outputs, map_output):
    """States that decay at the rates given, the first of them a parameter between 1 and 2 1/s; a whole-number C."""
    region = Region(("a",), (1.0,), (2.0,))

    def system(p):
        rates = [p[0], *entries]
        return [[-rate if i == j else 0 for j in range(len(rates))] for i, rate in enumerate(rates)], outputs

    return GainProblem(system, region, map_output)


def made(problem, L, P):
    n = len(P)
    unused = Certificate(True, 2, 1.0, None, "")
    return Gain(np.array(L), np.array(P), np.eye(n), 0.4, 0.4, problem.region, unused)


ALONE = engine([], [[2]], 0)  # one state that decays at a, and a flow of twice that state


def test_one_state_and_its_sensor_by_hand():
    # With P = 3: -dV = [[6 a, -2 k / tau], [-2 k / tau, 2 k (1/tau + l)]]. At a = 1 and 1/tau = 10 it allows k < 0.45 for l = 5;
    # taken is half of it, and the second pivot is then half of its diagonal entry. At the other vertices more is left.
    found = with_sensor_state(ALONE, made(ALONE, [[0.0]], [[3.0]]), (0.1, 0.5), 5.0)
    np.testing.assert_allclose(found.P, [[3.0, 0.0], [0.0, 0.225]], rtol=1e-14)  # rounding
    assert found.L.tolist() == [[0.0], [5.0]]
    assert found.vertices == 4
    assert found.smallest_pivot == pytest.approx(0.5, rel=1e-12)  # rounding
    assert found.tau == (0.1, 0.5)


def test_two_states_and_a_sensor_by_hand():
    # closed: -(a + 4) and -3; driven by (2, 1): 4 / (2 * 5) + 1 / (2 * 3 * 3) = 41/90; times 100 / (2 * 15): k = 1/2 of 270/410
    problem = engine([3], [[1, 0], [2, 1], [0, 0]], 1)
    gain = made(problem, [[4.0, 0.0, 7.0], [0.0, 0.0, -1.0]], [[1.0, 0.0], [0.0, 3.0]])
    found = with_sensor_state(problem, gain, (0.1, 0.5), 5.0)
    np.testing.assert_allclose(found.P, np.diag([1.0, 3.0, 27.0 / 82.0]), rtol=1e-14)  # rounding
    assert found.L.tolist() == [[4.0, 0.0, 7.0], [0.0, 0.0, -1.0], [0.0, 5.0, 0.0]]
    assert found.smallest_pivot == pytest.approx(0.5, rel=1e-12)  # rounding


def test_a_full_P_by_hand():
    # P (A - L C) = -[[2 a, 3], [a, 9]], so V loses [[4 a, 3 + a], [3 + a, 18]]; at a = 1 its inverse begins with 18/56, and
    # 18/56 times 100 / (2 * 15) is 15/14.
    problem = engine([3], [[1, 0], [1, 0]], 1)
    found = with_sensor_state(problem, made(problem, np.zeros((2, 2)), [[2.0, 1.0], [1.0, 3.0]]), (0.1, 0.5), 5.0)
    np.testing.assert_allclose(
        found.P, [[2.0, 1.0, 0.0], [1.0, 3.0, 0.0], [0.0, 0.0, 7.0 / 15.0]], rtol=1e-14
    )  # rounding


def test_a_sensor_that_hears_of_no_state_is_proven_with_any_weight():
    deaf = engine([], [[0]], 0)
    found = with_sensor_state(deaf, made(deaf, [[0.0]], [[3.0]]), (0.1, 0.5), 0.0)
    assert found.P[1, 1] > 0.0
    assert found.smallest_pivot == 1.0  # nothing is coupled


def test_the_four_states_by_hand():
    problem = GainProblem(lambda p: ([[-p[0], 2], [0, -3]], [[1, 0], [5, 7]]), Region(("a",), (1.0,), (2.0,)), 1)
    A, C = augmented(problem, (Fraction(3, 2),), Fraction(1, 4))
    assert [
        [[Fraction(-3, 2), 2, 0], [0, -3, 0], [Fraction(5, 4), Fraction(7, 4), Fraction(-1, 4)]],
        [[1, 0, 0], [0, 0, 1]],
    ] == [A.tolist(), C.tolist()]
    assert all(isinstance(entry, Fraction | int) for matrix in (A, C) for row in matrix for entry in row)


def test_the_proof_is_exact_at_its_edge():
    # P = C = a = tau = 1, l = 0: -dV = [[2, -k], [-k, 2 k]], definite for k < 4
    problem = GainProblem(lambda p: ([[-p[0]]], [[1]]), Region(("a",), (1.0,), (1.0,)), 0)
    L = np.zeros((2, 1))
    proven = prove(problem, L, np.diag([1.0, np.nextafter(4.0, 0.0)]), (1.0, 1.0))
    assert 0.0 < proven.smallest_pivot < 1e-15
    assert proven.vertices == 2
    with pytest.raises(NotProven, match="the Lyapunov function does not decrease at a = 1 with tau = 1 s"):
        prove(problem, L, np.diag([1.0, 4.0]), (1.0, 1.0))


@pytest.mark.parametrize(
    ("row", "weight", "words"),
    [
        (-3.0, 0.01, "a = 1 with tau = 0.5 s"),  # 1/tau + l is negative for the slow sensor alone
        (0.0, 0.5, "a = 1 with tau = 0.1 s"),  # k < 0.3 is allowed there, and k < 1.5 at the other end
        (-20.0, 0.01, "a = 1 with tau = 0.5 s"),  # the slow sensor is looked at first
    ],
)
def test_either_end_of_the_time_constants_can_fail(row, weight, words):
    with pytest.raises(NotProven, match=f"sensor state: the Lyapunov function does not decrease at {words}"):
        prove(ALONE, np.array([[0.0], [row]]), np.diag([3.0, weight]), (0.1, 0.5))


def test_the_second_vertex_can_fail_alone():
    problem = GainProblem(lambda p: ([[p[0] - 2]], [[1]]), Region(("a",), (1.0,), (3.0,)), 0)
    with pytest.raises(NotProven, match=r"a = 3 with tau = 0\.5 s"):
        prove(problem, np.zeros((2, 1)), np.diag([1.0, 1e-3]), (0.1, 0.5))


def test_a_P_that_is_not_positive_proves_nothing():
    for P in (np.diag([3.0, -0.1]), np.diag([-3.0, 0.1])):
        with pytest.raises(NotProven):
            prove(ALONE, np.array([[0.0], [5.0]]), P, (0.1, 0.5))


def test_the_least_pivot_may_be_that_of_P():
    # P has the second pivot 31/256. Damped as strongly as it is, what V loses is further from its edge.
    P = np.array([[1.0, 0.9375], [0.9375, 1.0]])
    problem = GainProblem(lambda _: ([[-1]], [[0]]), Region(("a",), (1.0,), (1.0,)), 0)
    found = prove(problem, np.array([[0.0], [0.0]]), P, (1.0, 1.0))  # -dV = 2 P
    assert found.smallest_pivot == pytest.approx(31.0 / 256.0, rel=1e-15)


@pytest.mark.parametrize("row", [0, 1])
def test_a_single_entry_makes_it_no_cascade(row):
    problem = engine([3], [[1, 0], [2, 1]], 1)
    L = np.zeros((2, 2))
    L[row, 1] = 1e-12
    with pytest.raises(NotProven, match="set cascade = true"):
        with_sensor_state(problem, made(problem, L, np.eye(2)), (0.1, 0.5), 5.0)
