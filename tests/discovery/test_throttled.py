"""The closed loop on a throttled engine: a small simulator of its own is the truth, faults are put into sensors and plant."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from reference import throttled_drive as truth
from repository import LIU_ICE

from lpvobs.discovery.imbalances import imbalances_at, scenes_with
from lpvobs.discovery.map_prior import free_map, nominal_map
from lpvobs.discovery.refine import refine
from lpvobs.discovery.residual import Term, lay_out
from lpvobs.engines.effects import Signals
from lpvobs.engines.throttled.balances import BALANCES, Imbalances
from lpvobs.engines.throttled.effects import residual_model
from lpvobs.engines.throttled.learning import errors_of, learn
from lpvobs.engines.throttled.lpv import Throttled
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import load_config

ONSET = 150.0
WRONG = {
    "maf.gain": ("W_maf", lambda x: 1.10 * x),
    "p_im.gain": ("p_im", lambda x: 0.80 * x),
    "p_ic.gain": ("p_ic", lambda x: 0.92 * x),
    "p_im.offset": ("p_im", lambda x: x + 6000.0),
    "alpha_th.offset": ("alpha_th", lambda x: x + 1.0),
    "u_delta.gain": ("m_f", lambda x: 1.12 * x),
}
"""Channel that a wrong sensor reads, and what it makes of it."""


@pytest.fixture(scope="module")
def config():
    return load_config(LIU_ICE)[0]


@pytest.fixture(scope="module")
def healthy():
    return truth.log_of(truth.noisy(truth.drive(600.0, seed=1), 2), "healthy")


@pytest.fixture(scope="module")
def model(config, healthy):
    learned, errors = learn(config.engine, [healthy]), errors_of(config.engine, [healthy])
    return residual_model(config, Throttled(config.engine, learned), errors, {healthy.sha256}, None)


@pytest.fixture(scope="module")
def another_day():
    return truth.noisy(truth.drive(400.0, seed=3), 4)


@pytest.fixture(scope="module")
def judge(model, config):
    """Return a function from channels to what is found: the healthy log's map, which is zero, stands."""
    grid = config.grid()
    none = np.zeros(grid.shape)
    prior = nominal_map(none, np.zeros((grid.size, grid.size)), np.zeros((0, *grid.shape)), np.zeros((0, 0)), 0.1)
    prior = replace(prior, sensitivity=np.zeros((grid.size, len(model.names))))
    return lambda channels, name="today", known=(): refine(
        model, grid, prior, [truth.log_of(channels, name)], known=known
    )


@pytest.fixture(scope="module")
def in_order(judge, another_day):
    """Return what is found on the other day when nothing is wrong."""
    return judge(another_day).trace


@pytest.fixture(scope="module")
def misread(judge, another_day):
    """Return a function from a wrong sensor to what is found on the other day."""
    return cache(lambda name: judge(since(another_day, *WRONG[name])).trace)


def since(channels, name, change, onset=ONSET):
    return {**channels, name: np.where(channels["time"] >= onset, change(channels[name]), channels[name])}


def lagged(values, tau):
    out = values.copy()
    for k in range(1, out.size):
        out[k] = out[k - 1] + 0.05 / (tau + 0.05) * (values[k] - out[k - 1])
    return out


def test_an_engine_in_order_is_found_in_order(in_order):
    assert in_order.verdict == "none"
    assert in_order.findings == ()


@pytest.mark.slow
def test_the_log_that_taught_the_engine_is_judged_by_parts_it_was_not_learned_from(model, healthy, config):
    free = free_map(config.grid(), len(model.names), config.estimate.prior_map)
    problem = lay_out(model, config.grid(), free, [healthy])
    fitted = Imbalances(config.engine)(model.constants, problem.signals, problem.blocks)
    filling = BALANCES.index("filling")
    held_out = (fitted + problem.offset)[filling]
    # What was fitted is always a little smaller than what was not.
    assert np.median(np.abs(fitted[filling])) < np.median(np.abs(held_out))
    assert refine(model, config.grid(), free, [healthy]).trace.verdict == "none"


