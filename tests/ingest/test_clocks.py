"""Time columns."""

import numpy as np
import pyarrow as pa
import pytest

from lpvobs.ingest.repairs import forward, stamps


def test_a_clock_goes_on_past_midnight():
    found = stamps(pa.array(["23:59:59.5", "0:00:00.25", "", "0:00:01", "noon"]), "clock")
    np.testing.assert_allclose(found.time, [86399.5, 86400.25, np.nan, 86401.0, np.nan])
    assert (found.nights, found.unreadable) == (1, 1)


@pytest.mark.parametrize("word", ["24:00:00", "1:60", "1:00:61", "12", "1:2:3:4", "-1:00", "::", "a:b"])
def test_what_is_no_time_of_day_is_none(word):
    assert np.isnan(stamps(pa.array(["1:00", word]), "clock").time[1])


def test_dates_and_units():
    text = pa.array(["2024-05-01T10:00:00Z", "2024-05-01T12:00:00.5+02:00", None, "tomorrow"])
    found = stamps(text, "datetime")
    np.testing.assert_allclose(np.diff(found.time[:2]), 0.5)
    assert found.unreadable == 1
    moments = pa.array([0, 250], type=pa.timestamp("ms"))
    np.testing.assert_allclose(stamps(moments, "datetime").time, [0.0, 0.25])
    np.testing.assert_allclose(stamps(pa.array(["0,5", "1,5"]), "ms", decimal=",").time, [5e-4, 1.5e-3])
    with pytest.raises(ValueError, match="timestamp"):
        stamps(moments, "s")
    with pytest.raises(ValueError, match="cannot be converted"):
        stamps(pa.array([1.0]), "kPa")


def test_forward_keeps_what_is_later_than_all_before():
    time = np.array([0.0, 1.0, np.nan, 0.5, 1.0, 2.0, 1.9, 3.0])
    assert forward(time).tolist() == [True, True, False, False, False, True, False, True]
