"""The loop on simulated logs: nothing where nothing is, the right name with its size and time, and an honest `unexplained`."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.discovery.map_prior import free_map, nominal_map
from lpvobs.discovery.refine import refine
from lpvobs.discovery.residual import lay_out
from lpvobs.engines.diesel.effects import diesel_model
from lpvobs.engines.residual_model import DayToDay
from lpvobs.errors import DataError, UsageError

KEYS = {"id", "parameters", "onset", "end", "explained", "p_value", "indistinguishable"}


@pytest.fixture(scope="session")
def closed(plant, config):
    prior = free_map(config.grid(), len(config.estimate.tolerance), 0.1)
    return lambda *logs: refine(plant, config.grid(), prior, logs)


def lagged(signal, time, tau):
    """Return the first-order response to a signal that runs straight between samples, exactly."""
    out = signal.copy()
    for k in range(1, out.size):
        h = time[k] - time[k - 1]
        slope = (signal[k] - signal[k - 1]) / h
        away = out[k - 1] - signal[k - 1] + tau * slope  # from the steady response to the ramp
        out[k] = signal[k] - tau * slope + away * np.exp(-h / tau)
    return out


def test_a_clean_log_has_nothing(closed, clean):
    found = closed(clean)
    assert found.trace.verdict == "none"
    assert found.terms == ()
    assert found.trace.error.ratio == 1.0
    assert found.before is found.after
    assert found.trace.as_json(refined=False)["error"].keys() == {"measure", "unit", "before", "held_out"}


@pytest.mark.slow
def test_a_lag_is_named_with_its_time_constant(closed, clean, misread):
    found = closed(misread(clean, lagged(clean["W_maf"], clean.time, 0.08)))
    (finding,) = found.trace.findings
    assert found.trace.verdict == "effect"
    assert "maf.lag" in (finding.id, *finding.indistinguishable)
    assert finding.onset is None
    assert found.terms[0].size == pytest.approx(
        0.08, rel=0.03
    )  # noise gives a tenth of that; smoothing what fast transients lose
    assert found.trace.error.ratio_ci90[1] < 1.0
    shown = found.trace.as_json(refined=True)
    assert shown["effects"][0].keys() >= KEYS
    assert shown["error"]["ratio"] == pytest.approx(shown["error"]["after"] / shown["error"]["before"])


@pytest.mark.proof
def test_a_step_of_the_gain_has_its_onset(closed, clean, misread):
    found = closed(misread(clean, clean["W_maf"] * np.where(clean.time < 141.7, 1.0, 1.08)))
    (finding,) = found.trace.findings
    assert "maf.gain" in (finding.id, *finding.indistinguishable)
    assert finding.onset == pytest.approx(141.7, abs=1.0)  # s; well under a block
    assert finding.end is None
    assert finding.explained > 0.9


@pytest.mark.proof
def test_an_engine_that_breathes_less_is_the_engine_not_the_sensor(closed, record, config):
    smaller = replace(config.engine, geometry=replace(config.engine.geometry, V_d=0.9 * config.engine.geometry.V_d))
    found = closed(record(smaller))
    assert "eta_vol.factor" in (found.trace.findings[0].id, *found.trace.findings[0].indistinguishable)
    low, high = found.trace.findings[0].parameters["factor"].ci90
    assert low < 0.9 < high


@pytest.mark.slow
def test_a_volume_within_its_tolerance_is_no_fault(closed, record, config):
    """With 1 % for a manifold of which 15 % are stated, sound drives had a `p_value` of 1e-13, and some a name."""
    wider = replace(config.engine, geometry=replace(config.engine.geometry, V_im=1.12 * config.engine.geometry.V_im))
    found = closed(record(wider))
    assert found.trace.verdict == "none"
    assert found.trace.p_value > 0.01
    assert found.beta["V_im"] == pytest.approx(0.12, abs=0.03)


@pytest.mark.proof
def test_a_disturbance_that_comes_and_goes_is_not_named(closed, clean, misread):
    t = clean.time
    on = ((t > 40) & (t < 80)) | ((t > 120) & (t < 150)) | ((t > 210) & (t < 260))
    found = closed(misread(clean, clean["W_maf"] * np.where(on, 1.1, 1.0)))
    assert found.trace.verdict == "unexplained"


@pytest.mark.proof
def test_a_short_episode_far_from_a_long_one_counts(closed, clean, misread):
    t = clean.time
    on = ((t > 62) & (t < 84)) | ((t > 165) & (t < 280))
    found = closed(misread(clean, clean["W_maf"] * np.where(on, 0.9, 1.0)))
    assert found.trace.verdict == "unexplained"


def test_a_logged_channel_is_named(closed, clean, misread):
    rng = np.random.default_rng(6)
    knots = np.arange(-20.0, 330.0, 15.0)
    heat = np.interp(clean.time, knots, rng.standard_normal(knots.size))
    calm = np.interp(clean.time, knots, rng.standard_normal(knots.size))
    found = closed(misread(clean, clean["W_maf"] * (1.0 + 0.05 * heat), {"heat": heat, "calm": calm}))
    assert found.trace.findings[0].id == "channel:heat"
    assert found.trace.findings[0].curve.channel == "heat"


def test_another_channel_that_explains_a_log_as_well_is_in_the_set(closed, clean, misread):
    """A housing's temperature was `channel:humidity` alone, although `channel:T_coolant` explained the drive as well."""
    rng = np.random.default_rng(6)
    knots = np.arange(-20.0, 330.0, 15.0)
    heat, other = (np.interp(clean.time, knots, rng.standard_normal(knots.size)) for _ in range(2))
    alike = {"heat": heat, "warmth": heat + 0.02 * other, "glow": heat - 0.02 * other}
    (finding,) = closed(misread(clean, clean["W_maf"] * (1.0 + 0.02 * heat), alike)).trace.findings
    assert {finding.id, *finding.indistinguishable} == {f"channel:{name}" for name in alike}


