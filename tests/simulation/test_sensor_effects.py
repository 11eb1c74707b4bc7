"""Effects on what sensors show, against relations written here on their own; the truth has no noise: only rounding is allowed."""

from dataclasses import replace
from itertools import pairwise
from math import exp

import numpy as np
import pytest

from lpvobs.simulation.effects import CatalogueEffect
from lpvobs.simulation.instruments import lagged
from lpvobs.simulation.parameters import ErrorSurface
from lpvobs.simulation.readings import delayed
from lpvobs.simulation.simulate import simulate

PERFECT = ErrorSurface("zero")
RATE = 1000  # Hz, a sample at every step of the integrator


@pytest.fixture(scope="module")
def steps(inject):
    """Return the truth of the clean drive at every step, under a perfect sensor."""
    return inject(surface=PERFECT, rate=RATE).truth


def reading(inject, *effects):
    return inject(*effects, surface=PERFECT).truth["W_maf"]


# --- the air flow sensor, without memory ------------------------------------------------------------------------------------


def test_gain_multiplies_the_reading_with_its_own_error_in_it(inject, truth):
    shown = inject(CatalogueEffect("maf.gain", 1.06)).truth["W_maf"]
    np.testing.assert_allclose(shown, 1.06 * (truth["W_c"] + truth["delta_W_c"]), rtol=1e-14)


def test_offset_is_added(inject, truth):
    np.testing.assert_allclose(reading(inject, CatalogueEffect("maf.offset", 1e-3)) - truth["W_c"], 1e-3, rtol=1e-12)


def test_drift_counts_from_the_start_of_the_log_even_with_an_onset(inject, clean, truth):
    time = clean.channels["time"]
    shown = reading(inject, CatalogueEffect("maf.drift", -2e-3, onset=5.0))
    wanted = np.where(time >= 5.0 - 1e-9, 1.0 - 2e-3 * time, 1.0)
    np.testing.assert_allclose(shown / truth["W_c"], wanted, rtol=1e-12)


def test_temperature_counts_from_298_K(config, cycle):
    warm = replace(config.simulation, ambient=replace(config.simulation.ambient, T_amb=310.0))
    log = simulate(config.engine, warm, cycle, surface=PERFECT, effects=(CatalogueEffect("maf.temperature", 5e-3),))
    np.testing.assert_allclose(log.truth["W_maf"], 1.06 * log.truth["W_c"], rtol=1e-12)  # 12 K at 0.5 %/K


def test_contamination_is_kings_law_that_crosses_at_20_grams_per_second(inject, truth):
    W, shown = truth["W_c"], reading(inject, CatalogueEffect("maf.contamination", 0.08))
    # rounding of the square root, near its own size where it is small
    np.testing.assert_allclose(np.sqrt(shown), 0.92 * np.sqrt(W) + 0.08 * np.sqrt(0.02), rtol=1e-12)
    assert W.min() < 0.019
    assert W.max() > 0.021
    assert (shown > W)[W < 0.0199].all()
    assert (shown < W)[W > 0.0201].all()


def test_backflow_reads_too_much_at_low_speed_and_high_load_only(inject, truth):
    ratio = reading(inject, CatalogueEffect("maf.backflow", 0.3)) / truth["W_c"]
    fast, slow = truth["n_e"] >= 2000.0, truth["n_e"] < 2000.0
    assert (ratio[fast] == 1.0).all()
    assert fast.any()
    load = truth["u_delta"][slow] * (2000.0 - truth["n_e"][slow]) / (40.0 * 1000.0)
    np.testing.assert_allclose(ratio[slow] - 1.0, 0.3 * load, rtol=1e-9, atol=1e-14)


def test_an_inlet_leak_passes_what_the_filters_depression_drives(inject, config, truth):
    area, air = 5e-5, config.simulation.ambient
    W = reading(inject, CatalogueEffect("leak.inlet", area))
    density = air.p_amb / (config.engine.gas.R_a * air.T_amb)
    drawn_in = area * np.sqrt(2.0 * density * 2.08e5 * W**2)  # Bernoulli behind the filter
    np.testing.assert_allclose(W + drawn_in, truth["W_c"], rtol=1e-12)
    assert 0.02 < np.mean(drawn_in / W) < 0.05


def test_effects_act_together_in_the_order_of_the_sensor(inject, truth):
    """Flow, then characteristic, then electronics: the offset is not multiplied, however the list is sorted."""
    pair = CatalogueEffect("maf.offset", 1e-3), CatalogueEffect("maf.gain", 1.1)
    np.testing.assert_allclose(reading(inject, *pair), 1.1 * truth["W_c"] + 1e-3, rtol=1e-13)


def test_two_of_the_same_kind_multiply(inject, truth):
    pair = CatalogueEffect("maf.gain", 1.1), CatalogueEffect("maf.gain", 1.2, onset=10.0)
    at_the_end = (reading(inject, *pair) / truth["W_c"])[[0, -1]]
    np.testing.assert_allclose(at_the_end, [1.1, 1.32], rtol=1e-13)


# --- memory -------------------------------------------------------------------------------------------------------------------


def naive_lag(W, step, tau):
    """Heun's method, one step after the other."""
    y, course = W[0], [W[0]]
    for before, after in pairwise(W):
        first = (before - y) / tau
        second = (after - (y + step * first)) / tau
        y += 0.5 * step * (first + second)
        course.append(y)
    return np.array(course)


