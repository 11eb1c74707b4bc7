"""The compiled recursion: equal to Eq. (26) in full, right in every special case, and a contraction where that is proven."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import adaptive_observer as dense
from reference.drives import scattered
from reference.membership import psi

from lpvobs.engines.base import Trajectory
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.maps.grid import Grid
from lpvobs.observer.recursion import observe
from lpvobs.observer.step import Sample, error_matrix
from lpvobs.synthesis.problem import GainProblem
from lpvobs.synthesis.region import Region

GRID = Grid(np.array([0.0, 8.0, 20.0, 30.0, 56.0]), np.array([500.0, 1200.0, 2000.0, 4000.0]))
FOUR = ("p_im", "p_em", "omega_t")  # measured states; the sensor comes last
L_FOUR = np.array([[160.0, -3.0, 2.0, 4e4], [10.0, 150.0, -1.0, -2e4], [0.01, 0.02, 140.0, 3e3]])
STEADY = np.array([1.5e5, 1.8e5, 9000.0])


def rows_of(log):
    return [psi(GRID.fuel, GRID.speed, u, n) for u, n in zip(log["u_delta"], log["n_e"], strict=True)]


def point_of(log):
    return log["u_delta"], log["n_e"]


def run(log, trajectory, L, gamma, x_0, theta_0, segments=None):
    segments = segments or log.segments
    return observe(trajectory, log.time, segments, point_of(log), GRID, L, gamma, np.atleast_2d(x_0), theta_0)


def exact_plant(log, trajectory, theta, x_0):
    """Return the outputs and states of a plant that is itself stepped by backward Euler: no truncation is left."""
    x, states = np.array(x_0), []
    for k in range(len(log)):
        h = log.time[k] - log.time[k - 1] if k else 0.0
        x = np.linalg.solve(np.eye(3) - h * trajectory.A[k], x + h * trajectory.E[k])
        states.append(x)
    states = np.array(states)
    y = np.einsum("krj,kj->kr", trajectory.C, states)
    y[:, -1] += np.array(rows_of(log)) @ theta
    return states, Trajectory(trajectory.parameters, trajectory.A, trajectory.E, trajectory.C, y)


@pytest.mark.parametrize(
    ("outputs", "L", "gamma"),
    [
        (FOUR, L_FOUR, 200.0),
        (FOUR, L_FOUR, 0.5),
        (("p_im", "omega_t"), PUBLISHED.L, 200.0),
        (("p_im", "omega_t"), PUBLISHED.L, 0.0),
    ],
)
def test_eq_26_and_eq_36_are_equal(air_path, outputs, L, gamma):
    log = scattered(21, 400)
    rng = np.random.default_rng(22)
    trajectory = air_path.trajectory(log, outputs)
    theta_0, x_0 = 0.01 * rng.standard_normal(GRID.size), STEADY
    fast = run(log, trajectory, L, gamma, x_0, theta_0)
    x, theta, innovation = dense.observe(trajectory, log.time, point_of(log), GRID, L, gamma, x_0, theta_0)
    # Two orders of elimination. With L of 1636 and -16063 1/s a step of 10 ms has a condition number of some 1e4 in balanced
    # units, and the unbalanced 3 + p system of the twin loses three digits more.
    np.testing.assert_allclose(fast.x, x, rtol=1e-8, atol=1e-8 * np.abs(x).max(axis=0).min())
    scale = np.abs(trajectory.y[:, -1]).max()
    np.testing.assert_allclose(fast.theta, theta, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(fast.innovation, innovation, rtol=0, atol=1e-9 * scale)


def dense_plant(seed, N, r):
    """Return a drive of matrices without a single zero: the diesel has many, behind which a wrong sign would hide."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.005, 0.02, N))
    A, E, C = 5.0 * rng.standard_normal((N, 3, 3)), rng.standard_normal((N, 3)), rng.standard_normal((N, r, 3))
    return time, Trajectory(np.empty((N, 0)), A, E, C, rng.standard_normal((N, r))), rng


ONE_CELL = Grid(np.array([0.0, 30.0]), np.array([500.0, 2000.0]))


