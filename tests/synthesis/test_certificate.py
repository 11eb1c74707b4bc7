import subprocess
import sys
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from lpvobs.errors import DataError, UsageError
from lpvobs.synthesis.certificate import Gain, check
from lpvobs.synthesis.problem import GainProblem, bent_block
from lpvobs.synthesis.region import Region
from lpvobs.synthesis.solve import synthesise

ONE = np.ones((1, 1))


@pytest.fixture(scope="module")
def wide(diesel) -> GainProblem:
    return diesel("ETC", (280, 400), (300, 1200), clipped=True)


@pytest.fixture(scope="module")
def gain(wide) -> Gain:
    return synthesise(wide, cascade=False)


def verdict(problem, gain, **changes):
    g = replace(gain, **changes)
    return check(problem, g.L, g.P, g.Q, g.eps_1, g.eps_2)


def scalar_problem():
    return GainProblem(lambda p: ([[-p[0]]], [[1]]), Region(("a",), (1.0,), (2.0,)), 0)


def test_a_scalar_case_done_by_hand_is_exact_at_the_edge():
    # M < 0 with A = -1, C = L = P = 1: -4 + Q + 1/eps_1 + 1/eps_2 < 0; eps = (1/2, 1): Q < 1
    assert check(scalar_problem(), ONE, ONE, ONE * np.nextafter(1.0, 0.0), 0.5, 1.0).proven
    edge = check(scalar_problem(), ONE, ONE, ONE, 0.5, 1.0)
    assert not edge.proven
    assert edge.failed_vertex == (1.0,)
    assert edge.smallest_pivot <= 0.0


def test_the_sum_of_epsilon_decides_what_is_claimed():
    half = ONE * 0.5
    assert check(scalar_problem(), ONE, ONE, half, 0.5, 1.0).proven
    assert not check(scalar_problem(), ONE, ONE, half, 1.0, 1.0).proven
    assert not check(scalar_problem(), ONE, ONE, half, -0.5, 1.0).proven
    small = check(scalar_problem(), ONE * 0.1, ONE, ONE * 0.1, 0.1, 0.8)  # -2.2 + 0.1 + 0.1 + 1.25
    assert small.proven


def test_the_gain_is_proven_at_all_160_vertices(wide, gain):
    assert gain.certificate == verdict(wide, gain)
    assert gain.certificate.proven
    assert gain.certificate.vertices == 160
    assert 0.0 < gain.certificate.smallest_pivot <= 1.0


def inside(region, count, rng):
    box = rng.uniform(region.lower, region.upper, (20 * count, len(region.names)))
    return box[region.contains(box)][:count]


def test_inside_the_region_the_error_equations_lose_energy(wide, gain):
    """Eq. (30) with Psi = 1: F^T S + S F < 0, and still with the gain falling, written without M."""
    g_column = np.array([0.0, 0.0, 1.0])[:, None]
    for point in inside(wide.region, 300, np.random.default_rng(4)):
        A, C = (np.array(m, dtype=float) for m in wide.at([Fraction(v) for v in point]))
        gamma = 7.0
        F = np.block([[A - gain.L @ C, -gain.L @ g_column], [-gamma * C[2:], np.array([[-gamma]])]])
        S = np.block([[gain.P, np.zeros((3, 1))], [np.zeros((1, 3)), np.array([[1.0 / gamma]])]])
        rate = F.T @ S + S @ F
        for falling in (0.0, 1.0):
            rate[3, 3] += falling
            d = 1.0 / np.sqrt(-np.diag(rate))
            # scaled to a unit diagonal, so that rounding (1e-16) is far below the margin asked for
            assert np.linalg.eigvalsh(rate * np.outer(d, d)).max() < -1e-9


def test_a_gain_of_the_wrong_sign_is_refused_with_the_vertex(wide, gain):
    bad = verdict(wide, gain, L=-gain.L)
    assert not bad.proven
    assert bad.failed_vertex in [tuple(float(v) for v in vertex) for vertex in wide.region.vertices()]
    assert "rho_1 = " in bad.reason


