"""Readings put right: the inverse of lag, mean and dead time on signals of known form, and no reach beyond what is there."""

from itertools import pairwise

import numpy as np
import pytest
import scipy

from lpvobs.engines.channels import Sensor
from lpvobs.observer.readings import put_right
from lpvobs.records import Piece

NARROWEST = 0.05


def pieces_of(time, channels, begins, edges=()):
    for start, stop in pairwise((0, *edges, time.size)):
        part = slice(start, stop)
        yield Piece(time[part], {name: column[part] for name, column in channels.items()}, begins[part])


def put(time, channels, sensors, starts=(0,), edges=(), pulsation=None):
    begins = np.isin(np.arange(time.size), starts)
    found = list(put_right(pieces_of(time, channels, begins, edges), sensors, NARROWEST, pulsation))
    np.testing.assert_array_equal(np.concatenate([piece.time for piece in found]), time)
    np.testing.assert_array_equal(np.concatenate([piece.begins for piece in found]), begins)
    return {name: np.concatenate([piece.channels[name] for piece in found]) for name in channels}


def slow(x, tau, step):
    """Return y of tau dy/dt = x - y, from a fine simulation of its own."""
    fine = 50
    time = np.arange(x.size * fine) * step / fine
    system = scipy.signal.TransferFunction([1.0], [tau, 1.0])
    _, y, _ = scipy.signal.lsim(system, np.interp(time, np.arange(x.size) * step, x) - x[0], time)
    return y[::fine] + x[0]


@pytest.mark.parametrize(("tau", "period"), [(0.03, 1.0), (2.0, 8.0)])
@pytest.mark.slow
def test_a_lag_is_taken_off(tau, period):
    time = np.arange(4000) * 0.01
    truth = 600.0 + 100.0 * np.sin(2.0 * np.pi * time / period)
    late = slow(truth, tau, 0.01)
    right = put(time, {"T": late, "p": truth}, {"T": Sensor(tau=tau)})
    inside = slice(200, -200)
    # The window leaves the cubic term of the rate: (2 pi/period)^3 w^2 tau / 6 of the amplitude, w = max(0.05, tau/4).
    missed = 100.0 * (2.0 * np.pi / period) ** 3 * max(NARROWEST, tau / 4.0) ** 2 * tau / 6.0
    assert np.abs(right["T"] - truth)[inside].max() < missed + 0.1
    assert np.abs(late - truth)[inside].max() > 10.0 * (missed + 0.1)
    np.testing.assert_array_equal(right["p"], truth)


@pytest.mark.parametrize(
    "sensor",
    [Sensor(delay=0.07), Sensor(filter=0.14), Sensor(raster=0.1, delay=0.02)],
    ids=["delay", "filter", "raster"],
)
def test_what_is_late_is_read_that_much_earlier(sensor):
    time = np.arange(1000) * 0.01
    found = put(time, {"x": 3.0 * time}, {"x": sensor})["x"]
    np.testing.assert_allclose(found[:-10], 3.0 * (time[:-10] + 0.07), rtol=1e-12)
    np.testing.assert_array_equal(found[-7:], 3.0 * time[-1])  # nothing is known behind the end


def test_neither_cuts_nor_another_segment_change_a_bit():
    rng = np.random.default_rng(4)
    time = np.cumsum(rng.uniform(0.005, 0.02, 900))
    time[400:] += 5.0
    channels = {"x": rng.standard_normal(900), "y": rng.standard_normal(900)}
    sensors = {"x": Sensor(tau=0.4, delay=0.033), "y": Sensor(raster=0.05)}
    whole = put(time, channels, sensors, starts=(0, 400))
    for edges in ((1, 2, 3), (399, 400, 401), tuple(range(7, 900, 13)), (895,)):
        for name, column in put(time, channels, sensors, starts=(0, 400), edges=edges).items():
            np.testing.assert_array_equal(column, whole[name])
    alone = put(time[400:], {name: column[400:] for name, column in channels.items()}, sensors)
    for name, column in alone.items():
        np.testing.assert_array_equal(column, whole[name][400:])


def test_pulses_are_taken_off_where_the_engine_knows_them():
    time = np.arange(50) * 0.01
    channels = {"W": np.full(50, 0.02), "n": np.linspace(1.0, 2.0, 50)}
    found = put(time, channels, {"W": Sensor(pulsation=0.1)}, pulsation=lambda at, x: 1.0 + x * at["n"])
    np.testing.assert_allclose(found["W"], 0.02 / (1.0 + 0.1 * channels["n"]), rtol=1e-15)


def test_sensors_as_they_are_change_nothing():
    time = np.arange(50) * 0.01
    channels = {"x": np.sin(time)}
    np.testing.assert_array_equal(put(time, channels, {"x": Sensor(quantisation=0.5)})["x"], channels["x"])
