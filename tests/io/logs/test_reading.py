"""Logs as files: what is refused and how, what is repaired and counted, what comes back."""

import hashlib

import numpy as np
import pyarrow as pa
import pytest

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.errors import DataError
from lpvobs.io.logs.parquet import channel_units, write_log
from lpvobs.io.logs.policies import ChannelLimits, LogPolicies
from lpvobs.io.logs.reading import LogFile, read_references
from lpvobs.observer.log_run import Beginning
from lpvobs.records import gathered

UNITS = {"time": "s"} | {name: channel.unit for name, channel in Diesel.channels.items()}


def refusal(read, path, *words, **policies):
    """Assert that a log is refused in one line that names the file and the words given."""
    with pytest.raises(DataError) as failure:
        read(path, **policies)
    text = str(failure.value)
    assert len(text.splitlines()) == 1, text
    for word in (str(path), *words):
        assert word in text, (word, text)


# --- what comes back ---------------------------------------------------------------------------------------------------


def test_write_and_read_is_a_round_trip(tmp_path, columns, read):
    path = tmp_path / "a drive.parquet"
    write_log(path, columns, UNITS)
    log = read(path)
    assert log.name == "a drive"
    assert log.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    np.testing.assert_array_equal(log.time, columns["time"])
    assert set(log.channels) == set(Diesel.channels)
    for name in Diesel.channels:
        np.testing.assert_array_equal(log[name], columns[name])
    assert log.segments == ((0, 200),)
    np.testing.assert_array_equal(log.rows, np.arange(200))
    defects = log.defects
    assert (defects.samples_read, defects.dropped, defects.dropped_rows, defects.gaps, defects.repeated) == (
        200,
        {},
        0,
        0,
        0,
    )
    assert channel_units(path) == UNITS


def test_the_beginning_of_a_file_is_that_of_the_log(write, columns, read):
    path = write(columns | {"time": columns["time"] + 0.5 * (np.arange(columns["time"].size) >= 7)})
    whole = read(path)
    file = LogFile(path, Diesel.channels, LogPolicies(gap_limit=0.4))
    cut = gathered(Beginning(file, whole.time[9] - whole.time[0]))
    assert (cut.name, cut.sha256, cut.segments) == (whole.name, whole.sha256, ((0, 7), (7, 9)))
    for name in whole.channels:
        np.testing.assert_array_equal(cut[name], whole[name][:9])
    np.testing.assert_array_equal(gathered(file).time, whole.time)


def test_same_channels_same_bytes(tmp_path, columns):
    for name in ("a", "b"):
        write_log(tmp_path / name, columns, UNITS)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("kind", ["float32", "int64", "int16", "uint32"])
def test_any_numbers_will_do(write, columns, read, kind):
    columns["n_e"] = np.round(columns["n_e"]).astype(kind)
    log = read(write(columns))
    assert log["n_e"].dtype == np.float64
    np.testing.assert_array_equal(log["n_e"], columns["n_e"])


def test_references_are_never_read_with_the_log(write, columns, read):
    path = write(
        columns | {"ref_W_c": columns["W_maf"], "ref_delta_W_c": 0 * columns["W_maf"], "ref_other": columns["n_e"]}
    )
    log = read(path, auxiliary=True)
    assert not any(name.startswith("ref_") for name in (*log.channels, *log.auxiliary))


def test_removing_references_changes_nothing_but_the_digest(write, columns, read):
    units = {"ref_W_c": "kg/s", "ref_delta_W_c": "kg/s"}
    columns["p_im"][30] = np.nan
    bare = read(write(columns, name="a.parquet"), auxiliary=True)
    columns |= {"ref_W_c": np.full(200, np.nan), "ref_delta_W_c": columns["W_maf"]}
    rich = read(write(columns, units, name="b.parquet"), auxiliary=True)
    for name in Diesel.channels:
        np.testing.assert_array_equal(bare[name], rich[name])
    np.testing.assert_array_equal(bare.time, rich.time)
    assert bare.segments == rich.segments
    assert bare.defects == rich.defects
    assert bare.auxiliary == rich.auxiliary == {}


def test_references_lie_beside_the_samples_that_were_kept(write, columns, read):
    columns["p_im"][[3, 50]] = np.nan
    units = {"ref_W_c": "kg/h", "ref_delta_W_c": "g/s"}
    path = write(columns | {"ref_W_c": 36.0 * np.arange(200.0), "ref_delta_W_c": np.arange(200.0)}, units)
    log = read(path)
    found = read_references(path, log.rows)
    kept = np.delete(np.arange(200.0), [3, 50])
    np.testing.assert_allclose(found["ref_W_c"], 0.01 * kept, rtol=1e-14)  # conversion rounds once or twice
    np.testing.assert_allclose(found["ref_delta_W_c"], 1e-3 * kept, rtol=1e-14)


