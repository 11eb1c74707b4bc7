"""The closed loop from the command line: a slow sensor that nobody declared, and a log in order."""

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

TAU = 0.1  # s


@pytest.fixture(scope="module")
def slow(table, tmp_path_factory):
    """Return the drive with a sensor that follows the flow with a lag, and the same noise."""
    h = 0.05
    reading = table["W_maf"].to_numpy()
    truth = table["ref_W_c"].to_numpy() + table["ref_delta_W_c"].to_numpy()
    follows = truth.copy()
    for k in range(1, truth.size):
        follows[k] = truth[k] + (follows[k - 1] - truth[k]) * np.exp(-h / TAU)
    place = table.column_names.index("W_maf")
    path = tmp_path_factory.mktemp("slow") / "slow.parquet"
    pq.write_table(table.set_column(place, table.schema.field(place), pa.array(follows + reading - truth)), path)
    return path


def test_a_log_in_order_is_found_in_order(lpvobs, chain, tmp_path):
    out = tmp_path / "refined.h5"
    before = chain.result.read_bytes()
    done = lpvobs("refine", chain.result, chain.log, "--out", out, "--json")
    assert done.code == 0, done.err
    assert done.json["schema"] == "lpvobs/refine/1"
    assert done.json["verdict"] == "none"
    assert done.json["effects"] == []
    assert out.read_bytes() == before


def test_a_slow_sensor_is_named_sized_and_removed(lpvobs, chain, slow, tmp_path):
    out = tmp_path / "refined.h5"
    done = lpvobs("refine", chain.result, slow, "--out", out, "--json")
    assert done.code == 0, done.err
    assert done.json["verdict"] == "effect"
    first = done.json["effects"][0]
    assert "maf.lag" in (first["id"], *first["indistinguishable"])
    if first["id"] == "maf.lag":
        # at 20 Hz a lag of two samples is told from a dead time, but not better than to half a sample
        assert first["parameters"]["tau"]["value"] == pytest.approx(TAU, abs=0.025)
    assert done.json["error"]["after"] < 0.8 * done.json["error"]["before"]
    with h5py.File(out) as file:
        assert "maf" in file["refinement"].attrs["json"]
        assert "extrapolation" not in file
    assert lpvobs("trace", out, slow).code == 3  # its effects are not part of the model that would be traced


def test_trace_leaves_everything_but_its_own_group(lpvobs, chain, slow, tmp_path):
    result = tmp_path / "result.h5"
    result.write_bytes(chain.result.read_bytes())
    done = lpvobs("trace", result, slow, "--json")
    assert done.code == 0, done.err
    assert done.json["schema"] == "lpvobs/trace/1"
    assert "after" not in done.json["error"]
    with h5py.File(result) as after, h5py.File(chain.result) as before:
        assert set(after) - set(before) == {"trace"}
        assert np.array_equal(after["map/delta_W_c"][()], before["map/delta_W_c"][()], equal_nan=True)
