import subprocess
import sys
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from lpvobs.errors import DataError, UsageError
from lpvobs.synthesis.certificate import check
from lpvobs.synthesis.gain import Gain
from lpvobs.synthesis.problem import Problem, bent_block
from lpvobs.synthesis.region import Region
from lpvobs.synthesis.solve import synthesise

ONE = np.ones((1, 1))


@pytest.fixture(scope="module")
def wide(diesel) -> Problem:
    return diesel("ETC", (280, 400), (300, 1200), clipped=True)


@pytest.fixture(scope="module")
def gain(wide) -> Gain:
    return synthesise(wide, falling_gain=True, cascade=False)


def verdict(problem, gain, **changes):
    g = replace(gain, **changes)
    return check(problem, g.L, g.P, g.Q, g.eps_1, g.eps_2, falling_gain=True)


def scalar_problem():
    return Problem(lambda p: ([[-p[0]]], [[1]]), Region(("a",), (1.0,), (2.0,)), 0)


def test_a_scalar_case_done_by_hand_is_exact_at_the_edge():
    # M < 0 with A = -1, C = L = P = 1: -4 + Q + 1/eps_1 + 1/eps_2 < 0; eps = (1/2, 1): Q < 1
    assert check(scalar_problem(), ONE, ONE, ONE * np.nextafter(1.0, 0.0), 0.5, 1.0).proven
    edge = check(scalar_problem(), ONE, ONE, ONE, 0.5, 1.0)
    assert not edge.proven
    assert edge.failed_vertex == (1.0,)
    assert edge.smallest_pivot <= 0.0


def test_the_sum_of_epsilon_decides_what_is_claimed():
    half = ONE * 0.5
    assert not check(scalar_problem(), ONE, ONE, half, 0.5, 1.0).falling_gain
    assert not check(scalar_problem(), ONE, ONE, half, 0.5, 1.0, falling_gain=True).proven
    assert not check(scalar_problem(), ONE, ONE, half, 1.0, 1.0).proven
    assert not check(scalar_problem(), ONE, ONE, half, -0.5, 1.0).proven
    small = check(scalar_problem(), ONE * 0.1, ONE, ONE * 0.1, 0.1, 0.8)  # -2.2 + 0.1 + 0.1 + 1.25
    assert small.proven
    assert small.falling_gain


def test_the_gain_is_proven_at_all_160_vertices(wide, gain):
    assert gain.certificate == verdict(wide, gain)
    assert gain.certificate.proven
    assert gain.certificate.vertices == 160
    assert 0.0 < gain.certificate.smallest_pivot <= 1.0
    assert gain.certificate.falling_gain


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
    assert not bad.falling_gain


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
    problem = Problem(system, region, 0)
    assert bent_block(problem) == bent
    if bent is not None:
        assert "vertices prove nothing" in check(problem, ONE, ONE, ONE, 0.5, 0.5).reason


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
        check(Problem(system, Region(("a",), (1.0,), (2.0,)), output), ONE, ONE, ONE, 0.5, 0.5)


def test_checking_needs_neither_solver_nor_scipy():
    code = (
        "import sys; import lpvobs.synthesis.certificate, lpvobs.synthesis.gain, lpvobs.synthesis.published; "
        "print([name for name in ('cvxpy', 'scipy', 'clarabel') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
