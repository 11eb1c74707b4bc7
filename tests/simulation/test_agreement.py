"""The plant against the observer's model, which is written on its own: two transcriptions of one engine have to agree."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.engines.diesel.lpv import INPUTS, Diesel, along
from lpvobs.simulation.parameters import ErrorSurface
from lpvobs.simulation.simulate import simulate


@pytest.fixture(scope="module")
def model(config, truth):
    """Return rho_1..rho_5, a_1, a_2 and E of the observer's model on the plant's own signals."""
    return along(Diesel(config.engine).constants, tuple(truth[name] for name in INPUTS))


def test_flows_agree_to_rounding(truth, model):
    rho, _ = model
    for flow, found in (
        ("W_c", rho[:, 0] * truth["omega_t"]),
        ("W_egr", rho[:, 1] * truth["p_em"]),
        ("W_ei", rho[:, 2] * truth["p_im"]),
    ):
        # A dozen roundings of numbers up to a tenth of a kilogram per second.
        np.testing.assert_allclose(found, truth[flow], rtol=1e-11, atol=1e-13, err_msg=flow)


def test_the_short_cycle_visits_what_it_is_for(truth):
    assert truth["u_delta"].min() == 0.0
    assert truth["u_delta"].max() > 35.0
    assert truth["u_egr"].max() > 20.0
    assert truth["p_im"].max() > 1.5e5


def test_states_move_as_the_model_says(truth, model):
    """Eq. (1) with the term in dT_im/dt, by central differences of the samples 10 ms apart."""
    rho, E = model
    h = 0.01
    rate = {name: (truth[name][2:] - truth[name][:-2]) / (2 * h) for name in ("p_im", "omega_t", "T_im")}
    inside = slice(1, -1)
    flow = (rho[:, 0] * truth["omega_t"] + rho[:, 1] * truth["p_em"] - rho[:, 2] * truth["p_im"])[inside]
    wanted = rho[inside, 5] * flow + truth["p_im"][inside] / truth["T_im"][inside] * rate["T_im"]
    spread = np.sqrt(np.mean(rate["p_im"] ** 2))
    # The third derivative times h^2 / 6 on signals whose fastest part takes some 20 ms.
    assert np.median(np.abs(rate["p_im"] - wanted)) < 0.01 * spread
    wanted = -rho[inside, 4] * truth["omega_t"][inside] + E[inside, 2]
    spread = np.sqrt(np.mean(rate["omega_t"] ** 2))
    assert np.median(np.abs(rate["omega_t"] - wanted)) < 0.01 * spread


def test_the_step_is_converged(config, cycle, truth):
    """Half the step moves no flow by more than a thousandth of a gram per second: a tenth of the sensor's resolution."""
    finer = simulate(config.engine, replace(config.simulation, step=config.simulation.step / 2), cycle).truth
    assert np.sqrt(np.mean((finer["W_c"] - truth["W_c"]) ** 2)) < 1e-6
    assert np.sqrt(np.mean((finer["p_im"] - truth["p_im"]) ** 2)) < 5.0


def test_reading_is_truth_plus_surface_plus_noise_of_the_stated_size(config, cycle):
    log = simulate(config.engine, config.simulation, cycle, seed=3)
    noise = log.channels["W_maf"] - log.channels["ref_W_c"] - log.channels["ref_delta_W_c"]
    sensors = config.simulation.sensors
    reading = log.channels["ref_W_c"] + log.channels["ref_delta_W_c"]
    stated = np.hypot(sensors.W_maf_absolute, sensors.W_maf_relative * reading)
    # 2000 samples know a standard deviation to 1.6 %; three times that.
    assert np.std(noise / stated) == pytest.approx(1.0, abs=0.05)
    for name in ("p_im", "p_em", "omega_t", "T_im", "T_em", "n_e", "u_delta"):
        spread = np.std(log.channels[name] - log.truth[name])
        assert spread == pytest.approx(getattr(sensors, name), rel=0.06), name


def test_surface_does_not_touch_the_engine(config, cycle, truth):
    bare = simulate(config.engine, config.simulation, cycle, surface=ErrorSurface("zero"))
    np.testing.assert_array_equal(bare.truth["W_c"], truth["W_c"])
    np.testing.assert_array_equal(bare.channels["ref_delta_W_c"], 0.0)


def test_any_rate_samples_the_same_course(config, cycle, truth):
    for rate in (10.0, 33.0, 400.0):
        other = simulate(config.engine, config.simulation, cycle, rate=rate)
        time = other.channels["time"]
        np.testing.assert_allclose(np.diff(time), 1.0 / rate, rtol=1e-9)
        shared = np.interp(np.arange(truth["p_im"].size) / 100.0, time, other.truth["p_im"])
        # Straight lines between samples a tenth of a second apart miss the fastest swings of the pressure.
        assert np.median(np.abs(shared - truth["p_im"])) < 100.0
