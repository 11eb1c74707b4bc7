"""The closed loop on a throttled engine: a small simulator of its own is the truth, faults are put into sensors and plant."""

from dataclasses import replace

import numpy as np
import pytest
from reference import throttled_drive as truth
from repository import LIU_ICE

from lpvobs.discovery.throttled_closing import Nominal, case_of, close
from lpvobs.discovery.throttled_noise import healthy_errors
from lpvobs.engines.throttled.balances import BALANCES, imbalances, scene_of
from lpvobs.engines.throttled.blocks import blocks_of
from lpvobs.engines.throttled.effects import CATALOGUE
from lpvobs.engines.throttled.learning import learn
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import load_config

ONSET = 150.0


@pytest.fixture(scope="module")
def nominal():
    config = load_config(LIU_ICE)[0]
    healthy = truth.log_of(truth.noisy(truth.drive(600.0, seed=1), 2), "healthy")
    errors = healthy_errors(config.engine, [healthy])
    return Nominal(config.engine, learn(config.engine, [healthy]), errors, config.trace, {healthy.sha256: healthy.name})


@pytest.fixture(scope="module")
def another_day():
    return truth.noisy(truth.drive(400.0, seed=3), 4)


def judge(nominal, channels, name="today", frozen=None):
    return close(nominal, [truth.log_of(channels, name)], (), frozen, lambda _: None)


def since(channels, name, change, onset=ONSET):
    return {**channels, name: np.where(channels["time"] >= onset, change(channels[name]), channels[name])}


def lagged(values, tau):
    out = values.copy()
    for k in range(1, out.size):
        out[k] = out[k - 1] + 0.05 / (tau + 0.05) * (values[k] - out[k - 1])
    return out


def test_an_engine_in_order_is_found_in_order(nominal, another_day):
    found = judge(nominal, another_day).trace
    assert found.verdict == "none"
    assert found.findings == ()


def test_the_log_that_taught_the_engine_is_judged_by_parts_it_was_not_learned_from(nominal):
    healthy = truth.log_of(truth.noisy(truth.drive(600.0, seed=1), 2), "healthy")
    case = case_of(nominal, healthy, [healthy], None)
    assert case.own
    scene, blocks = scene_of(healthy), blocks_of(healthy)
    fitted = imbalances(nominal.engine, nominal.learned, blocks, scene)
    held_out = case.imbalances(())
    # What was fitted is always a little smaller than what was not.
    assert np.median(np.abs(fitted[:, 1])) < np.median(np.abs(held_out[:, 1]))
    assert close(nominal, [healthy], (), None, lambda _: None).trace.verdict == "none"


@pytest.mark.parametrize(
    ("name", "channel", "change", "true", "width"),
    [
        ("maf.gain", "W_maf", lambda x: 1.10 * x, 1.10, 0.02),
        ("p_im.gain", "p_im", lambda x: 0.80 * x, 0.80, 0.02),
        ("p_ic.gain", "p_ic", lambda x: 0.92 * x, 0.92, 0.02),
        ("p_im.offset", "p_im", lambda x: x + 6000.0, 6000.0, 900.0),
        ("alpha_th.offset", "alpha_th", lambda x: x + 1.0, 1.0, 0.15),
        ("u_delta.gain", "m_f", lambda x: 1.12 * x, 1.12, 0.03),
    ],
)
def test_a_wrong_sensor_is_named_sized_and_dated(nominal, another_day, name, channel, change, true, width):
    found = judge(nominal, since(another_day, channel, change)).trace
    assert found.verdict == "effect"
    first = found.findings[0]
    assert first.id == name
    (size,) = first.parameters.values()
    # The widths are a quarter to a fifth of the smallest fault of each kind here.
    assert abs(size.value - true) < width
    assert size.ci90[0] < size.value < size.ci90[1]
    assert abs(first.onset - ONSET) < 10.0  # five blocks
    assert first.end is None
    assert first.p_value < 1e-3


def test_a_lag_of_the_sensor_is_told_from_its_gain(nominal, another_day):
    found = judge(nominal, since(another_day, "W_maf", lambda w: lagged(w, 0.5))).trace
    assert found.verdict == "effect"
    first = found.findings[0]
    # A first-order response of half a second and half a second of dead time differ within blocks of two seconds by little.
    assert first.id in ("maf.lag", "maf.delay")
    (size,) = first.parameters.values()
    assert 0.3 < size.value < 0.7


def test_a_leak_of_the_plant_is_told_from_a_wrong_pressure_and_a_wrong_sensor(nominal):
    leaking = truth.noisy(truth.drive(400.0, seed=3, leak=8e-6, onset=ONSET), 4)
    closed = judge(nominal, leaking)
    first = closed.trace.findings[0]
    assert first.id == "leak.intake"
    (size,) = first.parameters.values()
    assert abs(size.value - 8e-6) < 8e-7  # a tenth
    assert abs(first.onset - ONSET) < 10.0
    moved = {item.balance: item for item in closed.trace.logs[0].balances if item.affected}
    assert set(moved) == {"speed-density", "fuel"}
    for item in moved.values():
        assert item.recovered > 0.7  # the least that is asked for


