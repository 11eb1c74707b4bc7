from fractions import Fraction

import numpy as np
import pytest
from reference.hurwitz import poles
from scipy.linalg import solve_continuous_are

from lpvobs.errors import DataError, NotProven
from lpvobs.synthesis.balance import balance
from lpvobs.synthesis.certificate import check
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region
from lpvobs.synthesis.solve import certify_fixed_gain, largest_feasible, synthesise

WARM = {"T_im": (280.0, 400.0), "T_em": (300.0, 1200.0)}


@pytest.mark.parametrize("column", ["ETC", "FTP75", "NEDC", "hull"])
@pytest.mark.parametrize("cascade", [False, True])
@pytest.mark.slow
def test_the_paper_s_outputs_suffice_at_nominal_temperatures(diesel, column, cascade):
    problem = diesel(column)
    gain = synthesise(problem, cascade=cascade)
    assert gain.certificate.vertices == 32
    assert poles(problem, gain.L).real.max() < 0.0


@pytest.mark.parametrize(
    ("cascade", "column", "options", "vertices"),
    [
        pytest.param(cascade, *case, marks=() if quick else pytest.mark.proof)
        for cascade in (False, True)
        for quick, *case in (
            (True, "ETC", {"clipped": True}, 160),
            (False, "ETC", {"p_em": True}, 128),
            (cascade, "hull", {"p_em": True}, 128),
            (not cascade, "FTP75", {}, 128),
            (False, "NEDC", {}, 128),
        )
    ],
)
@pytest.mark.slow
def test_wide_temperatures_are_covered_where_they_can_be(diesel, cascade, column, options, vertices):
    problem = diesel(column, **WARM, **options)
    gain = synthesise(problem, cascade=cascade)
    assert gain.certificate.vertices == vertices
    # Moderate: the published L_11 alone is 1636 1/s, its fastest pole near -1700 1/s at nominal temperatures.
    assert -500.0 < poles(problem, gain.L).real.min() < poles(problem, gain.L).real.max() < 0.0


def left_for_P(problem):
    """The (2, 2) entry of Eq. (27), which no L reaches: lower and upper bound of P12/P22 that it leaves (in Pa/Pa)."""
    low, high = 0.0, np.inf
    for _, r2, _, r4, _, a_1, a_2 in np.array(problem.region.vertices(), dtype=float):
        limit = a_2 * (r2 + r4) / (a_1 * r2)
        low, high = (low, min(high, limit)) if r2 > 0 else (max(low, limit), high)
    return low, high


@pytest.mark.parametrize("cascade", [False, True])
def test_the_etc_box_from_three_outputs_is_refused_and_cannot_be_had(diesel, cascade):
    problem = diesel("ETC", **WARM)
    low, high = left_for_P(problem)
    assert low > high  # so no P, no Q, no L
    with pytest.raises(NotProven, match="no gain was found that can be proven") as refusal:
        synthesise(problem, cascade=cascade)
    assert "\n" not in str(refusal.value)


@pytest.mark.slow
def test_the_largest_part_of_the_etc_box_ends_where_it_must(diesel, monkeypatch):
    resolution = 0.05  # five regions are tried, and not seven
    monkeypatch.setattr("lpvobs.synthesis.solve.RESOLUTION", resolution)
    problem, nominal = diesel("ETC", **WARM), diesel("ETC").region
    centre = [(low + high) / 2 for low, high in zip(nominal.lower, nominal.upper, strict=True)]
    scale, gain = largest_feasible(problem, centre, cascade=True)
    assert gain.certificate.proven
    assert gain.region == problem.region.scaled(scale, centre)
    for share, feasible in ((scale, True), (scale + resolution, False)):
        low, high = left_for_P(GainProblem(problem.system, problem.region.scaled(share, centre), 2))
        assert (low < high) == feasible


def test_a_feasible_region_is_not_shrunk(diesel):
    problem = diesel("NEDC")
    scale, gain = largest_feasible(problem, problem.region.lower, cascade=True)
    assert (scale, gain.region) == (1.0, problem.region)


def test_no_part_is_feasible_where_the_centre_is_not():
    unseen = GainProblem(lambda p: ([[p[0], 0], [0, -1]], [[0, 1]]), Region(("a",), (1.0,), (2.0,)), 0)
    with pytest.raises(NotProven):
        largest_feasible(unseen, (1.0,), cascade=False)


def test_a_cascade_ignores_the_map_and_any_eps_1_will_do(diesel):
    problem = diesel("ETC", **WARM, p_em=True)
    gain = synthesise(problem, cascade=True)
    assert gain.L[:, 3].tolist() == [0.0, 0.0, 0.0]
    assert check(problem, gain.L, gain.P, gain.Q, 1e-12, gain.eps_2).proven