@pytest.mark.parametrize(("grid", "steady"), [(GRID, 0), (GRID, 1), (GRID, 2), (ONE_CELL, 0)])
@pytest.mark.parametrize("cascade", [False, True])
def test_eq_26_on_a_system_without_zeros(grid, steady, cascade):
    time, trajectory, rng = dense_plant(29, 60, 3)
    trajectory.C[:, :steady] = trajectory.C[0, :steady]
    point = rng.uniform(-5.0, 60.0, 60), rng.uniform(400.0, 4100.0, 60)
    L = 3.0 * rng.standard_normal((3, 3))
    L[:, -1] *= not cascade
    x_0, theta_0 = rng.standard_normal(3), rng.standard_normal(grid.size)
    given = replace(trajectory, steady=steady)
    found = observe(given, time, ((0, 60),), point, grid, L, 7.0, x_0[None, :], theta_0)
    x, theta, innovation = dense.observe(trajectory, time, point, grid, L, 7.0, x_0, theta_0)
    # Numbers about one, sixty steps, growth of a few powers of ten at most: rounding of two orders of elimination.
    for fast, slow in ((found.x, x), (found.theta, theta), (found.innovation, innovation)):
        np.testing.assert_allclose(fast, slow, rtol=1e-9, atol=1e-11 * np.abs(slow).max())


def test_gamma_zero_is_the_plain_observer_and_leaves_the_map(air_path):
    log = scattered(23, 200)
    trajectory = air_path.trajectory(log, FOUR)
    theta = np.random.default_rng(24).normal(0, 0.01, GRID.size)
    found = run(log, trajectory, L_FOUR, 0.0, STEADY, theta)
    x, corrected = STEADY, trajectory.y.copy()
    corrected[:, -1] -= np.array(rows_of(log)) @ theta
    for k in range(len(log)):
        h = log.time[k] - log.time[k - 1] if k else 0.0
        F = np.eye(3) - h * (trajectory.A[k] - L_FOUR @ trajectory.C[k])
        x = np.linalg.solve(F, x + h * (trajectory.E[k] + L_FOUR @ corrected[k]))
        np.testing.assert_allclose(found.x[k], x, rtol=1e-10)  # a 3 x 3 and a 4 x 4 elimination
    np.testing.assert_array_equal(found.theta, theta)


def test_a_gain_without_sensor_column_makes_the_state_blind_to_map_and_sensor(air_path):
    log = scattered(25, 200)
    trajectory = air_path.trajectory(log, FOUR)
    y = trajectory.y.copy()
    y[:, -1] += 0.3
    other = Trajectory(trajectory.parameters, trajectory.A, trajectory.E, trajectory.C, y)
    L = L_FOUR.copy()
    L[:, -1] = 0.0
    a = run(log, trajectory, L, 0.0, STEADY, np.zeros(GRID.size))
    b = run(log, other, L, 50.0, STEADY, np.ones(GRID.size))
    np.testing.assert_allclose(a.x, b.x, rtol=1e-12)  # the elimination passes through another fourth row


@pytest.mark.parametrize("gamma", [0.0, 20.0])
def test_exact_map_and_no_noise_drive_the_error_to_zero(air_path, gamma):
    log = scattered(26, 600)
    theta = 0.01 * np.sin(np.arange(GRID.size))
    states, data = exact_plant(log, air_path.trajectory(log, FOUR), theta, STEADY)
    L = np.diag([160.0, 150.0, 140.0])
    L = np.column_stack([L, np.zeros(3)])
    found = run(log, data, L, gamma, 1.2 * STEADY, theta)
    relative = np.abs(found.x - states) / np.abs(states)
    # At 150 1/s an error shrinks by more than e in 12.5 ms: after a hundred samples only rounding is left.
    assert relative[0].max() > 0.1
    assert relative[100:].max() < 1e-10


