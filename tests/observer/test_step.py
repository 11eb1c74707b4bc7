"""The step of Eq. (26) and (36): as printed, in special cases, and equal to the compiled recursion on a drive of every engine."""

from dataclasses import replace

import numpy as np
import pytest
from reference import throttled_drive
from reference.adaptive_observer import sample_of
from repository import CONFIGS, LIU_ICE

from lpvobs.engines.registry import ENGINES
from lpvobs.engines.throttled.lpv import Throttled
from lpvobs.io.configuration.config import load_config
from lpvobs.maps.grid import Grid
from lpvobs.observer.parts import operating_point
from lpvobs.observer.recursion import observe
from lpvobs.observer.step import Sample, error_matrix, local_step, rates, step

SAMPLES = 150


def drawn(seed, n=3, r=4, p=5):
    """Return a state, a map, a sample, a gain, Gamma and Psi without zeros."""
    rng = np.random.default_rng(seed)
    sample = Sample(*(rng.standard_normal(shape) for shape in ((n, n), n, (r, n), r)))
    Gamma = np.diag(rng.uniform(1.0, 5.0, p))
    return (
        rng.standard_normal(n), rng.standard_normal(p), sample, rng.standard_normal((n, r)), Gamma, rng.random((1, p)),
    )  # fmt: skip


def test_eq_26_by_hand():
    """One state, one measured state and the sensor, two nodes."""
    sample = Sample(np.array([[-2.0]]), np.array([1.0]), np.array([[1.0], [4.0]]), np.array([3.5, 11.0]))
    L, Gamma, Psi = np.array([[10.0, 0.5]]), np.diag([2.0, 3.0]), np.array([[0.25, 0.75]])
    dx, dtheta = rates(np.array([3.0]), np.array([2.0, -2.0]), sample, L, Gamma, Psi)
    # Psi theta = -1; y - C x - G Psi theta = (0.5, 11 - 12 + 1) = (0.5, 0); dx = -6 + 1 + 5
    assert dx.tolist() == [0.0]
    assert dtheta.tolist() == [0.0, 0.0]
    dx, dtheta = rates(np.array([3.0]), np.array([2.0, 2.0]), sample, L, Gamma, Psi)
    # Psi theta = 2; the sensor's innovation is 11 - 12 - 2 = -3
    assert dx.tolist() == [-1.5]
    assert dtheta.tolist() == [2.0 * 0.25 * -3.0, 3.0 * 0.75 * -3.0]


@pytest.mark.parametrize("seed", range(5))
def test_the_step_has_the_rates_of_its_end(seed):
    x, theta, sample, L, Gamma, Psi = drawn(seed)
    for h in (0.0, 1e-3, 0.1):
        x_new, theta_new = step(x, theta, h, sample, L, Gamma, Psi)
        dx, dtheta = rates(x_new, theta_new, sample, L, Gamma, Psi)
        # Numbers about one; a linear system of eight unknowns.
        np.testing.assert_allclose(x_new, x + h * dx, rtol=0, atol=1e-12)
        np.testing.assert_allclose(theta_new, theta + h * dtheta, rtol=0, atol=1e-12)


def test_the_error_follows_eq_30():
    """Rates of the estimate minus those of a plant with the same outputs are F times the error."""
    x, theta, sample, L, Gamma, Psi = drawn(6)
    x_true, theta_true = x + 0.3, theta - 0.7
    G = np.array([[0.0], [0.0], [0.0], [1.0]])
    exact = replace(sample, y=sample.C @ x_true + G @ Psi @ theta_true)  # Eq. (24)
    dx, dtheta = rates(x, theta, exact, L, Gamma, Psi)
    plant = sample.A @ x_true + sample.E
    F = error_matrix(sample, L, Gamma, Psi)
    error = np.concatenate((x - x_true, theta - theta_true))
    np.testing.assert_allclose(np.concatenate((dx - plant, dtheta)), F @ error, rtol=0, atol=1e-12)


def test_a_missing_reading_is_an_output_less():
    x, theta, sample, L, Gamma, Psi = drawn(7)
    y = sample.y.copy()
    y[1] = np.nan
    fewer = replace(sample, C=np.delete(sample.C, 1, 0), y=np.delete(sample.y, 1))
    found = step(x, theta, 0.1, replace(sample, y=y), L, Gamma, Psi)
    for got, wanted in zip(found, step(x, theta, 0.1, fewer, np.delete(L, 1, 1), Gamma, Psi), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-13)  # the same equations


