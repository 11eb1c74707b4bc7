"""Time columns."""

import numpy as np
import pyarrow as pa
import pytest

from lpvobs.ingest.repairs import forward, stamps


def test_a_clock_goes_on_past_midnight():
    words = pa.array(["23:59:59.5", "0:00:00,25", "", "0:00:01", None, " 7:05", "noon"])
    time, repairs = stamps(words, "clock")
    np.testing.assert_array_equal(time, [86399.5, 86400.25, np.nan, 86401.0, np.nan, 111900.0, np.nan])
    assert repairs == {"nights": 1, "unreadable": 1}
    for same in (words.dictionary_encode(), pa.chunked_array([words[:3], words[3:]])):
        np.testing.assert_array_equal(stamps(same, "clock")[0], time)
    assert stamps(pa.array([], pa.string()), "clock") == (pytest.approx([]), {"nights": 0, "unreadable": 0})


@pytest.mark.parametrize("kind", [pa.time64("us"), pa.duration("s"), pa.bool_(), pa.date32(), pa.binary()])
def test_a_clock_of_any_type(kind):
    """Parquet files of other tools may hold anything; only a time of day is one."""
    found, _ = stamps(pa.array([None, None], kind), "clock")
    assert np.isnan(found).all()


@pytest.mark.parametrize("word", ["24:00:00", "1:60", "1:00:61", "12", "1:2:3:4", "-1:00", "::", "a:b"])
def test_what_is_no_time_of_day_is_none(word):
    assert np.isnan(stamps(pa.array(["1:00", word]), "clock")[0][1])


def test_dates_and_units():
    text = pa.array(["2024-05-01T10:00:00Z", "2024-05-01T12:00:00.5+02:00", None, "tomorrow"])
    time, repairs = stamps(text, "datetime")
    np.testing.assert_allclose(np.diff(time[:2]), 0.5)
    assert repairs == {"unreadable": 1}
    moments = pa.array([0, 250], type=pa.timestamp("ms"))
    np.testing.assert_allclose(stamps(moments, "datetime")[0], [0.0, 0.25])
    np.testing.assert_allclose(stamps(pa.array(["0,5", "1,5"]), "ms", decimal=",")[0], [5e-4, 1.5e-3])
    with pytest.raises(ValueError, match="timestamp"):
        stamps(moments, "s")
    with pytest.raises(ValueError, match="cannot be converted"):
        stamps(pa.array([1.0]), "kPa")


def test_forward_keeps_what_is_later_than_all_before():
    time = np.array([0.0, 1.0, np.nan, 0.5, 1.0, 2.0, 1.9, 3.0])
    assert forward(time).tolist() == [True, True, False, False, False, True, False, True]