def test_an_effect_that_ends_has_an_end(nominal, another_day):
    between = (another_day["time"] >= 100.0) & (another_day["time"] < 250.0)
    wrong = {**another_day, "W_maf": np.where(between, 0.85, 1.0) * another_day["W_maf"]}
    first = judge(nominal, wrong).trace.findings[0]
    assert first.id == "maf.gain"
    assert abs(first.onset - 100.0) < 10.0
    assert abs(first.end - 250.0) < 10.0


def test_two_faults_are_both_found(nominal, another_day):
    wrong = since(since(another_day, "W_maf", lambda x: 1.12 * x), "p_im", lambda x: 0.88 * x, 250.0)
    found = judge(nominal, wrong).trace
    assert {item.id for item in found.findings} == {"maf.gain", "p_im.gain"}


def test_a_day_that_differs_by_one_and_a_half_per_cent_is_no_fault_but_is_reported(nominal, another_day):
    level = {item.name: item for item in judge(nominal, another_day).trace.logs[0].day}
    wrong = {**another_day, "W_maf": 1.015 * another_day["W_maf"]}
    found = judge(nominal, wrong).trace
    assert found.verdict == "none"
    moved = {item.name: item.value - level[item.name].value for item in found.logs[0].day}
    # One per cent and a half of flow in each of the three flow balances; part of it may go to a pressure or to the throttle.
    assert 0.005 < moved["fuel"] < 0.02


def test_what_no_effect_explains_is_not_named(nominal, another_day):
    slow = 1.0 + 0.25 * np.sin(2.0 * np.pi * another_day["time"] / 45.0)
    wrong = {**another_day, "W_maf": slow * another_day["W_maf"]}
    found = judge(nominal, wrong).trace
    assert found.verdict == "unexplained"
    assert found.findings == ()


@pytest.mark.parametrize(("missing", "lost"), [("alpha_th", "throttle"), ("m_f", "fuel"), ("p_amb", "ambient")])
def test_missing_channels_leave_the_other_balances_and_are_told(nominal, another_day, missing, lost):
    wrong = since(another_day, "W_maf", lambda x: 1.15 * x)
    part = judge(nominal, {name: x for name, x in wrong.items() if name != missing}).trace.logs[0]
    assert missing in part.missing
    assert lost in part.lost
    assert any("maf.gain" in group for group in part.same_place)
    first = part.findings[0]
    assert "maf.gain" in (first.id, *first.indistinguishable)
    assert lost not in [item.balance for item in part.balances]


def test_json_holds_the_contract_and_the_balances(nominal, another_day):
    shown = judge(nominal, since(another_day, "p_im", lambda x: 0.85 * x)).trace.as_json(refined=True)
    assert shown["verdict"] == "effect"
    assert shown["effects"][0]["id"] == "p_im.gain"
    assert shown["error"]["after"] < shown["error"]["before"]
    assert shown["error"]["unit"] == "kg/s"
    names = [item["balance"] for item in shown["balances"]]
    assert names == list(BALANCES)
    assert shown["logs"][0]["log"] == "today"
    assert "after" not in judge(nominal, another_day).trace.as_json(refined=False)["error"]


def test_a_refined_model_knows_its_effects_and_finds_no_more(nominal, another_day):
    wrong = since(another_day, "p_ic", lambda x: 0.9 * x)
    closed = judge(nominal, wrong)
    refined = replace(nominal, had=closed.standing)
    again = judge(refined, wrong).trace
    assert again.verdict == "none"
    assert [item.id for item in again.standing] == ["p_ic.gain"]
    # A log that came later has it from its first sample on.
    later = truth.noisy(truth.drive(300.0, seed=8), 9)
    assert judge(refined, {**later, "p_ic": 0.9 * later["p_ic"]}, "later").trace.verdict == "none"


def test_a_log_too_short_to_judge_is_refused(nominal, another_day):
    short = {name: x[:400] for name, x in another_day.items()}
    with pytest.raises(DataError, match="record a minute"):
        judge(nominal, short)


def test_undoing_nothing_changes_nothing(nominal, another_day):
    scene = scene_of(truth.log_of(another_day))
    for effect in CATALOGUE:
        same = effect.undo(nominal.engine, scene, effect.null)
        for name, values in scene.x.items():
            np.testing.assert_allclose(same.x[name], values, rtol=1e-12, err_msg=effect.id)
        assert not same.extra.any()
        assert same.filling == 1.0