def test_without_the_sensor_the_map_stands_and_without_any_reading_the_state_runs_free():
    x, theta, sample, L, Gamma, Psi = drawn(8)
    y = sample.y.copy()
    y[-1] = np.nan
    x_new, theta_new = step(x, theta, 0.1, replace(sample, y=y), L, Gamma, Psi)
    np.testing.assert_array_equal(theta_new, theta)
    assert np.abs(x_new - x).max() > 1e-3
    x_new, theta_new = step(x, theta, 0.1, replace(sample, y=np.full(4, np.nan)), L, Gamma, Psi)
    np.testing.assert_array_equal(theta_new, theta)
    free = np.linalg.solve(np.eye(3) - 0.1 * sample.A, x + 0.1 * sample.E)  # Eq. (4)
    np.testing.assert_allclose(x_new, free, rtol=0, atol=1e-13)


def test_only_the_nodes_that_take_part_move():
    """Eq. (36) is Eq. (26) with what does not move left out."""
    x, _, sample, L, _, _ = drawn(9)
    rng = np.random.default_rng(9)
    theta, nodes, Psi_l = rng.standard_normal(12), np.array([2, 3, 7, 8]), rng.random(4)
    Psi = np.zeros((1, 12))
    Psi[0, nodes] = Psi_l
    local = local_step(x, theta, 0.1, sample, L, 2.0, nodes, Psi_l)
    for got, wanted in zip(local, step(x, theta, 0.1, sample, L, 2.0 * np.eye(12), Psi), strict=True):
        np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-13)  # the same equations
    np.testing.assert_array_equal(np.delete(local[1], nodes), np.delete(theta, nodes))


def throttled():
    """Return a throttled engine that has learned, a drive of it, a grid and gains."""
    log = throttled_drive.log_of(throttled_drive.noisy(throttled_drive.drive(200.0), 1))
    path = Throttled(load_config(LIU_ICE)[0].engine).learned_from([log])
    grid = Grid(np.linspace(0.0, log["m_f"].max(), 5), np.linspace(800.0, 3200.0, 6))
    cascade = np.array([[40.0, -3.0, 0.0], [2.0, 60.0, 0.0], [1e-6, 1e-7, 0.0]])
    whole = cascade + np.array([0.0, 0.0, 1.0]) * np.array([[2e5], [-1e5], [3.0]])
    return path, log, ("p_ic", "p_im"), grid, (cascade, whole)


@pytest.fixture(scope="module")
def drives(air_path, grid, drive, gain):
    """Return, for every engine, its air path, a log, the measured states, a grid, and gains with and without the sensor."""
    whole = gain.L + np.array([0.0, 0.0, 0.0, 1.0]) * np.array([[4e4], [-2e4], [3e3]])
    diesel = (air_path, drive[0], gain.outputs, grid, (gain.L, whole))
    ours = load_config(CONFIGS / "series.toml")[0]
    cascade = np.array([[500.0, 0.0], [4e-3, 0.0]])
    both = (cascade, cascade + np.array([0.0, 1.0]) * np.array([[2e5], [3.0]]))
    series = (ours.engine_path(), drive[0], ("p_im",), ours.grid(), both)
    simple = load_config(CONFIGS / "speed_density.toml")[0]
    plain = (simple.engine_path(), drive[0], ("p_im",), simple.grid(), both)
    found = {"diesel": diesel, "throttled": throttled(), "series": series, "speed_density": plain}
    assert found.keys() == ENGINES.keys()
    return found


@pytest.mark.parametrize("engine_name", ENGINES)
@pytest.mark.parametrize("which", [0, 1], ids=["cascade", "the sensor corrects the state"])
@pytest.mark.parametrize("missing", [False, True], ids=["whole", "readings missing"])
def test_the_compiled_recursion_is_the_local_step(drives, engine_name, which, missing):
    path, log, outputs, grid, gains = drives[engine_name]
    L, gamma, part = gains[which], 20.0, slice(0, SAMPLES)
    trajectory, point, time = path.trajectory(log, outputs), operating_point(path, log), log.time[part]
    trajectory = replace(
        trajectory, **{name: getattr(trajectory, name)[part] for name in ("parameters", "A", "E", "C", "y")}
    )
    point = point[0][part], point[1][part]
    if missing:
        gone = np.random.default_rng(1).random(trajectory.y.shape) < 0.2
        trajectory = replace(trajectory, y=np.where(gone, np.nan, trajectory.y))
    x = path.states(log)[0] * 1.1
    theta = 0.01 * np.cos(np.arange(grid.size))
    found = observe(trajectory, time, ((0, SAMPLES),), point, grid, L, gamma, x[None, :], theta)
    nodes, weights = grid.regressors(*point)
    for k in range(SAMPLES):
        h = time[k] - time[k - 1] if k else 0.0
        x, theta = local_step(x, theta, h, sample_of(trajectory, k), L, gamma, nodes[k], weights[k])
        # Pascals beside radians per second, eliminated in two orders; the condition of one step in balanced units is below 1e3.
        np.testing.assert_allclose(found.x[k], x, rtol=1e-9, atol=1e-9 * np.abs(x).min())
    np.testing.assert_allclose(found.theta, theta, rtol=0, atol=1e-12)
