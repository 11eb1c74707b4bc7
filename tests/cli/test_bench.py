"""`lpvobs simulate --bench`."""

import csv
import json

import pyarrow.parquet as pq
import pytest
from repository import DIESEL


@pytest.fixture(scope="module")
def folder(lpvobs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    for name in ("bench.csv", "bench.parquet"):
        done = lpvobs("simulate", "--config", DIESEL, "--bench", 2, "--seed", 4, "--out", folder / name)
        assert done.code == 0, done.err
        assert f"{name}: 2 stationary points" in done.err
    return folder


def test_csv_and_parquet_hold_the_same_with_units(folder):
    with (folder / "bench.csv").open(newline="") as stream:
        names, units, *rows = csv.reader(stream)
    table = pq.read_table(folder / "bench.parquet")
    assert table.column_names == names
    assert [field.metadata[b"unit"].decode() for field in table.schema] == units
    assert [list(map(float, row)) for row in rows] == [list(row.values()) for row in table.to_pylist()]
    assert "time" not in names
    assert "W_reference" in names


def test_json_tells_points_and_columns(lpvobs, folder):
    done = lpvobs("simulate", "--config", DIESEL, "--bench", 1, "--out", folder / "one.csv", "--json")
    told = json.loads(done.out)
    assert told["schema"] == "lpvobs/simulate/1"
    assert told["samples"] == 1
    assert "W_egr_reference" in told["channels"]
    assert told["duration"] == 30.0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--bench", 2, "--cycle", "nedc"), "drop --cycle"),
        (("--bench", 2, "--rate", 20, "--effects", "some.toml"), "drop --effects and --rate"),
        (("--bench", 0), "expected 1 to 1000"),
        ((), "neither --cycle nor --bench"),
    ],
)
def test_what_makes_no_sense_is_refused(lpvobs, folder, options, said):
    done = lpvobs("simulate", "--config", DIESEL, *options, "--out", folder / "refused.csv")
    assert done.code == 2
    assert said in done.err
    assert not (folder / "refused.csv").exists()
