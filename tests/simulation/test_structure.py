"""A plant of another structure: each form changes what it says and nothing else, and none of them is the engine of the model."""

from dataclasses import fields, replace

import numpy as np
import pytest

from lpvobs.engines.diesel.lpv import INPUTS, Diesel, along
from lpvobs.simulation import instruments, integrate, structure
from lpvobs.simulation.instruments import RECORDER
from lpvobs.simulation.parameters import Structure
from lpvobs.simulation.plant import Inputs, compressor_flow, cylinder_flow, egr_flow, plant_of, turbine_flow
from lpvobs.simulation.simulate import simulate

FORMS = tuple(item.name for item in fields(Structure))
FILLING = ("wave", "residual_gas", "charge_heating")
STATES = (
    np.array([1.1e5, 1.3e5, 0.2, 0.15, 8000.0, 30.0, 30.0, 40.0, 315.0]),
    np.array([2.0e5, 2.4e5, 0.23, 0.1, 14000.0, 20.0, 20.0, 60.0, 330.0]),
    np.array([1.0e5, 0.99e5, 0.23, 0.2, 3000.0, 60.0, 60.0, 80.0, 300.0]),
)
GIVEN = Inputs(1700.0, 18.0, 30.0, 40.0, 98e3, 298.0, 365.0, 8.0)


@pytest.fixture(scope="module")
def form(config, cycle):
    """Return a function that drives the short cycle through a plant with some forms."""

    def run(**amplitudes):
        structure = Structure(**amplitudes)
        return simulate(config.engine, replace(config.simulation, structure=structure), cycle)

    return run


def flows(config, x, **amplitudes):
    plant = plant_of(config.engine, replace(config.simulation, structure=Structure(**amplitudes)))
    return integrate.flows(plant, x, GIVEN)


def changed(config, x, **amplitudes):
    """Return the names of the flows, temperatures and powers that differ from those of the model's engine."""
    one, other = flows(config, x), flows(config, x, **amplitudes)
    return {name for name in one._fields if getattr(one, name) != getattr(other, name)}


@pytest.mark.parametrize("x", STATES)
def test_without_forms_the_plant_is_that_of_the_model_to_the_bit(config, x):
    plant, f = plant_of(config.engine, config.simulation), flows(config, x)
    p_im, p_em, T_im, omega_t, u_vgt = x[0], x[1], x[8], x[4], x[7]
    assert f.W_ei == cylinder_flow(plant, p_im, GIVEN.n_e, T_im)
    assert f.W_c == compressor_flow(plant, p_im, omega_t, GIVEN.p_amb, GIVEN.T_amb)
    assert f.W_egr == egr_flow(plant, p_im, p_em, f.u_egr, T_im, f.T_em)
    assert f.W_t == turbine_flow(plant, p_em, u_vgt, f.T_em, GIVEN.p_amb)[0]


@pytest.mark.parametrize(
    ("name", "touched"),
    [
        ("egr", {"W_egr"}),
        ("compressor", {"W_c", "charge_warming", "P_c"}),
        ("turbine", {"W_t", "P_t"}),
        ("pipes", {"W_c", "charge_warming", "P_c"}),
        ("thermocouple", {"charge_warming"}),
        ("maf_element", set()),
        ("rasters", set()),
    ],
)
def test_a_form_changes_its_component_alone(config, name, touched):
    """At the same state; the engine behind the state moves of course."""
    for x in STATES[:2]:
        assert changed(config, x, **{name: 1.0}) == touched


@pytest.mark.parametrize("name", FILLING)
def test_a_form_of_the_filling_changes_what_the_cylinders_make_of_it(config, name):
    """The air decides the exhaust temperature and with it the flows of EGR and turbine; the compressor sees nothing of it."""
    touched = changed(config, STATES[0], **{name: 1.0})
    assert "W_ei" in touched
    assert not touched & {"W_c", "P_c", "u_delta", "charge_warming"}


@pytest.mark.parametrize("name", FORMS)
def test_amplitudes_scale_a_form(config, name):
    """Half the amplitude is between nothing and all of it, for every flow that the form touches."""
    for x in STATES[:2]:
        none, half, one = (flows(config, x, **{name: size}) for size in (0.0, 0.5, 1.0))
        for flow in changed(config, x, **{name: 1.0}) & {"W_ei", "W_c", "W_t"}:
            a, b, c = (getattr(f, flow) for f in (none, half, one))
            assert min(a, c) < b < max(a, c), flow


@pytest.mark.parametrize("name", FORMS)
def test_truth_stays_true(form, config, name):
    """Mass is conserved in the intake manifold, whatever the form: Eq. (1) with the term in dT_im/dt on the true signals."""
    T = form(**{name: 1.0}).truth
    h, inside = 0.01, slice(1, -1)
    rate = {key: (T[key][2:] - T[key][:-2]) / (2 * h) for key in ("p_im", "T_im")}
    a_1 = config.engine.gas.R_a * T["T_im"][inside] / config.engine.geometry.V_im
    flow = (T["W_c"] + T["W_egr"] - T["W_ei"])[inside]
    wanted = a_1 * flow + T["p_im"][inside] / T["T_im"][inside] * rate["T_im"]
    # as in test_agreement: the third derivative of signals whose fastest part takes some 20 ms
    assert np.median(np.abs(rate["p_im"] - wanted)) < 0.01 * np.sqrt(np.mean(rate["p_im"] ** 2))


