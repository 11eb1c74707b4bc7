"""What a slow sensor of temperature does to the balances belongs to a healthy engine."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from lpvobs.discovery.healthy_learning import left_of
from lpvobs.discovery.lateness import late_by, slopes_of_lateness
from lpvobs.discovery.map_prior import MapPrior
from lpvobs.discovery.residual import lay_out

LAG = 2.5  # [s] of the thermocouple in the exhaust


@pytest.fixture(scope="module")
def problem(plant, config, clean):
    """Return a drive of an engine that is its model, but for a slow thermocouple."""
    share = 1.0 - np.exp(-np.diff(clean.time[:2]) / LAG)
    start = (1.0 - share) * clean["T_em"][0]
    slow, _ = scipy.signal.lfilter(share, [1.0, share[0] - 1.0], clean["T_em"], zi=start)
    log = replace(clean, channels={**clean.channels, "T_em": slow})
    p = config.grid().size
    prior = MapPrior(np.zeros(p), np.eye(p) / 0.002**2, np.zeros((p, len(config.estimate.tolerance))), False)
    return lay_out(replace(plant, units={"T_em": "K", "T_im": "K"}), config.grid(), prior, [log])


def test_a_slow_thermocouple_leaves_less_once_its_lateness_is_known(problem):
    known = left_of(problem, ["drive"])
    unknown = left_of(replace(problem, model=replace(problem.model, units={})), ["drive"])
    assert "T_em" in known.temperatures
    assert unknown.temperatures == ()
    turbo = known.balances.index("turbo")
    assert known.scale[turbo] < 0.9 * unknown.scale[turbo]


def test_lateness_is_the_lag_that_a_slow_sensor_has(problem, clean, plant):
    """A balance with the true temperature is the one with the slow one and what that changes by for its lag."""
    slow, turbo = problem.signals, problem.model.balances.index("turbo")
    true = lay_out(plant, problem.grid, problem.prior, [clean]).signals["T_em"]
    left, right = (plant.imbalances(plant.constants, s, None)[turbo] for s in (slow, slow.corrected("T_em", true)))
    (late,) = late_by(problem, ["T_em"])[turbo]
    assert np.corrcoef(right - left, late)[0, 1] > 0.9
    assert (right - left) @ late / (late @ late) == pytest.approx(LAG, rel=0.2)


def test_its_slopes_are_those_of_a_small_step(problem):
    name, K = "T_em", problem.K
    s = problem.signals
    by_value, by_rate = slopes_of_lateness(problem, [name])[0]
    here = late_by(problem, [name])[:, 0]
    for step, slope in (((1e-2, 0.0), by_value), ((0.0, 1e-2), by_rate)):
        moved = s.corrected(name, s[name] + step[0], s.rate[name] + step[1])
        change = (late_by(replace(problem, signals=moved), [name])[:, 0] - here) / 1e-2
        both = change.reshape(len(here), 2, K).mean(1)
        np.testing.assert_allclose(slope, both, atol=0.02 * np.abs(both).max())