def test_half_a_truth_is_none(write, columns):
    assert read_references(write(columns | {"ref_W_c": columns["W_maf"]}), np.arange(200)) is None
    assert read_references(write(columns), np.arange(200)) is None


def test_a_reference_without_unit_is_refused(write, columns):
    path = write(columns | {"ref_W_c": columns["W_maf"], "ref_delta_W_c": columns["W_maf"]})
    with pytest.raises(DataError, match="ref_W_c"):
        read_references(path, np.arange(200))


def test_auxiliary_channels_come_on_request_as_they_are(write, columns, read):
    humidity = np.where(np.arange(200) < 50, np.nan, 0.4)
    columns |= {"humidity": humidity, "fan": np.arange(200) % 2 == 0, "gear": np.arange(200) // 50}
    extra = {"remark": pa.array(["x"] * 200), "engine.torque": np.arange(200.0)}
    path = write(columns | extra)
    assert read(path).auxiliary == {}
    log = read(path, auxiliary=True)
    assert set(log.auxiliary) == {"humidity", "fan", "gear", "engine.torque"}  # text is no channel
    np.testing.assert_array_equal(log.auxiliary["humidity"], humidity)
    np.testing.assert_array_equal(log.auxiliary["fan"], np.arange(200) % 2 == 0)
    assert len(log) == 200  # what no one needs drops no sample


def test_an_auxiliary_counter_too_large_for_a_float_is_no_fault(write, columns, read):
    """Nanoseconds since 1970, as bus loggers write them."""
    columns["stamp"] = 1_700_000_000_000_000_001 + 10_000_000 * np.arange(200)
    log = read(write(columns), auxiliary=True)
    np.testing.assert_allclose(log.auxiliary["stamp"], columns["stamp"].astype(float), rtol=1e-15)


def test_an_auxiliary_channel_that_comes_twice_is_left_out(write, columns, read):
    log = read(write(columns | {"fan": np.ones(200)}, twice=("fan",)), auxiliary=True)
    assert "fan" not in log.auxiliary


# --- units -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("channel", "unit", "factor", "offset"),
    [
        ("p_im", "kPa", 1e-3, 0.0),
        ("p_em", "bar", 1e-5, 0.0),
        ("p_amb", "hPa", 1e-2, 0.0),
        ("T_im", "degC", 1.0, -273.15),
        ("T_amb", "°C", 1.0, -273.15),
        ("W_maf", "g/s", 1e3, 0.0),
        ("W_maf", "kg/h", 3600.0, 0.0),
        ("n_e", "1/min", 1.0, 0.0),
        ("omega_t", "rpm", 60.0 / (2.0 * np.pi), 0.0),
        ("u_delta", "mg/stroke", 1.0, 0.0),
        ("u_egr", "1", 1e-2, 0.0),
        ("time", "ms", 1e3, 0.0),
    ],
)
def test_units_are_converted_at_the_door(write, columns, read, channel, unit, factor, offset):
    expected = columns[channel].copy()
    columns[channel] = expected * factor + offset
    log = read(write(columns, {channel: unit}))
    found = log.time if channel == "time" else log[channel]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)  # factors rounded once more


def test_a_unit_stands_in_the_metadata_with_or_without_blanks(write, columns, read):
    np.testing.assert_array_equal(read(write(columns, {"p_im": " Pa "}))["p_im"], columns["p_im"])


@pytest.mark.parametrize("name", ["time", "p_im", "W_maf", "u_egr"])
@pytest.mark.parametrize("unit", [None, "", "  "])
def test_a_channel_without_unit_is_refused(write, columns, read, name, unit):
    refusal(read, write(columns, {name: unit}), f"'{name}'", "no unit", f"'{UNITS[name]}'")


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("p_im", "K"), ("time", "m"), ("W_maf", "l/min"), ("n_e", "Hz"), ("omega_t", "1/s"), ("u_delta", "mg"),
        ("T_im", "furlong?"), ("u_vgt", "V"), ("p_em", "kPa)"),
    ],
)  # fmt: skip
def test_a_unit_of_another_kind_is_refused(write, columns, read, name, unit):
    refusal(read, write(columns, {name: unit}), f"'{name}'", f"'{unit}'", f"'{UNITS[name]}'")


