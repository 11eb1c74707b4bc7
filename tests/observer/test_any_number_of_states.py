"""One, two, three and four states run through gain, certificate, recursion, rivals, sensor state and results."""

from dataclasses import replace

import numpy as np
import pytest
from reference import adaptive_observer as dense
from reference import chain, kalman

from lpvobs.io.results.gains import StoredGain, read_gain, write_gain
from lpvobs.io.results.provenance import Provenance
from lpvobs.maps.grid import Grid
from lpvobs.observer import ekf
from lpvobs.observer.ekf import KalmanSettings
from lpvobs.observer.estimate import estimate_default
from lpvobs.observer.inverse import ROW, invert
from lpvobs.observer.parts import StateGain
from lpvobs.observer.recursion import observe
from lpvobs.observer.rivals import estimate_batch, estimate_ekf, estimate_published
from lpvobs.observer.settings import EstimateSettings, PublishedSettings
from lpvobs.synthesis.certificate import check
from lpvobs.synthesis.sensor_state import prove, with_sensor_state
from lpvobs.synthesis.solve import synthesise

NUMBERS = (1, 2, 3, 4)
GRID = Grid(np.array([0.0, 0.5, 1.0]), np.array([1000.0, 2000.0, 3000.0]))
THETA = 0.01 * np.array([[1.0, -2.0, 0.5], [0.0, 3.0, -1.0], [2.0, 1.0, -0.5]])
SETTINGS = EstimateSettings(smoothing=0.03, least_information=0.1, prior_map=1.0, tolerance={"level": 1e-3})


def error(load, speed):
    return GRID.interpolate(THETA, load, speed)


# Each number of states has kernels of its own, which take seconds to compile.
@pytest.fixture(scope="module", params=[pytest.param(n, marks=[pytest.mark.proof] * (n in (1, 4))) for n in NUMBERS])
def chained(request):
    """Return the number of states, the air path, the measured states, a drive and a proven cascade."""
    n = request.param
    path = chain.chain(n)
    outputs = path.state_names[-2:]  # the first volumes of a long chain are not measured
    problem = chain.problem(n, outputs)
    gain = synthesise(problem, cascade=True, decay=5.0)
    return n, path, outputs, chain.drive(n, n, error), problem, gain


def test_the_gain_is_proven_and_a_wrong_one_is_not(chained, tmp_path):
    n, path, outputs, _, problem, gain = chained
    assert gain.L.shape == (n, len(outputs) + 1)
    assert check(problem, gain.L, gain.P, gain.Q, gain.eps_1, gain.eps_2).proven
    assert not check(problem, -10.0 * gain.L, gain.P, gain.Q, gain.eps_1, gain.eps_2).proven
    stored = StoredGain("synthesised", path.name, {}, path.state_names, outputs, gain, {})
    write_gain(tmp_path / "gain.h5", stored, Provenance({}, ""))
    read = read_gain(tmp_path / "gain.h5")
    np.testing.assert_array_equal(read.gain.L, gain.L)
    assert read.states == path.state_names


def test_the_sensor_makes_one_state_more(chained):
    n, _, _, _, problem, gain = chained
    found = with_sensor_state(problem, gain, (0.05, 0.1), 10.0)
    assert found.L.shape[0] == n + 1
    assert prove(problem, found.L, found.P, found.tau).smallest_pivot > 0.0


def few(log, N=300):
    channels = {name: column[:N].copy() for name, column in log.channels.items()}
    return replace(log, time=log.time[:N], channels=channels, segments=((0, N),))


