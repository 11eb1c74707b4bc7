"""Logs read slab by slab: the same samples, counts and refusals as when read whole, whatever the slabs and row groups."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.errors import DataError, UsageError
from lpvobs.io.logs import reading
from lpvobs.io.logs.finding import find_logs
from lpvobs.io.logs.policies import LogPolicies
from lpvobs.io.logs.reading import LogFile, read_log, references

UNITS = {"time": "s"} | {name: channel.unit for name, channel in Diesel.channels.items()}


@pytest.fixture(params=[50, 64, 200, 1000])
def slab(request, monkeypatch):
    """Cut logs of 200 rows into slabs of this many."""
    monkeypatch.setattr(reading, "SLAB", request.param)
    return request.param


def together(log):
    pieces = list(log.pieces())
    time = np.concatenate([piece.time for piece in pieces])
    channels = {name: np.concatenate([piece.channels[name] for piece in pieces]) for name in pieces[0].channels}
    return time, channels, np.concatenate([piece.begins for piece in pieces])


def test_slabs_make_the_log_that_is_read_whole(write, columns, slab):
    columns["time"][120:] += 7.0  # a gap
    columns["p_im"][[3, 64, 65]] = np.nan
    columns["T_em"][199] = -5.0
    path = write(columns)
    log = LogFile(path, Diesel.channels, LogPolicies())
    time, channels, begins = together(log)
    whole = read_log(path, Diesel.channels, LogPolicies())
    np.testing.assert_array_equal(time, whole.time)
    for name in Diesel.channels:
        np.testing.assert_array_equal(channels[name], whole[name])
    np.testing.assert_array_equal(np.flatnonzero(begins), [start for start, _ in whole.segments])
    assert log.defects == whole.defects
    assert (log.name, log.sha256) == (whole.name, whole.sha256)


def test_time_that_runs_backward_across_slabs(write, columns, slab):
    columns["time"][130:140] -= 0.5
    path = write(columns)
    with pytest.raises(DataError, match="runs backward"):
        together(LogFile(path, Diesel.channels, LogPolicies()))
    policies = LogPolicies(backward_time="drop", gap_limit=0.2)
    log = LogFile(path, Diesel.channels, policies)
    whole = read_log(path, Diesel.channels, policies)
    if slab < 100:  # ten of fifty rows are more than a tenth, which is no repair
        with pytest.raises(DataError, match="at most"):
            together(log)
    else:
        np.testing.assert_array_equal(together(log)[0], whole.time)
        assert log.defects == whole.defects


def test_references_come_at_the_rows_that_were_kept(write, columns, slab):
    columns["p_im"][[3, 50, 199]] = np.nan
    units = {"ref_W_c": "kg/h", "ref_delta_W_c": "g/s"}
    path = write(columns | {"ref_W_c": columns["W_maf"], "ref_delta_W_c": np.arange(200.0)}, units)
    log = LogFile(path, Diesel.channels, LogPolicies())
    _, channels, _ = together(log)
    found = list(references(path, {"u_delta": "mg/cycle", "n_e": "rpm"}, log.kept))
    u, n, truth = (np.concatenate([piece[column] for piece in found]) for column in range(3))
    np.testing.assert_array_equal(u, channels["u_delta"])
    np.testing.assert_array_equal(n, channels["n_e"])
    np.testing.assert_allclose(truth, 1e-3 * np.delete(np.arange(200.0), [3, 50, 199]), rtol=1e-14)  # a conversion


def test_a_stretch_that_no_engine_shows_is_left_out_of_a_long_log_only(write, columns, monkeypatch):
    columns["n_e"][100:150], columns["W_maf"][100:150] = 0.0, 1e-3  # parked
    path = write(columns)
    assert len(read_log(path, Diesel.channels, LogPolicies())) == 200  # a quarter does not move the median
    monkeypatch.setattr(reading, "SLAB", 50)
    log = LogFile(path, Diesel.channels, LogPolicies())
    time, _, begins = together(log)
    assert time.size == 150
    assert log.defects.dropped_rows == 50
    assert begins.sum() == 1  # half a second is no gap
    columns["n_e"][50:150] = 0.0
    columns["n_e"][150:] = 1.0
    with pytest.raises(DataError, match="n_e"):
        together(LogFile(write(columns), Diesel.channels, LogPolicies()))


def test_nothing_usable_is_refused_as_when_read_whole(write, columns, slab):
    for spoil, words in ((np.nan, "no number"), (1e9, "p_im")):
        path = write(columns | {"p_im": np.full(200, spoil)})
        with pytest.raises(DataError, match=words):
            together(LogFile(path, Diesel.channels, LogPolicies()))
    with pytest.raises(DataError, match="no rows"):
        list(
            LogFile(
                write({name: column[:0] for name, column in columns.items()}), Diesel.channels, LogPolicies()
            ).pieces()
        )


def test_row_groups_do_not_matter(tmp_path, columns, slab):
    fields = [pa.field(name, pa.float64(), metadata={"unit": UNITS[name]}) for name in columns]
    table = pa.table(list(columns.values()), schema=pa.schema(fields))
    for number, rows in enumerate((200, 13)):
        pq.write_table(table, tmp_path / f"{number}.parquet", row_group_size=rows)
    a, b = (together(LogFile(tmp_path / f"{number}.parquet", Diesel.channels, LogPolicies())) for number in (0, 1))
    np.testing.assert_array_equal(a[0], b[0])
    np.testing.assert_array_equal(a[1]["W_maf"], b[1]["W_maf"])


def test_logs_are_found_by_name_pattern_and_folder(tmp_path, monkeypatch):
    for name in ("b/2.parquet", "b/1.parquet", "b/deep/3.parquet", "b/note.txt", "a[1].parquet"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    here = tmp_path.relative_to(tmp_path)

    def found(*names):
        return [str(path) for path in find_logs([here / name for name in names])]

    assert found("b") == ["b/1.parquet", "b/2.parquet", "b/deep/3.parquet"]
    assert found("b/*.parquet") == ["b/1.parquet", "b/2.parquet"]
    assert found("a[1].parquet", "nowhere.parquet") == [
        "a[1].parquet",
        "nowhere.parquet",
    ]  # that is for the reader to say
    assert [path.name for path in find_logs([tmp_path / "b" / "*[2].parquet"])] == ["2.parquet"]
    for nothing in ("*.csv", "b/deep/deeper/*"):
        with pytest.raises(UsageError, match="no log here"):
            found(nothing)


@pytest.mark.parametrize("most", [50, 1000])
def test_a_beginning_is_the_first_seconds_of_the_log_with_its_own_channels(write, columns, monkeypatch, most):
    monkeypatch.setattr(reading, "SLAB", most)
    columns["p_im"][30] = np.nan  # a sample that is left out
    path = write(columns | {"T_coolant": np.linspace(300.0, 360.0, columns["time"].size)}, {"T_coolant": "K"})
    whole, begins = (read_log(path, Diesel.channels, LogPolicies(), auxiliary=True, seconds=s) for s in (np.inf, 1.2))
    n = int(np.searchsorted(whole.time, whole.time[0] + 1.2))
    assert len(begins) == n < len(whole)
    assert begins.units == whole.units == {"T_coolant": "K"}
    for name, values in {"time": whole.time, "rows": whole.rows}.items():
        np.testing.assert_array_equal(getattr(begins, name), values[:n])
    for name in Diesel.channels:
        np.testing.assert_array_equal(begins[name], whole[name][:n])
    np.testing.assert_array_equal(begins.auxiliary["T_coolant"], whole.auxiliary["T_coolant"][:n])


def test_a_beginning_with_more_channels_than_fit_has_those_of_the_engine_alone(write, columns, monkeypatch):
    path = write(columns | {"T_coolant": np.full(columns["time"].size, 300.0)}, {"T_coolant": "K"})
    monkeypatch.setattr(reading.parquet, "MOST_READINGS", reading.SLAB * (len(Diesel.channels) + 1))
    assert not read_log(path, Diesel.channels, LogPolicies(), auxiliary=True, seconds=1.2).auxiliary