def test_a_constant_system_gets_the_kalman_filter(diesel):
    etc = diesel("ETC")
    point = (*etc.region.lower[:4], 1.5, *etc.region.lower[5:])
    problem = GainProblem(etc.system, Region(etc.region.names, point, point), 2)
    A, C = problem.matrices()
    units = balance(A, C)
    T, S, rate = units.states, units.outputs, units.rate
    A_z, C_z = A[0] * T / T[:, None] / rate, (C[0] * T / S[:, None])[:2]
    X = solve_continuous_are(A_z.T, C_z.T, np.eye(3), np.eye(2))
    expected = X @ C_z.T * T[:, None] / S[:2] * rate
    L = synthesise(problem, cascade=True).L
    # The solver stops at 1e-8 of the cost; at a minimum the gain is then known to its root, 1e-4.
    np.testing.assert_allclose(L[:, :2] * S[:2] / T[:, None], expected * S[:2] / T[:, None], rtol=0, atol=1e-4 * rate)


def random_plant(seed):
    """Two or three states, two parameters, sparse, stable or not; outputs may see nothing."""
    rng = np.random.default_rng(seed)
    n, r = (int(rng.integers(2, 4)) for _ in range(2))
    A = [np.where(rng.random((n, n)) < 0.7, rng.integers(-40, 41, (n, n)) / 8, 0.0) for _ in range(3)]
    C = [np.where(rng.random((r, n)) < share, rng.integers(-16, 17, (r, n)) / 8, 0.0) for share in (0.6, 0.2, 0.2)]
    return A, C, rng


def rescaled(A, C, T, S, map_output):
    """The plant in states T x and outputs S y, exactly."""
    t, s = ([Fraction(float(v)) for v in values] for values in (T, S))

    def mix(matrices, weights, left):
        return [
            [
                sum(w * Fraction(float(m[i, j])) for w, m in zip(weights, matrices, strict=True)) * left[i] / t[j]
                for j in range(len(t))
            ]
            for i in range(len(left))
        ]

    region = Region(("p", "q"), (-0.2, -0.2), (0.3, 0.2))
    return GainProblem(lambda p: (mix(A, (1, *p), t), mix(C, (1, *p), s)), region, map_output)


def attempt(problem, **options):
    try:
        return synthesise(problem, **options)
    except NotProven:
        return None


@pytest.mark.slow
def test_units_change_neither_verdict_nor_gain():
    verdicts = []
    for seed in range(30):
        A, C, rng = random_plant(seed)
        n, r = C[0].T.shape
        options = {"cascade": seed % 2 > 0}
        plain = attempt(rescaled(A, C, np.ones(n), np.ones(r), r - 1), **options)
        T, S = 10.0 ** rng.uniform(-6, 6, n), 10.0 ** rng.uniform(-6, 6, r)
        other = attempt(rescaled(A, C, T, S, r - 1), **options)
        assert (plain is None) == (other is None)
        verdicts.append(plain is not None)
        if plain is not None:
            # The solver sees 12 digits, so rounding in other units rarely reaches it, and then moves it little.
            back = other.L / T[:, None] * S
            np.testing.assert_allclose(back, plain.L, rtol=0, atol=1e-8 * np.abs(plain.L).max())
    assert 3 <= sum(verdicts) <= 27  # both verdicts occur


@pytest.mark.slow
def test_units_do_not_matter_to_the_diesel(diesel):
    problem = diesel("ETC", **WARM, p_em=True)
    T, S = [Fraction(1e-6), Fraction(1e6), Fraction(3e-3)], [Fraction(1e6), Fraction(1e-6), Fraction(7), Fraction(1e5)]

    def system(p):
        A, C = problem.system(p)
        return (
            [[entry * T[i] / T[j] for j, entry in enumerate(row)] for i, row in enumerate(A)],
            [[entry * S[i] / T[j] for j, entry in enumerate(row)] for i, row in enumerate(C)],
        )

    plain = synthesise(problem, cascade=False)
    other = synthesise(GainProblem(system, problem.region, 3), cascade=False)
    back = other.L / np.array(T, dtype=float)[:, None] * np.array(S, dtype=float)
    np.testing.assert_allclose(back, plain.L, rtol=1e-6)  # as above, small entries relative to themselves


@pytest.mark.slow
def test_every_synthesised_gain_is_certified_as_a_given_one(diesel):
    for column, cascade in (("ETC", True), ("FTP75", False)):
        problem = diesel(column)
        gain = synthesise(problem, cascade=cascade)
        assert certify_fixed_gain(problem, gain.L).certificate.proven


def test_a_given_gain_must_fit(diesel):
    for L in (np.ones((3, 2)), np.full((3, 3), np.nan)):
        with pytest.raises(DataError):
            certify_fixed_gain(diesel("NEDC"), L)