@pytest.mark.parametrize("cascade", [True, False])
@pytest.mark.parametrize("missing", [False, True], ids=["whole", "readings missing"])
def test_the_recursion_is_the_dense_step(chained, cascade, missing):
    n, path, outputs, log, problem, gain = chained
    L = gain.L if cascade else synthesise(problem, cascade=False).L + 0.1  # no entry is zero
    log = few(log)
    trajectory, point = path.trajectory(log, outputs), (log["load"], log["n_e"])
    if missing:
        gone = np.random.default_rng(n).random(trajectory.y.shape) < 0.2
        trajectory = replace(trajectory, y=np.where(gone, np.nan, trajectory.y))
    x_0, theta_0 = np.full(n, 2.0), 0.01 * np.arange(GRID.size)
    found = observe(trajectory, log.time, log.segments, point, GRID, L, 20.0, x_0[None, :], theta_0)
    x, theta, innovation = dense.observe(trajectory, log.time, point, GRID, L, 20.0, x_0, theta_0)
    # Two orders of elimination of numbers about one: rounding.
    np.testing.assert_allclose(found.x, x, rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.theta, theta, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.innovation, innovation, rtol=0, atol=1e-11)
    assert np.isnan(found.innovation).any() == missing


@pytest.mark.slow
def test_the_filter_is_the_textbook_s(chained):
    n, path, outputs, log, _, _ = chained
    log, tuning = few(log, 200), KalmanSettings({"W": 0.1}, {"x_1": 1.0}, map_drift=0.01, prior_map=0.1)
    trajectory, point = path.trajectory(log, outputs), (log["load"], log["n_e"])
    R, Q, x_0 = np.full(len(outputs) + 1, 0.01), np.full(n, 0.5), np.full((1, n), 2.0)
    start = ekf.start(GRID, tuning, n)
    found = ekf.adapt(start, trajectory, log.time, log.segments, point, GRID, R, Q, tuning.map_drift, x_0)
    theta, P = kalman.run(trajectory, log.time, point, GRID, R, Q, tuning.map_drift, tuning.prior_map, x_0[0])
    # Numbers about one through 200 updates: rounding, which the plain form (I - K H) P lets grow a little.
    np.testing.assert_allclose(found.theta, theta, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.P, P, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_every_method_finds_the_map(chained):
    n, path, outputs, log, _, gain = chained
    state_gain = StateGain(outputs, gain.L, gain.region)
    channels = (*path.state_names, path.sensor)
    kalman_settings = KalmanSettings(dict.fromkeys(channels, 1e-3), dict.fromkeys(channels, 1.0), 1e-6, 1.0)
    published = PublishedSettings(gamma=20.0, x_0=(1.0,) * n, temperatures={})
    found = {
        "default": estimate_default(path, GRID, state_gain, [log], SETTINGS),
        "ekf": estimate_ekf(path, GRID, state_gain, [log], kalman_settings, SETTINGS),
        "batch": estimate_batch(path, GRID, state_gain, [log], SETTINGS),
        "published": estimate_published(path, GRID, state_gain, [log], published, SETTINGS),
    }
    assert found["default"].runs[0].share_certified == 1.0
    missed = {method: np.abs(one.theta - THETA).max() for method, one in found.items()}
    # No noise, and a plant stepped as the observer steps: batch is exact but for its prior of 1e4. The default smooths over 30 ms
    # what moves by a few rad/s, and one of its two balances differentiates.
    assert missed["batch"] < 1e-8
    assert missed["default"] < 1e-3
    assert missed["ekf"] < 1e-3
    # Of the published observer, what the start has left at the node that the drive hardly visits: a tenth of 0.03.
    assert missed["published"] < 3e-3


@pytest.mark.parametrize("n", NUMBERS)
def test_inverses_side_by_side(n):
    rng = np.random.default_rng(n)
    units = 10.0 ** rng.uniform(-6, 6, n)
    M = np.eye(n) + 3.0 * rng.standard_normal((ROW, n, n)) / n
    M = M[np.linalg.cond(M) < 100.0]
    given = np.resize(M, (ROW, n, n)) * units[:, None] / units
    room = np.empty((3, n, n, ROW))
    room[0] = np.moveaxis(given, 0, -1)
    found, _ = invert((0.0,) * n, room[0], room[1], room[2], np.empty(ROW))
    rest = np.moveaxis(found, -1, 0) @ given * units / units[:, None] - np.eye(n)
    assert np.abs(rest).max() < 1e-9  # a condition of a hundred to the power n - 1, times rounding, in whatever units