@pytest.mark.parametrize("tau", [0.015, 0.08, 2.0])
def test_a_step_has_63_percent_of_its_height_at_tau(tau):
    """The step rises within one sample of 0.1 ms: the answer is that of an ideal step half a sample later."""
    step = 1e-4
    W = np.concatenate([np.zeros(10), np.ones(60000)])
    y = lagged(W, step, tau)
    at_tau = y[9 + round(tau / step)] + (0.5 * step / tau) * exp(-1.0)
    assert at_tau == pytest.approx(1.0 - exp(-1.0), abs=2.0 * (step / tau) ** 2)
    assert (np.diff(y) >= 0.0).all()


def test_lag_solves_its_differential_equation(inject, steps):
    shown = inject(CatalogueEffect("maf.lag", 0.08), surface=PERFECT, rate=RATE).truth["W_maf"]
    wanted = naive_lag(steps["W_c"], 1.0 / RATE, 0.08)
    # Heun's error: (h/tau)^2 / 6 of what is still moving, some 10 g/s at most
    np.testing.assert_allclose(shown, wanted, atol=0.01 * (1.0 / RATE / 0.08) ** 2)
    assert np.abs(shown - steps["W_c"]).max() > 1e-3


def test_the_slow_thermometer_too_and_the_engine_does_not_care(inject, steps):
    log = inject(CatalogueEffect("T_im.lag", 4.0), surface=PERFECT, rate=RATE)
    wanted = naive_lag(steps["T_im"], 1.0 / RATE, 4.0)
    # standard deviation of the noise 0.1 K at most and rounding to 0.1 K, averaged over blocks of a second
    noise = (log.channels["T_im"] - wanted)[: 17 * RATE].reshape(17, RATE).mean(axis=1)
    np.testing.assert_allclose(noise, 0.0, atol=0.02)
    assert np.abs(wanted - steps["T_im"]).max() > 1.0
    assert np.array_equal(log.truth["T_im"], steps["T_im"])
    assert np.array_equal(log.truth["W_c"], steps["W_c"])


def test_delay_shifts_by_exactly_its_length(inject, steps):
    shown = inject(CatalogueEffect("maf.delay", 0.04), surface=PERFECT, rate=RATE).truth["W_maf"]
    late = round(0.04 * RATE)
    np.testing.assert_allclose(shown[late:], steps["W_c"][:-late], rtol=1e-13)
    np.testing.assert_allclose(shown[:late], steps["W_c"][0], rtol=1e-13)


def test_a_delay_between_two_steps_is_straight_between_them():
    ramp = 0.02 + 0.01 * np.arange(100.0)
    np.testing.assert_allclose(delayed(ramp, 1.0, 7.25)[8:], ramp[8:] - 0.0725, rtol=1e-13)


def test_a_delay_after_a_lag_is_a_lag_after_a_delay(inject):
    first = inject(
        CatalogueEffect("maf.lag", 0.08), CatalogueEffect("maf.delay", 0.04), surface=PERFECT, rate=RATE
    ).truth["W_maf"]
    alone = inject(CatalogueEffect("maf.lag", 0.08), surface=PERFECT, rate=RATE).truth["W_maf"]
    late = round(0.04 * RATE)
    np.testing.assert_allclose(first[late:], alone[:-late], rtol=1e-13)


# --- the other sensors ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("identifier", "value", "channel", "factor", "offset"),
    [
        ("u_delta.gain", 1.05, "u_delta", 1.05, 0.0),
        ("p_im.gain", 1.02, "p_im", 1.02, 0.0),
        ("p_im.offset", 2e3, "p_im", 1.0, 2e3),
        ("p_em.gain", 0.97, "p_em", 0.97, 0.0),
        ("omega_t.gain", 1.005, "omega_t", 1.005, 0.0),
    ],
)
def test_a_wrong_sensor_changes_its_own_channel_alone(
    inject, clean, config, identifier, value, channel, factor, offset
):
    """Neither the engine nor its control nor the references notice; the noise is the same as before."""
    log = inject(CatalogueEffect(identifier, value))
    for name, values in clean.truth.items():
        assert np.array_equal(log.truth[name], values), name
    for name, values in clean.channels.items():
        assert np.array_equal(log.channels[name], values) == (name != channel), name
    moved = log.channels[channel] - clean.channels[channel]
    wanted = (factor - 1.0) * clean.truth[channel] + offset
    # both are rounded to the sensor's smallest step
    np.testing.assert_allclose(moved, wanted, atol=1.001 * getattr(config.simulation.sensors.quantisation, channel))


# --- references -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("identifier", ["leak.intake", "maf.gain", "u_delta.gain", "maf.delay"])
def test_references_are_the_surface_and_the_flow_at_the_true_operating_point(inject, config, identifier):
    from lpvobs.simulation.readings import surface_error

    size = {"leak.intake": 4e-5, "maf.gain": 1.1, "u_delta.gain": 1.2, "maf.delay": 0.5}[identifier]
    log = inject(CatalogueEffect(identifier, size))
    true = log.truth
    error = surface_error(config.simulation.surface, true["u_delta"], true["n_e"], true["W_c"])
    assert np.array_equal(log.channels["ref_W_c"], true["W_c"])
    assert np.array_equal(log.channels["ref_delta_W_c"], error)
