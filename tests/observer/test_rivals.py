"""The Kalman filter and the batch solution against their textbook forms."""

from dataclasses import replace

import numpy as np
import pytest
from reference import kalman
from reference.drives import scattered
from reference.membership import psi

from lpvobs.engines.base import Trajectory
from lpvobs.maps.grid import Grid
from lpvobs.observer import ekf
from lpvobs.observer.ekf import KalmanSettings
from lpvobs.observer.parts import StateGain
from lpvobs.observer.rivals import estimate_batch, estimate_ekf
from lpvobs.observer.settings import EstimateSettings

SMALL = Grid(np.array([0.0, 20.0, 56.0]), np.array([700.0, 2000.0, 4000.0]))
FOUR = ("p_im", "p_em", "omega_t")
NOISE = {"p_im": 150.0, "p_em": 300.0, "omega_t": 20.0, "W_maf": 5e-4}
DRIFT = {"p_im": 1e4, "p_em": 2e4, "omega_t": 500.0}
TUNING = KalmanSettings(NOISE, DRIFT, map_drift=1e-5, prior_map=0.02)


def outputs_of(*names):
    """Return a gain of which the rivals read the outputs only."""
    return StateGain(names, np.zeros((3, len(names) + 1)))


@pytest.mark.parametrize("outputs", [FOUR, ("p_im", "omega_t")])
@pytest.mark.slow
def test_outputs_one_by_one_are_all_outputs_at_once(air_path, outputs):
    log = scattered(31, 250)
    trajectory, point = air_path.trajectory(log, outputs), (log["u_delta"], log["n_e"])
    R = np.array([NOISE[name] for name in (*outputs, "W_maf")]) ** 2
    Q = np.array(list(DRIFT.values())) ** 2
    x_0 = np.array([[log[name][0] for name in air_path.state_names]])
    found = ekf.adapt(
        ekf.start(SMALL, TUNING, 3), trajectory, log.time, log.segments, point, SMALL, R, Q, TUNING.map_drift, x_0
    )
    theta, P = kalman.run(trajectory, log.time, point, SMALL, R, Q, TUNING.map_drift, TUNING.prior_map, x_0[0])
    # Covariances of 1e8 Pa^2 beside 1e-8 kg^2/s^2, updated 250 times: the plain form (I - K H) P loses digits to that span.
    np.testing.assert_allclose(found.theta, theta, rtol=0, atol=1e-6 * np.abs(theta).max())
    deviation = np.sqrt(np.diag(P))
    assert np.abs((found.P - P) / np.outer(deviation, deviation)).max() < 1e-5


def test_filter_on_a_system_without_zeros():
    """The diesel's matrices have many zeros, behind which a wrong sign would hide."""
    rng = np.random.default_rng(34)
    N, r = 60, 3
    time = np.cumsum(rng.uniform(0.005, 0.02, N))
    A, E, C = 5.0 * rng.standard_normal((N, 3, 3)), rng.standard_normal((N, 3)), rng.standard_normal((N, r, 3))
    trajectory = Trajectory(np.empty((N, 0)), A, E, C, rng.standard_normal((N, r)))
    point = rng.uniform(-5.0, 60.0, N), rng.uniform(600.0, 4100.0, N)
    R, Q, x_0 = rng.uniform(0.1, 1.0, r), rng.uniform(0.1, 1.0, 3), rng.standard_normal((1, 3))
    tuning = replace(TUNING, map_drift=0.3, prior_map=0.5)
    found = ekf.adapt(ekf.start(SMALL, tuning, 3), trajectory, time, ((0, N),), point, SMALL, R, Q, 0.3, x_0)
    theta, P = kalman.run(trajectory, time, point, SMALL, R, Q, 0.3, 0.5, x_0[0])
    # Sixty updates of covariances about one: rounding, which the plain form (I - K H) P lets grow a little.
    np.testing.assert_allclose(found.theta, theta, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.P, P, rtol=0, atol=1e-10)


