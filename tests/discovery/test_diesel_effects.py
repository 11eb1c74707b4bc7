"""Every effect at rest is no effect; sensor effects undo what a sensor did."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.engines.diesel.effects import CATALOGUE

CONTRACT = {
    "maf.gain", "maf.offset", "maf.lag", "maf.delay", "maf.drift", "maf.temperature", "maf.contamination", "maf.backflow",
    "leak.intake", "leak.inlet", "egr.leak", "egr.area", "eta_vol.factor", "compressor.flow", "turbine.efficiency",
    "exhaust.restriction", "u_delta.gain", "p_im.gain", "p_im.offset", "p_em.gain", "omega_t.gain", "T_im.lag",
}  # fmt: skip
"""What a diesel of this kind can have of the agreed identifiers."""


def effect(name):
    return next(e for e in CATALOGUE if e.id == name)


def test_the_catalogue_is_the_agreed_one():
    assert {e.id for e in CATALOGUE} == CONTRACT
    assert all(e.low < e.null < e.high for e in CATALOGUE)


@pytest.mark.parametrize("one", CATALOGUE, ids=lambda e: e.id)
def test_null_size_changes_nothing(one, linear):
    signals = linear.problem.signals
    same = one.apply(signals, one.null)
    for name, values in signals.value.items():
        np.testing.assert_allclose(same[name], values, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(same.lacks, signals.lacks)
    other = one.apply(signals, one.null + one.size)
    assert np.any(other.lacks != signals.lacks) or any(np.any(other[n] != x) for n, x in signals.value.items())


@pytest.mark.parametrize("one", [e for e in CATALOGUE if e.straight], ids=lambda e: e.id)
def test_balances_change_in_proportion_to_a_straight_effect(one, linear):
    """So that the loop asks for the change at one size only, also beside another effect."""
    problem, other = linear.problem, effect("compressor.flow")
    there = replace(problem.signals, lacks=other.apply(problem.signals, 0.9).lacks)

    def left(size):
        return problem.model.imbalances(there.constants, one.apply(there, size), None)

    once, thrice = (left(one.null + n * one.size) - left(one.null) for n in (1.0, 3.0))
    assert np.abs(once).max() > 0.0
    np.testing.assert_allclose(thrice, 3.0 * once, rtol=1e-6, atol=1e-12)  # kg/s


@pytest.mark.parametrize(
    ("name", "size", "reading"),
    [
        ("maf.gain", 1.07, lambda W, s: 1.07 * W),
        ("maf.offset", 1e-3, lambda W, s: W + 1e-3),
        ("maf.drift", 2e-4, lambda W, s: W + 2e-4 * s.time * W),
        ("maf.temperature", 3e-3, lambda W, s: W + 3e-3 * W * (s["T_amb"] - 298.0)),
        ("maf.contamination", 0.1, lambda W, s: (0.9 * W**0.5 + 0.1 * 0.02**0.5) ** 2),
    ],
)
def test_a_sensor_effect_undoes_what_the_sensor_did(name, size, reading, linear):
    signals = linear.problem.signals
    truth = np.maximum(signals["W_maf"], 1e-3)
    seen = signals.corrected("W_maf", reading(truth, signals), signals.rate["W_maf"])
    np.testing.assert_allclose(effect(name).apply(seen, size)["W_maf"], truth, rtol=1e-9)


def test_no_slow_sensor_makes_a_charge_colder_than_air_can_be(linear):
    """One instant at which T_im fell by 30 K in a second had the charge at -17 K, and the fit ended in no number."""
    signals = linear.problem.signals
    fell = replace(signals, slow=lambda _: np.full(signals.time.size, -40.0))
    warmer = effect("T_im.lag").apply(fell, 10.0)
    assert warmer["T_im"].min() == 200.0
    assert np.isfinite(linear.problem.model.imbalances(warmer.constants, warmer, None)).all()


def test_a_dead_time_leaves_what_else_is_wrong_with_the_reading(linear):
    """A reading that is 10 % too large and late: with the gain undone, the dead time moves a signal that is as much smaller."""
    signals = linear.problem.signals
    both = effect("maf.gain").apply(effect("maf.delay").apply(signals, 0.05), 1.1)
    swapped = effect("maf.delay").apply(effect("maf.gain").apply(signals, 1.1), 0.05)
    flow = signals["W_maf"] > 5e-3  # below, the ratio of two noisy readings is not known
    np.testing.assert_allclose(swapped["W_maf"][flow], both["W_maf"][flow], rtol=1e-9)


def test_a_hole_in_the_inlet_takes_its_share_of_the_filling(linear):
    """Whatever the sensor's own error: the same flow is missing in a reading that is shifted."""
    signals = linear.problem.signals
    shifted = signals.corrected("W_maf", signals["W_maf"] + 0.01)
    leak = effect("leak.inlet")
    missing = leak.apply(signals, 1e-4)["W_maf"] - signals["W_maf"]
    np.testing.assert_allclose(leak.apply(shifted, 1e-4)["W_maf"] - shifted["W_maf"], missing, rtol=1e-9, atol=1e-15)
    # 1e-4 m^2 behind a filter of 2.08e5 Pa/(kg/s)^2 in air of 1.15 kg/m^3: sqrt(2 rho F) A = 6.9 % of what passes the sensor
    passing = signals["W_maf"] > 0.03
    assert np.median(missing[passing] / signals["W_maf"][passing]) == pytest.approx(
        0.069 / 1.069, rel=0.25
    )  # its own error


def test_beside_a_map_a_hole_in_the_inlet_takes_no_share_of_what_the_filling_is_off_by(linear):
    """A share of the filling would make its errors smaller: a sensor that reads too little looked like a leak for that."""
    signals = replace(linear.problem.signals, error=np.full(linear.problem.signals.time.size, 0.002))
    hot = signals.corrected("T_im", 1.05 * signals["T_im"])  # the filling is off by 5 %
    leak = effect("leak.inlet")
    for seen in (signals, hot):
        passed = np.maximum(seen["W_maf"] - 0.002, 0.0)
        share = (leak.apply(seen, 1e-4)["W_maf"] - seen["W_maf"]) / np.where(passed > 0.0, passed, np.inf)
        np.testing.assert_allclose(share[passed > 0.0], 0.069, rtol=0.02)  # density of the day