@pytest.fixture(scope="module")
def nominal(closed, clean, config):
    """Return the map of the healthy log as what is known before others."""
    healthy, grid = closed(clean).after, config.grid()
    theta, covariance = healthy.theta.reshape(grid.shape), healthy.covariance[: grid.size, : grid.size]
    spread = np.array(list(config.estimate.tolerance.values())) / np.sqrt(3.0)
    seen = np.where(np.sqrt(np.diag(covariance)) < 2e-3, 1.0, np.nan).reshape(grid.shape)
    none = np.zeros((spread.size, *grid.shape))
    return nominal_map(theta * seen, covariance, none, np.diag(spread**2), 0.1)


@pytest.mark.proof
def test_against_a_nominal_map_a_constant_gain_is_an_effect(nominal, clean, misread, plant, config):
    found = refine(plant, config.grid(), nominal, [misread(clean, 1.08 * clean["W_maf"])])
    (finding,) = found.trace.findings
    assert "maf.gain" in (finding.id, *finding.indistinguishable)
    assert found.terms[0].size == pytest.approx(1.08, abs=0.02)


@pytest.mark.slow
def test_what_may_differ_from_day_to_day_is_no_fault(nominal, clean, misread, config):
    day = DayToDay({"maf.gain": 0.03})
    model = diesel_model(config.engine, config.estimate.tolerance, day)
    found = refine(model, config.grid(), nominal, [misread(clean, 1.03 * clean["W_maf"])])
    assert found.trace.verdict == "none"
    (level,) = found.trace.logs[0].day_to_day
    assert (level.name, level.unit, level.usual) == ("maf.gain", "1", 0.03)
    assert level.value == pytest.approx(0.03, abs=0.02)  # the constants' tolerance holds as for an effect of this kind
    with pytest.raises(UsageError, match=r"'maf.gian' is neither a balance nor an effect; expected one of .*maf.gain"):
        diesel_model(config.engine, config.estimate.tolerance, DayToDay({"maf.gian": 0.03}))


@pytest.mark.slow
def test_against_a_nominal_map_a_switch_does_nothing_where_it_is_off(nominal, clean, misread, plant, config):
    on = (np.sin(0.11 * clean.time) + np.sin(0.043 * clean.time) > 0.3).astype(float)
    log = misread(clean, clean["W_maf"] + 0.002 * on, {"compressor": on})
    found = refine(plant, config.grid(), nominal, [log])
    (effect,) = found.known_effects
    assert effect.id == "channel:compressor"
    assert effect.curve.values[0] == 0.0
    if effect.curve.carrier == "maf.offset":
        assert effect.value * effect.curve.values[-1] == pytest.approx(0.002, rel=0.1)  # kg/s


def test_a_short_log_is_refused_in_one_line(plant, config, clean):
    prior = free_map(config.grid(), len(config.estimate.tolerance), 0.1)
    cut = slice(0, 3000)
    short = replace(
        clean,
        time=clean.time[cut],
        channels={name: values[cut] for name, values in clean.channels.items()},
        segments=((0, 3000),),
        rows=clean.rows[cut],
    )
    with pytest.raises(
        DataError, match=r"^drive: the stretches without gaps last under a minute in all; .*record a longer log$"
    ):
        lay_out(plant, config.grid(), prior, [short])