@pytest.mark.slow
def test_all_forms_together_leave_a_drivable_engine(form, config):
    """A long way from the model (the estimator's relations on true signals), and still near the set-points of its control."""
    log = form(**dict.fromkeys(FORMS, 1.0))
    T = log.truth
    rho, _ = along(Diesel(config.engine).constants, tuple(T[name] for name in INPUTS))
    filling = rho[:, 2] * T["p_im"] / T["W_ei"] - 1.0
    assert 0.005 < np.std(filling) < 0.08
    assert T["p_im"].max() > 1.5e5
    assert all(np.isfinite(values).all() for values in log.channels.values())


def test_the_thermocouple_is_late_by_seconds(form):
    log = form(thermocouple=1.0)
    fast, slow = log.truth["T_em"], log.channels["T_em"]
    lags = np.arange(0, 400)
    moved = fast - fast.mean()
    match = [np.corrcoef(moved[: moved.size - k], slow[k:])[0, 1] for k in lags]
    assert 0.3 < 0.01 * lags[np.argmax(match)] < 3.0
    assert np.std(slow) < 0.8 * np.std(fast)


def test_the_intercooler_follows_the_vehicle(config):
    x = STATES[1]
    plant = plant_of(config.engine, replace(config.simulation, structure=Structure(thermocouple=1.0)))
    standing, fast = (integrate.flows(plant, x, GIVEN._replace(v_air=v)).charge_warming for v in (0.0, 30.0))
    assert standing > 1.5 * fast


def test_the_hot_film_is_late_and_its_mean_error_is_part_of_the_truth(form, clean):
    log = form(maf_element=1.0)
    np.testing.assert_array_equal(log.truth["W_c"], clean.truth["W_c"])
    misread = log.truth["delta_W_c"] - clean.truth["delta_W_c"]
    assert np.all(misread <= 0.0)
    assert -0.05 < (misread / log.truth["W_c"]).min() < -0.002
    true = log.truth["W_c"] + log.truth["delta_W_c"]
    error, slope = log.truth["W_maf"] - true, np.gradient(true, 0.01)
    lag = -(error @ slope) / (slope @ slope)
    assert 0.014 < lag < 0.031


def test_rasters_hold_and_round_each_channel(form):
    log = form(rasters=1.0)
    for name, raster in ((name, raster) for name, (raster, _) in RECORDER.items() if raster):
        readings = log.channels[name]
        assert np.mean(np.diff(readings) != 0.0) <= 0.01 / raster + 0.01, name
    for name, (_, step) in RECORDER.items():
        np.testing.assert_allclose(log.channels[name] / step, np.round(log.channels[name] / step), atol=1e-6)
    np.testing.assert_array_equal(log.channels["p_amb"], 98e3)


@pytest.mark.parametrize("rate", [20.0, 33.0, 400.0])
def test_slow_sensors_show_the_same_at_any_rate(config, cycle, form, rate):
    structure = Structure(thermocouple=1.0, maf_element=1.0)
    log = simulate(config.engine, replace(config.simulation, structure=structure), cycle, rate=rate)
    whole = form(thermocouple=1.0, maf_element=1.0)
    late = np.interp(log.channels["time"], whole.channels["time"], whole.truth["W_maf"])
    # ripple between two samples at 100 Hz and the finer steps of other rates
    assert np.std(late - log.truth["W_maf"]) < 0.02 * np.std(late)
    assert log.channels["time"].size == round(rate * whole.channels["time"][-1]) + 1


@pytest.mark.parametrize("amplitude", [-0.1, 2.1, float("nan")])
def test_an_amplitude_beyond_all_diesels_is_refused(amplitude):
    with pytest.raises(ValueError, match="wave must lie between 0 and 2"):
        Structure(wave=amplitude)


def test_the_forms_are_frozen(config):
    """What they gave at one point when they were frozen: whoever corrects a model for them must not move them."""
    everything = replace(config.simulation, structure=Structure(compressor=1.0, pipes=1.0, turbine=1.0))
    plant = plant_of(config.engine, everything)
    air = structure.compressor_stage(plant, 1.3e5, 9000.0, 98e3, 298.0, 700.0)
    found = (
        structure.wave(1700.0, 1.3e5, 320.0),
        structure.residual_gas(1700.0, 1.3e5, 1.6e5, 17.5),
        structure.charge_heating(310.0, 365.0, 25.0),
        structure.area_factor(1.0, 20.0, -1.1104e-4, 1.7781e-2),
        structure.pulsation(1.0, 1700.0, 18.0, 700.0),
        air.W_c,
        air.loss,
        air.warming,
        structure.turbine_inlet(1.0, 700.0, 298.0, 25.0),
        structure.turbine_area(plant, 40.0, 9000.0, 700.0),
        structure.turbine_factor(1.0, 40.0, 1700.0),
        instruments.cooler_effectiveness(1.0, 0.7, 5.0, 25.0),
        instruments.rectified(1.0, np.array([1200.0]), np.array([20.0]))[0],
    )
    frozen = (
        0.01717988786, 0.02501955009, 0.002416579832, 1.110440542, 0.08863296206, 0.04520035626, 0.9493366575, 2.772901351,
        682.0220135, 0.8357251543, 1.015602086, 0.4852565451, -0.01115107,
    )  # fmt: skip
    np.testing.assert_allclose(found, frozen, rtol=1e-6)  # the digits that are written here
