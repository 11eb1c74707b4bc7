"""What is known of sensors in order, in the plant: late, held and rounded as stated, and nothing else changes."""

import numpy as np
import pytest
import scipy

from lpvobs.engines.channels import Sensor
from lpvobs.simulation.simulate import simulate


@pytest.fixture(scope="module")
def run(config, cycle):
    def run(rate=100.0, **sensors):
        return simulate(config.engine, config.simulation, cycle, rate=rate, sensors=sensors)

    return run


def test_nothing_stated_is_the_same_drive(run, clean):
    for name, column in run(p_im=Sensor()).channels.items():
        np.testing.assert_array_equal(column, clean.channels[name])


def test_a_lag_follows_its_equation(run, clean):
    # without noise the reading is y of tau dy/dt = x - y; noise and rounding are those of the fast sensor, sample by sample
    shown = run(T_em=Sensor(tau=1.5)).channels["T_em"]
    time, x = clean.channels["time"], clean.truth["T_em"]
    fine = np.arange(time[-1] * 1000) / 1000.0
    system = scipy.signal.TransferFunction([1.0], [1.5, 1.0])
    y = scipy.signal.lsim(system, np.interp(fine, time, x) - x[0], fine)[1] + x[0]
    noise = clean.channels["T_em"] - x
    np.testing.assert_allclose(shown - noise, np.interp(time, fine, y), atol=0.15)  # two roundings to 0.1 K
    assert np.abs(x - np.interp(time, fine, y)).max() > 20.0


def test_dead_time_and_running_mean(run, clean):
    late = run(p_im=Sensor(delay=0.2)).channels["p_im"]
    noise = clean.channels["p_im"] - clean.truth["p_im"]
    np.testing.assert_allclose((late - noise)[20:], clean.truth["p_im"][:-20], atol=15.0)  # two roundings to 10 Pa
    mean = run(p_im=Sensor(filter=0.1)).channels["p_im"] - noise
    x = clean.truth["p_im"]
    edges = 0.5 * (x[:-1] + x[1:])  # trapezoids between samples, where the plant has shorter ones
    wanted = np.array([edges[k - 10 : k].mean() for k in range(10, x.size)])
    np.testing.assert_allclose(mean[10:], wanted, atol=15.0 + 0.1 * np.abs(np.diff(x, 2)).max())


def test_a_raster_holds_and_a_step_rounds(run, clean):
    found = run(T_im=Sensor(raster=0.1, quantisation=0.5))
    held = found.channels["T_im"]
    changes = np.flatnonzero(np.diff(held))
    assert np.diff(changes).min() >= 9
    np.testing.assert_allclose(held / 0.5, np.round(held / 0.5), atol=1e-9)
    for name in ("p_im", "W_maf", "n_e"):
        np.testing.assert_array_equal(found.channels[name], clean.channels[name])


def test_pulses_are_misread_where_they_are_stated(run, clean):
    ratio = run(W_maf=Sensor(pulsation=0.3)).truth["W_maf"] / clean.truth["W_maf"]
    at = clean.truth
    wanted = 1.0 + 0.3 * np.maximum(0.0, 2000.0 - at["n_e"]) / 1000.0 * at["u_delta"] / 40.0
    np.testing.assert_allclose(ratio, wanted, rtol=1e-9)