@pytest.mark.parametrize("name", ["P", "Q"])
def test_tampered_matrices_are_refused(wide, gain, name):
    value = getattr(gain, name)
    lopsided = value.copy()
    lopsided[0, 1] = np.nextafter(lopsided[0, 1], np.inf)
    assert "not symmetric" in verdict(wide, gain, **{name: lopsided}).reason
    assert "not positive definite" in verdict(wide, gain, **{name: -value}).reason


@pytest.mark.parametrize("name", ["L", "P", "Q"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_none_are_unusable(wide, gain, name, value):
    broken = getattr(gain, name).copy()
    broken[1, 1] = value
    with pytest.raises(DataError):
        verdict(wide, gain, **{name: broken})


def test_wrong_shapes_and_epsilon_are_unusable(wide, gain):
    for changes in ({"L": gain.L.T[:2]}, {"P": gain.P[:2, :2]}, {"Q": gain.Q[0]}, {"eps_1": float("nan")}):
        with pytest.raises(DataError):
            verdict(wide, gain, **changes)


@pytest.mark.parametrize(
    ("system", "bent"),
    [
        (lambda p: ([[-(p[0] ** 2)]], [[1]]), ("x",)),
        (lambda p: ([[-p[1] / (4 + p[0])]], [[1]]), ("x",)),
        (lambda p: ([[-p[1] * p[2]]], [[1]]), ("y", "z")),
        (lambda p: ([[-p[0] * p[1] - p[0] * p[2]]], [[p[2]]]), None),
    ],
)
def test_a_system_whose_vertices_prove_nothing_is_found(system, bent):
    region = Region(("x", "y", "z"), (0.0, -1.0, 0.0), (1.0, 2.0, 3.0), (("y", "z"),))
    problem = GainProblem(system, region, 0)
    assert bent_block(problem) == bent
    if bent is not None:
        assert "a check at the vertices proves nothing" in check(problem, ONE, ONE, ONE, 0.5, 0.5).reason


@pytest.mark.parametrize(
    ("system", "output"),
    [
        (lambda p: ([[-0.5 * float(p[0])]], [[1]]), 0),
        (lambda p: ([[-p[0], 0]], [[1]]), 0),
        (lambda p: ([[-p[0]]], [[1, 1]]), 0),
        (lambda p: ([[-p[0]]], [[1]]), 1),
    ],
)
def test_an_inexact_or_misshapen_system_is_refused(system, output):
    with pytest.raises(UsageError):
        check(GainProblem(system, Region(("a",), (1.0,), (2.0,)), output), ONE, ONE, ONE, 0.5, 0.5)


def test_checking_needs_neither_solver_nor_scipy():
    code = (
        "import sys; import lpvobs.synthesis.certificate, lpvobs.synthesis.certificate; "
        "print([name for name in ('cvxpy', 'scipy', 'clarabel') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def minus_M(A, C, m, L, P, Q, eps_1, eps_2):
    """Eq. (27) in floats, with the sign that makes it positive definite."""
    closed, column, row = A - L @ C, P @ L[:, [m]], C[[m]]
    corner = np.diag([eps_1, eps_2])
    side = np.hstack((column, row.T))
    return -np.block([[closed.T @ P + P @ closed + Q, side], [side.T, -corner]])


def pivots(matrix):
    """Pivots over diagonal entries from a Cholesky factor."""
    return np.diag(np.linalg.cholesky(matrix)) ** 2 / np.diag(matrix)


def constant(A, C, m):
    return GainProblem(lambda _: (A.tolist(), C.tolist()), Region(("a",), (1.0,), (1.0,)), m)


def whole_plant(seed):
    """Three states in whole numbers, diagonally dominant, two outputs; a small gain, and P and Q of no shape in particular."""
    rng = np.random.default_rng(seed)
    A = rng.integers(-3, 4, (3, 3)) - 20 * np.eye(3, dtype=int)
    root = rng.standard_normal((2, 3, 3))
    P, Q = 4.0 * np.eye(3) + 0.1 * (root + root.swapaxes(1, 2))
    return A, rng.integers(-2, 3, (2, 3)), 0.3 * rng.standard_normal((3, 2)), P, Q


@pytest.mark.parametrize("map_output", [0, 1])
@pytest.mark.parametrize("seed", range(4))
def test_the_smallest_pivot_is_that_of_the_theorem_s_matrices(seed, map_output):
    A, C, L, P, Q = whole_plant(seed)
    found = check(constant(A, C, map_output), L, P, Q, 0.6, 0.7)
    least = min(pivots(m).min() for m in (P, Q, minus_M(A, C, map_output, L, P, Q, 0.6, 0.7)))
    assert found.proven
    assert (found.vertices, found.failed_vertex, found.reason) == (1, None, "")
    assert found.smallest_pivot == pytest.approx(least, rel=1e-12)  # the floats' rounding


@pytest.mark.parametrize("seed", range(4))
def test_the_verdict_turns_where_an_eigenvalue_does(seed):
    A, C, L, P, Q = whole_plant(seed)
    verdicts = []
    for eps_1 in np.geomspace(0.003, 1.0, 20):
        proven = check(constant(A, C, 1), L, P, Q, eps_1, 0.7).proven
        assert proven == (np.linalg.eigvalsh(minus_M(A, C, 1, L, P, Q, eps_1, 0.7)).min() > 0.0)
        verdicts.append(proven)
    assert verdicts == sorted(verdicts)  # more eps_1, more room
    assert set(verdicts) == {False, True}


def test_pivots_of_one_state_by_hand():
    # A = -a, C = L = P = 1, Q = 1/2: the first entry is 2 a + 3/2; eps = (1/2, 1). At a = 1 the pivots over their diagonals are
    # 1, (1/2 - 2/7) / (1/2) = 3/7, and 1 - 1 / (7/2 - 2) = 1/3; at a = 2 they are larger.
    found = check(scalar_problem(), ONE, ONE, ONE * 0.5, 0.5, 1.0)
    assert found.smallest_pivot == pytest.approx(1.0 / 3.0, rel=1e-15)  # a fraction, rounded once
    assert (found.vertices, found.failed_vertex, found.reason) == (2, None, "")


def test_the_least_pivot_may_be_that_of_P_or_of_Q():
    A, C, L = np.array([[-108, 100], [100, -108]]), np.eye(2, dtype=int), np.zeros((2, 2))  # damps what P sees least
    narrow = np.array([[1.0, 0.9375], [0.9375, 1.0]])  # second pivot 1 - 225/256
    for P, Q in ((narrow, 0.125 * np.eye(2)), (np.eye(2), 0.125 * narrow)):
        assert check(constant(A, C, 0), L, P, Q, 0.5, 0.9).smallest_pivot == pytest.approx(31 / 256, rel=1e-15)


@pytest.mark.parametrize(
    ("eps_1", "eps_2", "reason"),
    [
        (0.0, 1.0, "eps_1 and eps_2 must be positive"),
        (1.0, 0.0, "eps_1 and eps_2 must be positive"),
        (-0.25, 0.5, "eps_1 and eps_2 must be positive"),
        (0.5, -0.25, "eps_1 and eps_2 must be positive"),
        (1.25, 0.75, "2 - eps_1 - eps_2 > 0 does not hold"),
        (0.75, 1.5, "2 - eps_1 - eps_2 > 0 does not hold"),
    ],
)
def test_epsilon_outside_the_conditions_proves_nothing(eps_1, eps_2, reason):
    found = check(scalar_problem(), ONE, ONE, ONE * 0.1, eps_1, eps_2)
    assert not found.proven
    assert found.reason == reason
    assert (found.vertices, found.smallest_pivot, found.failed_vertex) == (2, 0.0, None)


@pytest.mark.parametrize(("eps_1", "eps_2"), [(0.5, 0.5), (0.25, 1.5), (1.25, 0.25), (1.0, np.nextafter(1.0, 0.0))])
def test_a_sum_of_epsilon_under_two_is_enough(eps_1, eps_2):
    # A small gain and a large P leave room for any of these.
    assert check(scalar_problem(), ONE * 2.0**-6, ONE * 8.0, ONE, eps_1, eps_2).proven


def test_the_first_vertex_that_fails_is_named():
    problem = GainProblem(lambda p: ([[p[0] - p[1]]], [[1]]), Region(("a", "b"), (-4.0, 0.5), (3.0, 2.0)), 0)
    found = check(problem, ONE * 0.0, ONE, ONE * 0.125, 0.9, 0.9)
    assert found.failed_vertex == (3.0, 0.5)
    assert found.reason == "M is not negative definite at a = 3, b = 0.5"
    assert found.smallest_pivot == -1.0  # the entry itself is negative
    assert found.vertices == 4


def test_no_vertex_is_named_where_P_or_Q_fails():
    A, C = -8 * np.eye(2, dtype=int), np.eye(2, dtype=int)
    flat, good = np.ones((2, 2)), np.eye(2)
    for name, P, Q in (("P", flat, good), ("Q", good, flat), ("P", flat, flat)):
        found = check(constant(A, C, 0), np.zeros((2, 2)), P, Q, 0.5, 0.9)
        assert (found.proven, found.smallest_pivot, found.failed_vertex) == (False, 0.0, None)
        assert found.reason == f"{name} is not positive definite"


@pytest.mark.parametrize(
    ("P", "Q", "name"), [([[1, 0.5], [0.25, 1]], [[1, 0], [0, 1]], "P"), ([[1, 0], [0, 1]], [[1, 0], [1, 2]], "Q")]
)
def test_lopsided_matrices_are_named(P, Q, name):
    A, C = -8 * np.eye(2, dtype=int), np.eye(2, dtype=int)
    found = check(constant(A, C, 0), np.zeros((2, 2)), np.array(P, dtype=float), np.array(Q, dtype=float), 0.5, 0.9)
    assert (found.proven, found.reason, found.smallest_pivot) == (False, f"{name} is not symmetric", 0.0)


def test_a_system_that_bends_is_refused_by_the_names_of_what_bends_it():
    region = Region(("x", "y", "z"), (1.0, 1.0, 1.0), (2.0, 2.0, 2.0), (("y", "z"),))
    found = check(GainProblem(lambda p: ([[-p[1] * p[2]]], [[1]]), region, 0), ONE * 0, ONE, ONE * 0.1, 0.9, 0.9)
    assert (found.proven, found.smallest_pivot, found.vertices) == (False, 0.0, 8)
    assert found.reason == "the system is not affine in y and z, so a check at the vertices proves nothing"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"L": np.ones((1, 2))}, "L has the shape \\(1, 2\\), expected \\(1, 1\\)"),
        ({"P": np.ones((2, 2))}, "P has the shape"),
        ({"Q": np.ones(1)}, "Q has the shape \\(1,\\)"),
        ({"L": ONE * np.nan}, "L has NaN or infinity in it"),
        ({"P": ONE * np.inf}, "P has NaN or infinity in it"),
        ({"Q": -ONE * np.inf}, "Q has NaN or infinity in it"),
        ({"eps_1": np.inf}, "eps_1 = inf, eps_2 = 0.5, expected finite"),
        ({"eps_2": np.nan}, "eps_1 = 0.5, eps_2 = nan, expected finite"),
    ],
)
def test_the_refusal_of_numbers_says_why(changes, words):
    numbers = {"L": ONE, "P": ONE, "Q": ONE, "eps_1": 0.5, "eps_2": 0.5} | changes
    with pytest.raises(DataError, match=words):
        check(scalar_problem(), **numbers)


def test_one_entry_that_is_no_number_is_enough():
    A, C, eye = -8 * np.eye(2, dtype=int), np.eye(2, dtype=int), np.eye(2)
    with pytest.raises(DataError, match="P has NaN"):
        check(constant(A, C, 0), 0 * eye, np.array([[1.0, 0.0], [0.0, np.nan]]), eye, 0.5, 0.5)
