"""A map on an engine that logs of known air flow have taught: what the formulas leave is in both, and in no map of changes."""

from dataclasses import replace

import numpy as np
import pytest

from lpvobs.calibration.fit import taught
from lpvobs.errors import DataError
from lpvobs.maps.grid import Grid
from lpvobs.observer.estimate import Point, of_parts
from lpvobs.observer.parts import inform

GRAM = 1e-3  # kg/s


@pytest.fixture(scope="module")
def maps(grid):
    """Return what the formulas leave at every node, and the sensor's error, [kg/s] both."""
    rng = np.random.default_rng(7)
    return 0.5 * GRAM * rng.standard_normal(grid.shape), 2.0 * GRAM * rng.standard_normal(grid.shape)


def reading(grid, drive, theta):
    log, W_c = drive
    return replace(log, channels={**log.channels, "W_maf": W_c + grid.interpolate(theta, log["u_delta"], log["n_e"])})


def learned(air_path, grid, gain, log, settings, *share):
    start = Point(air_path, settings.of_engine(air_path.usual_tolerance))
    found = taught(start, grid, gain, [log], lambda _: None, *share).unknowns
    return replace(start, deviation=found.deviation(), known=found)


def estimated(grid, gain, point, log):
    part = inform(point.air_path, grid, gain, log, point.settings, point.unknowns)
    return of_parts(grid, [part], point)


@pytest.mark.parametrize("share", [(), (0.0,)], ids=["as usual", "a bench tells of nothing left"])
@pytest.mark.slow
def test_what_formulas_leave_on_both_days_is_in_no_map(air_path, grid, gain, drive, settings, maps, share):
    """Half a gram at every node, twice: less than a fifth of it is left, and the intervals hold."""
    left, error = maps
    point = learned(air_path, grid, gain, reading(grid, drive, left), settings, *share)
    found = estimated(grid, gain, point, reading(grid, drive, left + error))
    away = (found.theta - error)[found.supported]
    assert np.sqrt(np.mean(away**2)) < 0.1 * GRAM
    assert (np.abs(away) <= 1.645 * found.standard_error[found.supported]).mean() > 0.85


@pytest.mark.slow
def test_another_map_than_that_of_the_healthy_day_is_refused(air_path, grid, gain, drive, settings, maps):
    point = learned(air_path, grid, gain, reading(grid, drive, maps[0]), settings)
    other = Grid(grid.fuel, grid.speed[:-1])
    with pytest.raises(DataError, match="run `lpvobs calibrate` again with this configuration"):
        estimated(other, gain, point, drive[0])
