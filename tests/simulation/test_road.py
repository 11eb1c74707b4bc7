"""The road around the engine: what varies, that the engine feels it, and how its sensors show it."""

import numpy as np
import pytest

from lpvobs.engines.diesel.lpv import INPUTS, Diesel, along
from lpvobs.simulation.road import (
    AC_OFF,
    AC_ON,
    AUXILIARY,
    GRID,
    THERMOSTAT,
    Auxiliary,
    air_conditioning,
    altitude,
    coolant,
    heat_soak,
    road,
    wander,
)
from lpvobs.simulation.scene import with_load
from lpvobs.simulation.simulate import simulate
from lpvobs.simulation.vehicle import torque, work_of

PERIOD = 0.01  # s
P_0, T_0 = 98000.0, 298.0


def surroundings(seed, seconds=1200.0):
    """Return a road for ten minutes at 20 m/s after standing, and again."""
    time = np.arange(0.0, seconds, PERIOD)
    speed = np.where((time // 300.0) % 2 == 0, 0.0, 20.0)
    return time, speed, road(PERIOD, P_0, T_0, speed, True, 40e3 + 0.0 * time, seed)


@pytest.fixture(scope="module")
def on_road(config, minutes):
    return simulate(config.engine, config.simulation, minutes, 20.0, seed=4, auxiliary=Auxiliary())


# --- what happens on a road -------------------------------------------------------------------------------------------------


def test_same_seed_same_road_other_seed_another():
    _, _, first = surroundings(3, 400.0)
    _, _, again = surroundings(3, 400.0)
    _, _, other = surroundings(4, 400.0)
    for name in first.channels:
        assert np.array_equal(first.channels[name], again.channels[name]), name
        assert np.array_equal(first.channels[name], other.channels[name]) == (name == "v_veh"), name


@pytest.mark.parametrize("seed", range(5))
def test_pressure_follows_the_altitude_and_begins_where_the_configuration_says(seed):
    _, speed, around = surroundings(seed)
    assert around.p_amb[0] == P_0
    height = altitude(np.cumsum(speed) * PERIOD, seed)
    climbed = np.log(P_0 / around.p_amb) * 287.0 * T_0 / 9.81
    # the road is laid on a grid of half a second, 10 m at this speed, and 12 % steep at most
    np.testing.assert_allclose(climbed, height, atol=1.3)
    assert np.ptp(height) > 10.0
    assert np.abs(height).max() < 400.0


def test_hills_are_no_steeper_than_said():
    distance = np.arange(0.0, 30e3, 5.0)
    for seed in range(10):
        slope = np.diff(altitude(distance, seed)) / 5.0
        assert np.abs(slope).max() < 0.12
        assert altitude(np.zeros(1), seed)[0] == 0.0


def test_a_standing_car_heats_its_intake_and_a_moving_one_cools_it():
    standing, moving = heat_soak(np.zeros(2000), 1), heat_soak(np.full(2000, 20.0), 1)
    assert (np.diff(standing) >= 0.0).all()
    assert (np.diff(moving) <= 0.0).all()
    assert standing[-1] > 13.0
    assert moving[-1] < 0.1


def test_weather_wanders_as_far_as_said():
    """Standard deviation over courses, long after the start; 400 of them know it to within 3.5 %, four times that allowed."""
    ends = [wander(2000, 1.5, 100.0, np.random.Generator(np.random.PCG64(seed)))[-1] for seed in range(400)]
    assert np.std(ends) == pytest.approx(1.5, rel=0.14)
    assert wander(10, 1.5, 100.0, np.random.Generator(np.random.PCG64(1)))[0] == 0.0


def test_coolant_warms_up_to_its_thermostat_and_stays_there():
    course = coolant(np.full(7200, 60e3), np.full(7200, 290.0), 2)
    opens, is_open = THERMOSTAT
    assert 290.0 <= course[0] <= 330.0
    warm = np.argmax(course > opens)
    assert 60.0 < warm * GRID < 1800.0
    assert (np.diff(course[:warm]) > 0.0).all()
    assert ((course[warm:] >= opens - 1.0) & (course[warm:] <= is_open + 5.0)).all()


def test_the_air_conditioning_comes_and_goes_and_runs_longer_when_it_is_hot():
    time = np.arange(0.0, 6000.0, 0.1)
    shares = []
    for T in (283.0, 298.0, 310.0):
        running = air_conditioning(time, np.full(time.size, T), 5)
        assert set(np.unique(running)) == {0.0, 1.0}
        assert np.count_nonzero(np.diff(running)) > 100
        shares.append(running.mean())
    assert shares[0] < shares[1] < shares[2]
    # a hundred periods whose parts scatter by 25 %
    assert shares[1] == pytest.approx(AC_ON / (AC_ON + AC_OFF), abs=0.04)


def test_the_load_is_carried_by_as_much_torque_but_not_above_full_load_nor_in_overrun(config):
    work, full = work_of(config.engine, config.simulation), config.simulation.full_load
    n_e, fuel = np.array([2000.0, 2000.0, 2000.0]), np.array([20.0, 39.9, 0.0])
    loaded = with_load(work, full, n_e, fuel, np.full(3, 8.0))
    assert torque(work, 2000.0, loaded[0]) - torque(work, 2000.0, 20.0) == pytest.approx(8.0, rel=1e-12)
    assert loaded[1:].tolist() == [40.0, 0.0]


# --- in the engine and in the log ---------------------------------------------------------------------------------------------


def test_the_engine_breathes_the_roads_air(on_road, config):
    """The observer's model on the true, varying ambient gives the plant's flows: the air changes in the plant itself."""
    true = on_road.truth
    assert np.ptp(true["p_amb"]) > 50.0
    assert np.ptp(true["T_amb"]) > 1.0
    rho, _ = along(Diesel(config.engine).constants, tuple(true[name] for name in INPUTS))
    # a dozen roundings of numbers up to a tenth of a kilogram per second
    np.testing.assert_allclose(rho[:, 0] * true["omega_t"], true["W_c"], rtol=1e-11, atol=1e-13)


def test_charge_air_is_as_warm_as_the_cooler_leaves_it(on_road):
    true = on_road.truth
    late = true["W_c"].size // 2
    above = (true["T_charge"] - true["T_amb"])[late:].mean()
    warming = true["warming"][late:].mean()
    assert above == pytest.approx(warming, rel=0.15)


def test_sensors_of_the_road_have_their_resolution_unit_and_noise(on_road):
    for name in on_road.channels.keys() & AUXILIARY.keys():
        unit, (spread, step) = AUXILIARY[name]
        assert on_road.units[name] == unit
        steps = on_road.channels[name] / step
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
        error = on_road.channels[name] - on_road.truth[name]
        # noise and rounding together; 3600 samples know a standard deviation to about one per cent
        assert np.std(error) <= 1.1 * np.hypot(spread, step / 2.0), name
    assert np.array_equal(on_road.channels["ac_switch"], np.round(on_road.truth["ac_switch"]))
    assert np.std(on_road.channels["p_baro"] - on_road.truth["p_amb"]) < 60.0


def test_a_channel_less_changes_no_other(on_road, config, minutes):
    fewer = simulate(config.engine, config.simulation, minutes, 20.0, seed=4, auxiliary=Auxiliary(("humidity",)))
    assert set(on_road.channels) - set(fewer.channels) == {"T_coolant", "T_charge", "ac_switch", "p_baro"}
    for name, values in fewer.channels.items():
        assert np.array_equal(values, on_road.channels[name]), name


def test_a_speed_cycle_logs_the_vehicles_speed(config, tmp_path):
    path = tmp_path / "speed.csv"
    path.write_text("time_s,speed_kmh\n" + "\n".join(f"{t},{min(max(5.0 * (t - 3), 0.0), 50.0)}" for t in range(25)))
    log = simulate(config.engine, config.simulation, str(path), 10.0, auxiliary=Auxiliary())
    assert log.units["v_veh"] == "km/h"
    # the driver smooths the corners of the cycle and follows within 2 km/h
    assert log.channels["v_veh"][-20:].mean() == pytest.approx(50.0, abs=2.0)
    assert log.channels["v_veh"][0] == pytest.approx(0.0, abs=0.5)


def test_impossible_channels_are_refused(config, cycle):
    from lpvobs.errors import UsageError

    with pytest.raises(UsageError, match="without a vehicle"):
        simulate(config.engine, config.simulation, cycle, auxiliary=Auxiliary(("v_veh",)))
    with pytest.raises(ValueError, match="'T_oil' is not an auxiliary channel"):
        Auxiliary(("T_oil",))
    with pytest.raises(ValueError, match="twice"):
        Auxiliary(("humidity", "humidity"))
