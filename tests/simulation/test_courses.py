"""Courses of injected effects: the shapes that they promise, written here on their own, and what refuses to be meant."""

import numpy as np
import pytest

from lpvobs.errors import UsageError
from lpvobs.simulation.disturbances import injected_of
from lpvobs.simulation.effects import CATALOGUE, KEYS, CatalogueEffect

TIME = np.arange(0.0, 100.0, 0.5)
TABLES = {
    "always": {},
    "step": {"onset": 40.0},
    "interval": {"onset": 40.0, "end": 60.0},
    "intermittent": {"intervals": [[10.0, 20.0], [40.0, 70.0]]},
    "ramp": {"onset": 40.0, "end": 80.0},
    "saturating": {"onset": 40.0, "time_constant": 10.0},
    "hysteresis": {"input": "u_delta", "low": 10.0, "high": 30.0},
    "lagged": {"input": "u_delta", "from": 0.0, "to": 40.0, "time_constant": 10.0},
}
LOAD = np.where((TIME >= 20.0) & (TIME < 50.0), 40.0, np.where(TIME < 75.0, 20.0, 0.0))


def effect(course, identifier="leak.intake", parameter="area", value=2e-5, **keys):
    return injected_of({"id": identifier, parameter: value, "course": course, **keys})


def share(course, **keys):
    found = effect(course, **(TABLES[course] | keys))
    return found.along(TIME, {"u_delta": LOAD}).share(TIME)


EXPECTED = {
    "always": TIME >= 0.0,
    "step": TIME >= 40.0,
    "interval": (TIME >= 40.0) & (TIME < 60.0),
    "intermittent": ((TIME >= 10.0) & (TIME < 20.0)) | ((TIME >= 40.0) & (TIME < 70.0)),
    "ramp": np.clip((TIME - 40.0) / 40.0, 0.0, 1.0),
    "saturating": np.where(TIME > 40.0, 1.0 - np.exp(-(TIME - 40.0) / 10.0), 0.0),
    "hysteresis": (TIME >= 20.0)
    & (TIME < 75.0),  # from 40 mg on, over the 20 mg between the limits, until there is none
}


@pytest.mark.parametrize("course", EXPECTED)
def test_a_course_has_its_shape(course):
    assert share(course) == pytest.approx(EXPECTED[course].astype(float), abs=1e-12)


def test_a_lagged_course_follows_the_differential_equation():
    """Explicit Euler in steps a thousandth of the time constant, against the exact filter between samples half a second apart."""
    state, found = 0.5 * 40.0, []
    for now in TIME:
        found.append(state / 40.0)
        for part in range(50):
            load = np.interp(now + 0.01 * part, TIME, LOAD)
            state += 0.001 * (load - state)
    assert share("lagged") == pytest.approx(np.array(found), abs=2e-3)


def test_a_ramp_without_an_end_is_whole_at_the_end_of_the_drive():
    found = share("ramp", end=None)
    assert found[-1] == 1.0
    assert found[TIME == 69.75 - 0.25] == pytest.approx(29.5 / 59.5)


def test_every_course_is_there_and_no_further():
    assert set(TABLES) == set(KEYS)
    for name in TABLES:
        assert share(name).min() >= 0.0
        assert share(name).max() <= 1.0


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"course": "bend"}, "expected one of always, step"),
        ({"course": "step"}, "needs the key 'onset'"),
        ({"course": "step", "onset": 3.0, "time_constant": 2.0}, "unknown key 'time_constant'"),
        ({"course": "saturating", "onset": 1.0, "time_constant": 0.0}, "a number above zero"),
        ({"course": "hysteresis", "input": "n_e", "low": 3e3, "high": 2e3}, "swap them"),
        ({"course": "lagged", "input": "n_e", "from": 1.0, "to": 1.0, "time_constant": 5.0}, "two different numbers"),
        ({"course": "intermittent", "intervals": []}, "'intervals' is missing or empty"),
        ({"course": "intermittent", "intervals": [[30.0, 50.0], [10.0, 20.0]]}, "overlap or are not in order of time"),
        ({"course": "intermittent", "intervals": [10.0, 20.0]}, "list of pairs"),
        ({"intervals": [[10.0, 20.0]]}, "unknown key 'intervals'"),
    ],
)
def test_a_course_that_cannot_be_meant_is_refused(keys, told):
    with pytest.raises(UsageError, match=told):
        injected_of({"id": "leak.intake", "area": 2e-5, **keys})


def test_a_delay_is_there_or_it_is_not():
    with pytest.raises(UsageError, match="either on or off"):
        effect("ramp", "maf.delay", "delay", 0.05, onset=3.0)


def test_an_input_that_the_drive_does_not_have_is_named(inject):
    with pytest.raises(UsageError, match="no input 'T_oil'; expected one of n_e, u_delta"):
        inject(effect("hysteresis", input="T_oil", low=1.0, high=2.0))


def test_a_gain_that_grows_changes_the_reading_by_its_share(inject, clean):
    log = inject(effect("ramp", "maf.gain", "factor", 1.1, onset=4.0, end=14.0))
    time = clean.channels["time"]
    grown = log.truth["W_maf"] / clean.truth["W_maf"] - 1.0
    assert grown == pytest.approx(0.1 * np.clip((time - 4.0) / 10.0, 0.0, 1.0), abs=1e-9)


def test_a_leak_that_grows_passes_what_a_leak_of_that_size_does(inject):
    """The flow over that of the whole leak, both over the manifold pressure: under boost a leak passes in proportion to it."""
    whole, grown = inject(CatalogueEffect("leak.intake", 2e-5)), inject(effect("ramp", onset=0.0, end=16.0))
    time, boosted = whole.channels["time"], whole.truth["p_im"] > 1.9 * 98e3  # choked
    assert boosted.sum() > 50
    passed = [log.truth["W_leak"][boosted] / log.truth["p_im"][boosted] for log in (grown, whole)]
    assert passed[0] / passed[1] == pytest.approx(np.minimum(time[boosted] / 16.0, 1.0), rel=0.02)


@pytest.mark.parametrize(
    ("name", "flow", "at"),
    [
        ("eta_vol.curve", lambda truth: truth["W_ei"] * truth["T_im"] / truth["p_im"], lambda truth: truth["n_e"]),
        ("egr.curve", lambda truth: truth["W_egr"], lambda truth: truth["u_egr"]),
    ],
)
def test_a_curve_acts_where_its_centre_is(inject, clean, name, flow, at):
    """At its onset the states are still those of the clean drive: flows differ by the factor alone."""
    now = int(np.argmax(at(clean.truth)))
    amplitude, centre = 0.2, 0.97 * at(clean.truth)[now]
    log = inject(
        CatalogueEffect(name, amplitude, onset=float(clean.channels["time"][now]), bump=(centre, 0.05 * centre))
    )
    factor = flow(log.truth)[now] / flow(clean.truth)[now]
    there = (at(log.truth)[now] - centre) / (0.05 * centre)
    assert factor == pytest.approx(1.0 + amplitude * np.exp(-0.5 * there**2), rel=1e-6)


@pytest.mark.parametrize("keys", [{"centre": 2000.0, "width": 0.0}, {"centre": 2000.0, "hight": 3.0}])
def test_a_curve_without_a_width_or_with_a_slip_is_refused(keys):
    with pytest.raises(UsageError):
        injected_of({"id": "eta_vol.curve", "amplitude": 0.03, **keys})
    with pytest.raises(UsageError, match="centre and width are for curves only"):
        CatalogueEffect("leak.intake", CATALOGUE["leak.intake"].neutral, bump=(1.0, 2.0))