def test_a_wrong_map_converges_where_it_is_visited_and_nowhere_else(air_path):
    log = scattered(27, 6000)
    rng = np.random.default_rng(27)
    corner = {"u_delta": rng.uniform(0.0, 20.0, len(log)), "n_e": rng.uniform(500.0, 2000.0, len(log))}
    log = replace(log, channels={**log.channels, **corner})
    theta = 0.01 * np.cos(np.arange(GRID.size))
    states, data = exact_plant(log, air_path.trajectory(log, FOUR), theta, STEADY)
    L = np.column_stack([np.diag([160.0, 150.0, 140.0]), np.zeros(3)])
    found = run(log, data, L, 200.0, STEADY, np.zeros(GRID.size))
    touched = np.abs(np.array(rows_of(log))).max(axis=0) > 0
    # 6000 scattered operating points on nine nodes: each normalised step takes out most of the error along its regressor.
    np.testing.assert_allclose(found.theta[touched], theta[touched], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(found.theta[~touched], 0.0)
    assert touched.sum() == 9
    np.testing.assert_allclose(found.x[-1], states[-1], rtol=1e-9)


def test_constant_rho_tends_to_the_matrix_exponential_at_first_order(air_path):
    """At a steady point the error obeys dz/dt = F z with F of Eq. (30); backward Euler is first order in the step."""
    one = scattered(28, 1)
    at = air_path.trajectory(one, FOUR)
    A, C = at.A[0], at.C[0]
    theta = 0.01 * np.ones(GRID.size)
    gamma, horizon, wrong = 15.0, 0.02, np.array([1e3, -2e3, 50.0])
    row = rows_of(one)[0]
    F = error_matrix(dense.sample_of(at, 0), L_FOUR, gamma * np.eye(GRID.size), row[None, :])
    exact = scipy.linalg.expm(F * horizon) @ np.concatenate((wrong, -theta))

    def missed(steps):
        N = steps + 1
        time = np.linspace(0.0, horizon, N)
        y = C @ STEADY
        y[-1] += row @ theta
        single = (at.parameters[0], A, -A @ STEADY, C, y)
        still = Trajectory(*(np.tile(part, (N, *[1] * part.ndim)) for part in single))
        point = np.full(N, one["u_delta"][0]), np.full(N, one["n_e"][0])
        found = observe(
            still, time, ((0, N),), point, GRID, L_FOUR, gamma, (STEADY + wrong)[None, :], np.zeros(GRID.size)
        )
        error = np.concatenate((found.x[-1] - STEADY, found.theta - theta)) - exact
        return np.abs(error / np.concatenate((np.abs(wrong), np.abs(theta)))).max()

    coarse, fine, finest = missed(400), missed(800), missed(1600)
    assert finest < 1e-2
    # The ratio tends to two; the second-order term is of the order of rate times step, 300 1/s times 25 us.
    assert coarse / fine == pytest.approx(2.0, abs=0.05)
    assert fine / finest == pytest.approx(2.0, abs=0.03)


@pytest.fixture(scope="module")
def proven():
    """Return two gains with P on the ETC column of Table 1 at fixed a_1, a_2: the paper's, and one from four outputs."""
    from lpvobs.synthesis.solve import certify_fixed_gain, synthesise

    bounds = (*PUBLISHED.bounds["ETC"], (287 * 310 / 5e-3,) * 2, (286 * 750 / 1.5e-3,) * 2)
    region = Region(Diesel.parameter_names, *(tuple(map(float, ends)) for ends in zip(*bounds, strict=True)))
    three, four = ("p_im", "omega_t"), FOUR
    published = certify_fixed_gain(
        GainProblem(partial(Diesel.system, outputs=three), region, 2), PUBLISHED.L, PUBLISHED.epsilon
    )
    ours = synthesise(GainProblem(partial(Diesel.system, outputs=four), region, 3), cascade=False)
    return {"published": (three, published), "four outputs": (four, ours)}


@pytest.mark.parametrize("which", ["published", "four outputs"])
@given(seed=st.integers(0, 2**32 - 1), gamma=st.floats(0.01, 1e4))
@settings(max_examples=30)
def test_the_lyapunov_function_never_rises(proven, which, seed, gamma):
    """Theorem 1, inherited by backward Euler at any step, with rho anywhere in the box at every sample."""
    outputs, gain = proven[which]
    rng = np.random.default_rng(seed)
    N = 60
    low, high = np.array(gain.region.lower), np.array(gain.region.upper)
    mixture = rng.random((N, low.size))
    mixture[rng.random((N, low.size)) < 0.5] = rng.integers(2)  # corners, where the inequality is tightest
    matrices = [Diesel.system(list(rho), outputs) for rho in low + mixture * (high - low)]
    A, C = (np.array([pair[i] for pair in matrices], dtype=float) for i in (0, 1))
    nothing = Trajectory(mixture, A, np.zeros((N, 3)), C, np.zeros((N, len(outputs) + 1)))
    time = np.concatenate(([0.0], np.cumsum(10.0 ** rng.uniform(-4, 1, N - 1))))
    point = rng.uniform(-5, 60, N), rng.uniform(300, 4500, N)
    x = rng.standard_normal(3) / np.sqrt(np.diag(gain.P))
    theta = rng.standard_normal(GRID.size) * np.sqrt(gamma) * 10.0 ** rng.uniform(-2, 2)

    def V(x, theta):
        return x @ gain.P @ x + theta @ theta / gamma

    before = V(x, theta)
    for k in range(1, N):
        pair = slice(k - 1, k + 1)
        part = Trajectory(*(getattr(nothing, name)[pair] for name in ("parameters", "A", "E", "C", "y")))
        place = point[0][pair], point[1][pair]
        found = observe(part, time[pair], ((0, 2),), place, GRID, gain.L, gamma, x[None, :], theta)
        x, theta = found.x[-1], found.theta
        after = V(x, theta)
        assert after <= before * (1.0 + 1e-9)  # rounding of a stiff 4 x 4 solve
        before = after


@pytest.mark.parametrize("which", ["published", "four outputs"])
def test_no_error_whatever_is_amplified_at_any_corner(proven, which):
    """The worst error instead of a random one: the largest gain of V in one step, from the step's own matrix."""
    outputs, gain = proven[which]
    gamma, place = 200.0, (np.full(2, 10.0), np.full(2, 900.0))
    S = scipy.linalg.block_diag(gain.P, np.eye(GRID.size) / gamma)
    corners = np.array(gain.region.vertices(), dtype=float)
    for rho in corners[::5]:
        A, C = (np.tile(np.array(part, dtype=float), (2, 1, 1)) for part in Diesel.system(list(rho), outputs))
        still = Trajectory(np.tile(rho, (2, 1)), A, np.zeros((2, 3)), C, np.zeros((2, len(outputs) + 1)))
        for h in (1e-4, 1e-2, 1.0, 100.0):
            columns = []
            for unit in np.eye(3 + GRID.size):
                found = observe(
                    still, np.array([0.0, h]), ((0, 2),), place, GRID, gain.L, gamma, unit[None, :3], unit[3:]
                )
                columns.append(np.concatenate((found.x[-1], found.theta)))
            B = np.array(columns).T
            worst = scipy.linalg.eigh(B.T @ S @ B, S, eigvals_only=True)[-1]
            assert worst <= 1.0 + 1e-9  # nodes that take no part stay as they are: exactly one, and rounding


def test_explicit_euler_would_rise(proven):
    """What the implicit step is for: the published gain at 10 ms, explicit, amplifies some error."""
    outputs, gain = proven["published"]
    A, C = (np.array(part, dtype=float) for part in Diesel.system(gain.region.lower, outputs))
    row = psi(GRID.fuel, GRID.speed, 10.0, 900.0)
    still = Sample(A, np.zeros(3), C, np.zeros(3))
    F = error_matrix(still, gain.L, 200.0 * np.eye(GRID.size), row[None, :])
    explicit = np.eye(3 + GRID.size) + 0.01 * F
    assert np.abs(np.linalg.eigvals(explicit)).max() > 10.0


def test_across_a_gap_the_map_is_carried_and_the_state_is_not(air_path):
    log = scattered(29, 300)
    trajectory = air_path.trajectory(log, FOUR)
    starts = np.array([STEADY, 1.3 * STEADY])
    both = run(log, trajectory, L_FOUR, 50.0, starts, np.zeros(GRID.size), ((0, 120), (120, 300)))
    pieces, theta = [], np.zeros(GRID.size)
    for (begin, end), x_0 in zip(((0, 120), (120, 300)), starts, strict=True):
        part = slice(begin, end)
        arrays = {name: getattr(trajectory, name)[part] for name in ("parameters", "A", "E", "C", "y")}
        piece, place = replace(trajectory, **arrays), (log["u_delta"][part], log["n_e"][part])
        found = observe(piece, log.time[part], ((0, end - begin),), place, GRID, L_FOUR, 50.0, x_0[None, :], theta)
        theta = found.theta
        pieces.append(found)
    np.testing.assert_array_equal(both.x, np.concatenate([piece.x for piece in pieces]))
    np.testing.assert_array_equal(both.innovation, np.concatenate([piece.innovation for piece in pieces]))
    np.testing.assert_array_equal(both.theta, theta)
    np.testing.assert_array_equal(both.x[120], starts[1])
    jump = log.time.copy()
    jump[120:] += 3600.0  # how long the gap was does not matter
    late = observe(
        trajectory, jump, ((0, 120), (120, 300)), point_of(log), GRID, L_FOUR, 50.0, starts, np.zeros(GRID.size)
    )
    np.testing.assert_allclose(
        late.theta, both.theta, rtol=0, atol=1e-9
    )  # steps rounded at 3600 s: 5e-13 of 10 ms, amplified


def test_inputs_are_left_alone(air_path):
    log = scattered(30, 50)
    trajectory = air_path.trajectory(log, FOUR)
    theta_0, x_0 = np.zeros(GRID.size), STEADY[None, :].copy()
    run(log, trajectory, L_FOUR, 50.0, x_0, theta_0)
    np.testing.assert_array_equal(theta_0, 0.0)
    np.testing.assert_array_equal(x_0, STEADY[None, :])