# --- files that are no logs --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1PAR1", b"time,n_e\n0,800\n", b"\x00" * 4096])
def test_files_that_are_not_parquet(tmp_path, read, content):
    path = tmp_path / "drive.parquet"
    path.write_bytes(content)
    refusal(read, path, "Parquet")


def test_no_file_and_a_folder(tmp_path, read):
    refusal(read, tmp_path / "none.parquet", "Parquet")
    refusal(read, tmp_path, "Parquet")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file(write, columns, read, share):
    path = write(columns)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    refusal(read, path, "Parquet")


def test_a_file_with_a_spoiled_middle(write, columns, read):
    path = write(columns)
    content = bytearray(path.read_bytes())
    content[8 : len(content) // 2] = b"\xff" * (len(content) // 2 - 8)
    path.write_bytes(content)
    refusal(read, path)


@pytest.mark.parametrize("name", ["time", "n_e", "W_maf", "T_em"])
def test_a_missing_channel(write, columns, read, name):
    del columns[name]
    refusal(read, write(columns), f"'{name}'", "missing", UNITS[name])


@pytest.mark.parametrize("name", ["time", "p_em"])
def test_a_channel_that_comes_twice(write, columns, read, name):
    refusal(read, write(columns, twice=(name,)), f"'{name}'", "2 times")


@pytest.mark.parametrize(
    "values",
    [pa.array(["warm"] * 200), pa.array([[1.0, 2.0]] * 200), pa.array([{"a": 1.0}] * 200), pa.array([b"\x00"] * 200)],
    ids=["text", "list", "struct", "bytes"],
)
@pytest.mark.parametrize("name", ["time", "T_im"])
def test_a_channel_that_holds_no_numbers(write, columns, read, name, values):
    columns[name] = values
    refusal(read, write(columns), f"'{name}'", "expected numbers")


def test_a_time_of_day_is_no_time_in_seconds(write, columns, read):
    columns["time"] = pa.array((1_700_000_000_000 + 10 * np.arange(200)).astype("datetime64[ms]"))
    refusal(read, write(columns), "'time'", "timestamp")


@pytest.mark.parametrize("rows", [0, 1])
def test_too_few_rows(write, columns, read, rows):
    refusal(read, write({name: column[:rows] for name, column in columns.items()}))


def test_names_with_line_breaks_do_not_break_the_line(write, columns, read):
    del columns["T_em"]
    refusal(read, write(columns | {"a\nb": columns["n_e"]}), "'T_em'")


# --- time --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [50, 1, 199])
@pytest.mark.parametrize("back", [0.01, 0.02, 5.0])
def test_repeated_or_backward_time_is_refused(write, columns, read, at, back):
    columns["time"] = columns["time"] + 10.0
    columns["time"][at:] -= back
    first = f"first at {columns['time'][at]:.6g} s"
    refusal(read, write(columns), "'time'", "backward", first, f"row {at}", "backward_time")


def test_or_repaired_on_request(write, columns, read):
    columns["time"][100:] -= 0.05  # five samples repeat five times of before
    log = read(write(columns), backward_time="drop")
    np.testing.assert_array_equal(log.rows, np.delete(np.arange(200), np.arange(100, 105)))
    assert (np.diff(log.time) > 0).all()
    assert log.defects.repeated == 5
    assert log.defects.dropped_rows == 0
    np.testing.assert_array_equal(log["n_e"], columns["n_e"][log.rows])


def test_time_that_stands_still_leaves_nothing_to_repair(write, columns, read):
    columns["time"][:] = 7.0
    refusal(read, write(columns), backward_time="drop")


def test_time_without_a_number_is_dropped_and_counted(write, columns, read):
    columns["time"][[0, 77]] = np.nan
    columns["time"][120] = np.inf
    log = read(write(columns))
    assert len(log) == 197
    assert log.defects.dropped == {"time": 3}
    assert log.defects.dropped_rows == 3


def test_a_dropped_sample_hides_its_time(write, columns, read):
    """Time runs backward only at a sample that is dropped for another reason: the rest is in order."""
    columns["time"][60] = 0.0
    columns["p_im"][60] = np.nan
    assert len(read(write(columns))) == 199


def test_a_gap_splits(write, columns, read):
    columns["time"][80:] += 1.0
    columns["time"][150:] += 3600.0
    log = read(write(columns))
    assert log.segments == ((0, 80), (80, 150), (150, 200))
    assert log.defects.gaps == 2
    patient = read(write(columns), gap_limit=10.0)
    assert patient.segments == ((0, 150), (150, 200))


def test_a_step_of_exactly_the_limit_is_no_gap(write, columns, read):
    columns["time"] = np.arange(200.0) * 0.5
    assert read(write(columns), gap_limit=0.5).segments == ((0, 200),)


def test_dropped_samples_leave_a_gap_where_they_are_many(write, columns, read):
    columns["u_vgt"][40:160] = np.nan
    log = read(write(columns))
    assert log.segments == ((0, 40), (40, 80))
    assert log.defects.dropped == {"u_vgt": 120}


# --- samples -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_samples_that_cannot_be_are_dropped_and_counted(write, columns, read, bad):
    columns["p_im"][[10, 11]] = bad
    columns["W_maf"][[11, 12, 190]] = bad
    log = read(write(columns))
    np.testing.assert_array_equal(log.rows, np.delete(np.arange(200), [10, 11, 12, 190]))
    assert log.defects.dropped == {"p_im": 2, "W_maf": 3}
    assert log.defects.dropped_rows == 4
    assert log.defects.samples_read == 200


@pytest.mark.parametrize("name", ["p_em", "T_em"])
@pytest.mark.parametrize("bad", [-np.inf, 0.0])
def test_a_sensor_that_fails_low_is_not_taken_for_a_wrong_unit(write, columns, read, name, bad):
    """Exhaust gas is never colder than the air outside: but what the sensor cannot read says nothing about that."""
    columns[name][20:38] = bad  # 9 %, within the share that a fault of the sensor explains
    assert read(write(columns)).defects.dropped == {name: 18}


def test_null_is_not_a_number(write, columns, read):
    columns["T_em"] = pa.array([None if k == 5 else float(v) for k, v in enumerate(columns["T_em"])])
    assert read(write(columns)).defects.dropped == {"T_em": 1}


def test_a_sensor_may_read_slightly_below_zero(write, columns, read):
    columns["W_maf"][:30] = -0.004
    assert len(read(write(columns))) == 200


def test_a_channel_of_nothing_is_named(write, columns, read):
    columns["T_em"][:] = np.nan
    refusal(read, write(columns), "'T_em'")


WRONG = {
    "speed in rad/s called rpm": ("n_e", 2 * np.pi / 60, 0.0),
    "turbo speed in Hz called rad/s": ("omega_t", 1 / 60, 0.0),
    "gauge pressure": ("p_im", 1.0, -9.8e4),
    "kPa called Pa": ("p_em", 1e-3, 0.0),
    "bar called Pa": ("p_amb", 1e-5, 0.0),
    "degC called K": ("T_im", 1.0, -273.15),
    "mirrored opening": ("u_egr", -1.0, -10.0),
    "fuel with the wrong sign": ("u_delta", -1.0, 0.0),
    "g/s called kg/s": ("W_maf", 1e3, 0.0),
    "flow with the wrong sign": ("W_maf", -1.0, 0.0),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_channel_that_no_working_engine_shows_is_refused_as_a_wrong_unit_or_sign(write, columns, read, case):
    name, factor, offset = WRONG[case]
    columns[name] = columns[name] * factor + offset
    refusal(read, write(columns), f"'{name}'", "unit")


# --- policies ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "policies", [{"gap_limit": 0.0}, {"gap_limit": -1.0}, {"gap_limit": np.nan}, {"backward_time": "sort"}]
)
def test_policies_that_are_none(policies):
    with pytest.raises(ValueError, match="must be"):
        LogPolicies(**policies)


# --- limits of one engine -----------------------------------------------------------------------------------------------


def test_limits_of_the_configuration_stand_in_place_of_those_of_the_kind(columns, write, read):
    columns["u_delta"][7:10] = 320.0  # no car, a truck; three samples are no spike
    path = write(columns)
    assert read(path).defects.dropped == {"u_delta": 3}
    assert read(path, limits={"u_delta": ChannelLimits(high=400.0)}).defects.dropped == {}
    refusal(
        read,
        path,
        "'n_e'",
        "expected a median between 300 and 900",
        limits={"n_e": ChannelLimits(typical=(300.0, 900.0))},
    )


@pytest.mark.parametrize("wrong", [{"low": 2.0, "high": 1.0}, {"typical": (3.0, 3.0)}])
def test_limits_the_wrong_way_round_are_refused(wrong):
    with pytest.raises(ValueError, match="must be below"):
        ChannelLimits(**wrong)