def test_a_node_that_takes_no_part_keeps_its_prior(air_path):
    log = scattered(32, 300)
    log = replace(log, channels={**log.channels, "n_e": 700.0 + 0.3 * (log["n_e"] - 700.0)})  # below 2000 rpm
    tuning = replace(TUNING, map_drift=0.0)
    found = estimate_ekf(air_path, SMALL, outputs_of(*FOUR), [log], tuning, EstimateSettings(0.05, 0.01, 0.1))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance))[6:], TUNING.prior_map, rtol=1e-12)
    assert not found.supported[2].any()
    assert np.isnan(found.theta[2]).all()


def test_filter_without_noise_finds_the_map(air_path, grid, drive, target, settings):
    found = estimate_ekf(air_path, grid, outputs_of(*FOUR), [drive[0]], TUNING, settings)
    missed = (found.theta - target(drive[0]))[found.supported]
    # The filter trusts the sensor to 0.5 g/s and the surface is not bilinear inside a cell.
    assert np.sqrt(np.mean(missed**2)) < 2e-4


def test_batch_is_dense_least_squares(air_path):
    log, settings = scattered(33, 300), EstimateSettings(smoothing=0.05, least_information=1e-4, prior_map=0.1)
    found = estimate_batch(air_path, SMALL, outputs_of("p_im", "omega_t"), [log], settings)
    used = np.ones(len(log), dtype=bool)
    used[[start for start, _ in log.segments]] = False
    X = np.array([psi(SMALL.fuel, SMALL.speed, *v) for v in zip(log["u_delta"], log["n_e"], strict=True)])[used]
    trajectory = air_path.trajectory(log, ("p_im", "omega_t"))
    z = (log["W_maf"] - trajectory.parameters[:, 0] * log["omega_t"])[used]
    theta, residual, *_ = np.linalg.lstsq(X, z, rcond=None)
    # A prior of 0.1 kg/s beside hundreds of samples good to grams per second must not be felt.
    np.testing.assert_allclose(found.theta.reshape(-1), theta, rtol=0, atol=1e-3 * np.abs(theta).max())
    textbook = residual[0] / (used.sum() - SMALL.size) * np.linalg.inv(X.T @ X)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), np.sqrt(np.diag(textbook)), rtol=0.05)


def test_batch_without_noise_finds_the_map(air_path, grid, drive, target, settings):
    found = estimate_batch(air_path, grid, outputs_of("p_im", "omega_t"), [drive[0]], settings)
    missed = (found.theta - target(drive[0]))[found.supported]
    # The compressor balance is exact here, so this is the best fit itself; first samples of segments are left out of one.
    assert np.abs(missed).max() < 1e-4


@pytest.mark.parametrize(
    "rival", [estimate_batch, lambda *of: estimate_ekf(*of[:4], TUNING, of[4])], ids=["batch", "ekf"]
)
def test_every_log_is_kept_by_name_with_its_length(air_path, rival):
    logs = [replace(scattered(seed, length), name=name) for seed, length, name in ((41, 30, "a"), (42, 50, "b"))]
    found = rival(air_path, SMALL, outputs_of(*FOUR), logs, EstimateSettings(0.05, 0.01, 0.1))
    assert [(run.name, run.samples) for run in found.runs] == [("a", 30), ("b", 50)]


def test_order_of_logs_does_not_matter_to_batch(air_path, grid, drive, other_drive, settings):
    logs = drive[0], other_drive[0]
    a, b = (
        estimate_batch(air_path, grid, outputs_of("p_im", "omega_t"), order, settings) for order in (logs, logs[::-1])
    )
    np.testing.assert_allclose(a.theta, b.theta, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    "change",
    [{"measurement_noise": {"p_im": 0.0}}, {"process_noise": {"p_im": -1.0}}, {"map_drift": -1e-9}, {"prior_map": 0.0}],
)
def test_tuning_that_no_filter_can_have_is_refused(change):
    with pytest.raises(ValueError, match="must"):
        replace(TUNING, **change)
