"""Effects in the observer: corrections undone, flows and inputs that physics gives, and a map that agrees with the tracer's."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.discovery.known_effects import KnownEffect, Span
from lpvobs.discovery.map_prior import free_map
from lpvobs.discovery.observed import Refined, _innovations, added, corrected, observed
from lpvobs.discovery.refine import refine
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.observer.estimate import Point, estimate_default, of_parts
from lpvobs.observer.parts import StateGain, inform_observed
from lpvobs.simulation.effects import CatalogueEffect

L = np.array([[2215.0, -4.2, 156.0, 0.0], [-113.0, 2129.0, -88.0, 0.0], [55.0, -1.1, 2015.0, 0.0]])
OUTPUTS = ("p_im", "p_em", "omega_t")


def effect(name, parameter, value, width=0.0, begin=-np.inf, end=np.inf):
    return KnownEffect(
        name, "", parameter, "1", value, (value - width, value + width), (Span("drive", "", begin, end),), True, None
    )


@pytest.fixture(scope="module")
def model(plant, config):
    """Return a function from effects to the model that the observer is given."""
    return lambda *effects: Refined(plant, Diesel(config.engine), OUTPUTS, L, config.estimate.smoothing, effects)


@pytest.fixture(scope="module")
def settings(config):
    return config.estimate.of_engine(Diesel(config.engine).usual_tolerance)


@pytest.fixture(scope="module")
def healthy(clean, config, settings):
    return estimate_default(Diesel(config.engine), config.grid(), StateGain(OUTPUTS, L), [clean], settings)


def estimated(refined, log, config, settings, deviation=()):
    at = Point(refined.air_path, settings, dict(deviation))
    refined = replace(refined, air_path=at.air_path)
    found = [(observed(refined, log), log["W_maf"])]
    part = inform_observed(refined.air_path, config.grid(), None, log, found, settings, at.unknowns)
    return of_parts(config.grid(), [part], at)


@pytest.mark.slow
def test_without_effects_it_is_the_observer_of_before(model, clean, config, settings, healthy):
    again = estimated(model(), clean, config, settings, healthy.engine.point)
    # The same windows of the same samples; a log read in stretches rounds some sums otherwise.
    np.testing.assert_allclose(again.theta, healthy.theta, rtol=0, atol=1e-10)
    np.testing.assert_allclose(again.standard_error, healthy.standard_error, rtol=1e-9)


def test_a_correction_undoes_a_reading_where_it_acts(model, clean, misread):
    gained = misread(clean, clean["W_maf"] * np.where(clean.time >= 100.0, 1.06, 1.0))
    undone = corrected(model(effect("maf.gain", "factor", 1.06, begin=100.0)), gained)
    assert undone["W_maf"] == pytest.approx(clean["W_maf"], rel=1e-12)
    shifted = replace(clean, channels={**clean.channels, "p_im": clean["p_im"] + 1500.0})
    assert corrected(model(effect("p_im.offset", "offset", 1500.0)), shifted)["p_im"] == pytest.approx(clean["p_im"])


def test_a_leak_empties_the_manifold_by_what_escapes(model, clean, config):
    area = 1e-5
    c = Diesel(config.engine).constants
    inputs, flow = added(model(effect("leak.intake", "area", area)), clean, {})
    boosted = np.flatnonzero(clean["p_im"] > 1.05 * clean["p_amb"])[::200]
    p, T, out = (clean[name][boosted] for name in ("p_im", "T_im", "p_amb"))
    g = c.gamma_a
    ratio = np.maximum(out / p, (2.0 / (g + 1.0)) ** (g / (g - 1.0)))
    escapes = area * p / np.sqrt(c.R_a * T)
    escapes *= np.sqrt(2.0 * g / (g - 1.0) * (ratio ** (2.0 / g) - ratio ** ((g + 1.0) / g)))  # Saint-Venant
    assert inputs[boosted, 0] == pytest.approx(-c.R_a * T / c.V_im * escapes, rel=1e-9)
    assert flow[0, boosted] == pytest.approx(0.0, abs=1e-15)  # the compressor does not know of it
    assert flow[1, boosted] == pytest.approx(
        escapes, rel=1e-9
    )  # it has to pass what the cylinders take and what escapes


def test_a_tired_turbine_pushes_less(model, clean, config):
    inputs, flow = added(model(effect("turbine.efficiency", "factor", 0.9)), clean, {})
    whole, _ = added(model(effect("turbine.efficiency", "factor", 0.8)), clean, {})
    assert np.all(flow == 0.0)
    assert np.all(inputs[:, 2] <= 0.0)
    assert whole[:, 2] == pytest.approx(2.0 * inputs[:, 2], rel=1e-9)  # the power is proportional to the factor
    power = Diesel(config.engine).trajectory(clean, OUTPUTS).E[:, 2]  # of the turbine, over J_t omega_t
    assert inputs[:, 2] == pytest.approx(-0.1 * power, rel=1e-6)


def slowed(flow, time, tau):
    """Return the first-order response to a signal that runs straight between samples, exactly."""
    out = flow.copy()
    for k in range(1, out.size):
        h = time[k] - time[k - 1]
        slope = (flow[k] - flow[k - 1]) / h
        out[k] = flow[k] - tau * slope + (out[k - 1] - flow[k - 1] + tau * slope) * np.exp(-h / tau)
    return out


@pytest.mark.slow
def test_behind_a_slow_sensor_the_state_tells_of_the_flow(model, clean, misread):
    plain = observed(model(), clean)
    flow, time, tau = clean["W_maf"] - plain.z[0], clean.time, 0.08
    exact = misread(clean, slowed(flow + 0.003, time, tau))  # reads 3 g/s too much, and late
    found = observed(model(effect("maf.lag", "tau", tau)), exact)
    z = found.z[0]
    late = time > 1.0  # ten time constants: the first state is not known
    wrong, unaided = (np.sqrt(np.mean((left[late] - 0.003) ** 2)) for left in (z, exact["W_maf"] - flow))
    assert (
        wrong < 0.02 * unaided
    )  # the reading bends between samples and is taken as straight there: h^2 / 12 of what bends
    quick = observed(model(effect("maf.lag", "tau", tau, begin=200.0)), exact)
    before = time < 200.0
    assert exact["W_maf"][before] - quick.z[0, before] == pytest.approx(flow[before], abs=1e-12)  # rounding


def test_the_sensors_state_is_of_second_order_in_the_step():
    def wrong(h):
        time = np.arange(0.0, 60.0, h)
        flow = 0.05 + 0.02 * np.sin(3.0 * time)
        z = _innovations(time, slowed(flow + 0.003, time, 0.08), flow, np.full(time.size, 0.08), 40.0)
        return float(np.sqrt(np.mean((z[time > 2.0] - 0.003) ** 2)))

    assert wrong(0.02) / wrong(0.01) == pytest.approx(4.0, rel=0.1)


@pytest.mark.proof
def test_the_map_is_that_of_the_quick_sensor_and_agrees_with_the_tracers(
    model, clean, misread, plant, config, settings, healthy
):
    slow = misread(clean, slowed(clean["W_maf"], clean.time, 0.08))
    found = refine(plant, config.grid(), free_map(config.grid(), len(config.estimate.tolerance), 0.1), [slow])
    assert [item.id for item in found.known_effects] == ["maf.lag"]
    refined = estimated(model(*found.known_effects), slow, config, settings)
    unrefined = estimated(model(), slow, config, settings)
    known = refined.supported & (healthy.standard_error < 1e-3)

    def away(estimate):
        return float(np.sqrt(np.mean((estimate.theta - healthy.theta)[known] ** 2)))

    assert away(refined) < 0.2 * away(unrefined)
    theta, variance = found.after.theta, np.diag(found.after.covariance)[: found.after.p]
    spread = np.sqrt(refined.standard_error**2 + variance.reshape(refined.theta.shape))
    apart = (np.abs(refined.theta - theta.reshape(refined.theta.shape)) / spread)[known]
    assert np.mean(apart < 1.645) > 0.9


@pytest.mark.proof
def test_a_hole_in_the_intake_of_the_simulator_is_taken_out_of_the_map(model, record, plant, config, settings, healthy):
    """The plant has a hole, put there by formulas of its own; nobody is told."""
    log = record(effects=[CatalogueEffect("leak.intake", 2e-5)])
    found = refine(plant, config.grid(), free_map(config.grid(), len(config.estimate.tolerance), 0.1), [log])
    (leak,) = found.known_effects
    assert leak.id == "leak.intake"
    assert leak.value == pytest.approx(2e-5, rel=0.05)
    known = (healthy.standard_error < 1e-3) & np.isfinite(healthy.theta)

    def away(estimate):
        return float(np.sqrt(np.nanmean((estimate.theta - healthy.theta)[known] ** 2)))

    # The engine's unknowns take most of a hole upon themselves: 0.28 g/s are left without the effect, 0.04 with it.
    unaided = away(estimated(model(), log, config, settings))
    assert away(estimated(model(*found.known_effects), log, config, settings)) < 0.2 * unaided