def test_an_effect_and_its_level_of_the_day_are_taken_out_at_once(model, config, another_day):
    """Two shifts in time, one after the other, would blur the sensor twice, and tell the day from the fault by that."""
    problem = lay_out(
        model, config.grid(), free_map(config.grid(), len(model.names), 0.1), [truth.log_of(another_day, "a")]
    )
    effect, none = model.effect("maf.delay"), np.zeros(problem.spread.size)
    (place,) = (i for i, (_, level) in enumerate(problem.levels, len(model.names)) if level.name == effect.id)
    day = none.copy()
    day[place] = 0.125
    both = imbalances_at(problem, scenes_with(problem, [Term(effect, 0.25)], day), day)
    at_once = imbalances_at(problem, scenes_with(problem, [Term(effect, 0.375)], none), none)
    np.testing.assert_array_equal(both, at_once)
    # What acts from an onset on leaves the day's own shift before it.
    onset = float(problem.clock[problem.K // 2])
    later = imbalances_at(problem, scenes_with(problem, [Term(effect, 0.25, onset)], day), day)
    before = problem.clock < onset
    own = imbalances_at(problem, scenes_with(problem, [], day), day)
    np.testing.assert_array_equal(later, np.where(before, own, at_once))


@pytest.mark.parametrize(
    ("name", "true", "width"),
    [
        pytest.param("p_im.gain", 0.80, 0.02, marks=pytest.mark.proof),  # quick below, where a channel is missing
        pytest.param("maf.gain", 1.10, 0.02, marks=pytest.mark.slow),
        pytest.param("p_ic.gain", 0.92, 0.02, marks=pytest.mark.proof),
        pytest.param("p_im.offset", 6000.0, 900.0, marks=pytest.mark.proof),
        pytest.param("alpha_th.offset", 1.0, 0.15, marks=pytest.mark.proof),
        pytest.param("u_delta.gain", 1.12, 0.03, marks=pytest.mark.proof),
    ],
)
def test_a_wrong_sensor_is_named_sized_and_dated(misread, name, true, width):
    found = misread(name)
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


@pytest.mark.proof
def test_a_lag_of_the_sensor_is_told_from_its_gain(judge, another_day):
    found = judge(since(another_day, "W_maf", lambda w: lagged(w, 0.5))).trace
    assert found.verdict == "effect"
    first = found.findings[0]
    # A first-order response of half a second and half a second of dead time differ within blocks of two seconds by little.
    assert first.id in ("maf.lag", "maf.delay")
    (size,) = first.parameters.values()
    assert 0.3 < size.value < 0.7


@pytest.mark.proof
def test_a_leak_of_the_plant_is_told_from_a_wrong_pressure_and_a_wrong_sensor(judge):
    leaking = truth.noisy(truth.drive(400.0, seed=3, leak=8e-6, onset=ONSET), 4)
    closed = judge(leaking)
    first = closed.trace.findings[0]
    assert first.id == "leak.intake"
    (size,) = first.parameters.values()
    assert abs(size.value - 8e-6) < 8e-7  # a tenth
    assert abs(first.onset - ONSET) < 10.0
    moved = {item.balance: item for item in closed.trace.logs[0].balances if item.affected}
    assert set(moved) == {"filling", "fuel"}
    for item in moved.values():
        assert item.recovered > 0.7  # the least that is asked for


@pytest.mark.proof
def test_an_effect_that_ends_has_an_end(judge, another_day):
    between = (another_day["time"] >= 100.0) & (another_day["time"] < 250.0)
    wrong = {**another_day, "W_maf": np.where(between, 0.85, 1.0) * another_day["W_maf"]}
    first = judge(wrong).trace.findings[0]
    # In air of one density a sensor that reads too little is a hole that takes its share: no drive here tells them apart.
    assert {"maf.gain", "leak.inlet"} == {first.id, *first.indistinguishable}
    assert abs(first.onset - 100.0) < 10.0
    assert abs(first.end - 250.0) < 10.0


@pytest.mark.proof
def test_two_faults_are_both_found(judge, another_day):
    wrong = since(since(another_day, "W_maf", lambda x: 1.12 * x), "p_im", lambda x: 0.88 * x, 250.0)
    found = judge(wrong).trace
    assert {item.id for item in found.findings} == {"maf.gain", "p_im.gain"}


def test_a_day_that_differs_by_one_and_a_half_per_cent_is_no_fault_but_is_reported(judge, another_day, in_order):
    level = {item.name: item for item in in_order.logs[0].day_to_day}
    wrong = {**another_day, "W_maf": 1.015 * another_day["W_maf"]}
    found = judge(wrong).trace
    assert found.verdict == "none"
    moved = {item.name: item.value - level[item.name].value for item in found.logs[0].day_to_day}
    # One per cent and a half of flow in each of the three flow balances; part of it may go to a pressure or to the throttle.
    assert 0.005 < moved["fuel"] < 0.02


@pytest.mark.proof
def test_what_no_effect_explains_is_not_named(judge, another_day):
    slow = 1.0 + 0.25 * np.sin(2.0 * np.pi * another_day["time"] / 45.0)
    wrong = {**another_day, "W_maf": slow * another_day["W_maf"]}
    found = judge(wrong).trace
    assert found.verdict == "unexplained"
    assert found.findings == ()


@pytest.mark.parametrize(
    ("missing", "lost"),
    [
        ("p_amb", "ambient"),
        *(pytest.param(*gone, marks=pytest.mark.proof) for gone in (("alpha_th", "throttle"), ("m_f", "fuel"))),
    ],
)
@pytest.mark.slow
def test_missing_channels_leave_the_other_balances_and_are_told(judge, another_day, missing, lost):
    wrong = since(another_day, "W_maf", lambda x: 1.15 * x)
    part = judge({name: x for name, x in wrong.items() if name != missing}).trace.logs[0]
    assert missing in part.missing.channels
    assert lost in part.missing.balances
    assert any("maf.gain" in group for group in part.missing.same_place)
    first = part.effects[0]
    assert "maf.gain" in (first.id, *first.indistinguishable)
    if first.id == "maf.gain":
        assert abs(first.parameters["factor"].value - 1.15) < 0.02
    assert abs(first.onset - ONSET) < 10.0  # as above
    assert lost not in [item.balance for item in part.balances]


@pytest.mark.slow
def test_json_holds_the_contract_and_the_balances(misread, in_order):
    shown = misread("p_im.gain").as_json(refined=True)
    assert shown["verdict"] == "effect"
    assert shown["effects"][0]["id"] == "p_im.gain"
    assert shown["error"]["after"] < shown["error"]["before"]
    assert shown["error"]["unit"] == "kg/s"
    (part,) = shown["logs"]
    assert [item["balance"] for item in part["balances"]] == list(BALANCES)
    assert {"name", "value", "unit", "usual"} == set(part["day_to_day"][0])
    assert part["log"] == "today"
    for found in (misread("p_im.gain"), in_order):
        assert "after" not in found.as_json(refined=False)["error"]


@pytest.mark.proof
def test_a_refined_model_knows_its_effects_and_finds_no_more(judge, another_day):
    wrong = since(another_day, "p_ic", lambda x: 0.92 * x)
    found = judge(wrong)
    names = {item.id for item in found.known_effects}
    assert names == {"p_ic.gain"}
    again = judge(wrong, known=found.known_effects).trace
    assert again.verdict == "none"
    assert {item.id for item in again.known_effects} == names
    # A log that came later has it from its first sample on.
    later = truth.noisy(truth.drive(300.0, seed=8), 9)
    assert judge({**later, "p_ic": 0.92 * later["p_ic"]}, "later", known=found.known_effects).trace.verdict == "none"


def test_a_log_too_short_to_judge_is_refused(judge, another_day):
    short = {name: x[:400] for name, x in another_day.items()}
    with pytest.raises(DataError, match="under a minute"):
        judge(short)


def test_undoing_nothing_changes_nothing(model, config, another_day):
    free = free_map(config.grid(), len(model.names), config.estimate.prior_map)
    signals = lay_out(model, config.grid(), free, [truth.log_of(another_day)]).signals
    for effect in model.catalogue:
        same = effect.apply(signals, effect.null)
        for name, values in signals.value.items():
            np.testing.assert_allclose(same[name], values, rtol=1e-12, err_msg=effect.id)
        np.testing.assert_array_equal(same.lacks, signals.lacks)


@pytest.mark.proof
def test_a_leak_that_is_named_is_taken_out_of_the_flows(model, config, judge):
    """The flow that passes the sensor is what the cylinders take less what the leak lets in: the observer is given that."""
    leaking = truth.noisy(truth.drive(400.0, seed=3, leak=8e-6, onset=ONSET), 4)
    found = judge(leaking)
    log = truth.log_of(leaking)
    there = model.further(model.constants, _with_leak(model, log, found.known_effects[0].value))
    flows, inputs = there
    assert np.all(flows[0] == 0.0)  # the throttle does not know of it
    np.testing.assert_allclose(flows[1], flows[2])
    low = leaking["p_im"] < 0.5 * truth.P_AMB  # choked: the flow hangs on the surroundings alone
    drawn = 8e-6 * truth.orifice(truth.P_AMB, 3e4, truth.T_AMB)
    np.testing.assert_allclose(-flows[1][low], drawn, rtol=0.1)  # a tenth, as the area itself
    assert np.all(inputs[1][low] > 0.0)


def _with_leak(model, log, area):
    return Signals(
        time=log.time,
        clock=log.time,
        value=log.channels,
        rate={},
        lacks=np.tile(np.array([[area], [1.0], [1.0]]), (1, len(log))),
        later=lambda _: log.time,
        slow=lambda _: log.time,
        constants=model.constants,
    )
