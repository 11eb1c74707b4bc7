"""Which logs disagree: none of those that share a map, and those that do not, however few logs there are."""

from dataclasses import replace

import numpy as np
import pytest
from reference.drives import noisy
from reference.informing import informed, solved

from lpvobs.observer.disagreement import agreements, difference


def judged(air_path, grid, gain, settings, logs):
    parts = [informed(air_path, grid, gain, log, settings) for log in logs]
    _, solution = solved(air_path, grid, settings, parts)
    return agreements([difference(solution, part, settings.prior_map) for part in parts])


def with_gain(log, factor):
    return replace(log, name="drifted", channels={**log.channels, "W_maf": factor * log["W_maf"]})


@pytest.fixture(scope="module")
def fleet(drive, other_drive):
    """Return six noisy logs of two drives."""
    drives = [(drive[0], seed) for seed in (1, 2, 3)] + [(other_drive[0], seed) for seed in (4, 5, 6)]
    return [replace(noisy(log, seed), name=f"log {seed}") for log, seed in drives]


@pytest.mark.slow
def test_logs_of_one_map_agree(air_path, grid, gain, settings, fleet):
    scatter, found = judged(air_path, grid, gain, settings, fleet)
    assert [item.name for item in found] == [log.name for log in fleet]
    assert not any(item.disagrees for item in found)
    assert all(item.nodes > 50 for item in found)
    # Two drives with the same error surface: what is left beyond noise is its misfit to the grid, a tenth of a gram per second.
    assert scatter < 2e-4
    middle = np.median([item.chi_square / item.nodes for item in found])
    assert 0.3 < middle < 1.1  # one by the choice of the scatter, unless noise alone explains less


@pytest.mark.parametrize("factor", [0.97, pytest.param(1.03, marks=pytest.mark.proof)])
def test_a_sensor_that_has_drifted_stands_out_alone(air_path, grid, gain, settings, fleet, factor):
    logs = [*fleet[:2], with_gain(fleet[2], factor), *fleet[3:]]
    _, found = judged(air_path, grid, gain, settings, logs)
    assert [item.name for item in found if item.disagrees] == ["drifted"]
    drifted = next(item for item in found if item.disagrees)
    # Three per cent of flows around 40 g/s, less what the log itself adds to the common map.
    assert np.sign(drifted.mean_difference) == np.sign(factor - 1.0)
    assert 2e-4 < abs(drifted.mean_difference) < 2e-3


@pytest.mark.slow
def test_a_log_that_went_elsewhere_has_nothing_to_compare(air_path, grid, gain, settings, fleet):
    scatter, (only,) = judged(air_path, grid, gain, settings, fleet[:1])
    assert only.nodes == 0
    assert np.isnan(only.chi_square)
    assert not only.disagrees
    assert scatter == 0.0
