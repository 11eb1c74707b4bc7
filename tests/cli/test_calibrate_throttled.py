"""`calibrate --healthy` of an engine that learns its curves, and every verb on what it has found."""

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from contract.test_contract import THROTTLED_CHANNELS
from reference import throttled_drive
from repository import LIU_ICE


def written(path, seconds, seed, gain=1.0):
    channels = throttled_drive.drive(seconds, seed)
    channels["u_wg"] = np.zeros(channels["time"].size)
    channels["W_maf"] = gain * channels["W_maf"]
    fields = [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in THROTTLED_CHANNELS.items()]
    pq.write_table(pa.table([channels[name] for name in THROTTLED_CHANNELS], schema=pa.schema(fields)), path)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("throttled")


@pytest.fixture(scope="module")
def engine(lpvobs, folder):
    """Return an engine that a healthy drive of ten minutes has taught."""
    done = lpvobs(
        "calibrate",
        "--config",
        LIU_ICE,
        "--healthy",
        written(folder / "healthy.parquet", 600.0, 0),
        "--out",
        folder / "engine.h5",
    )
    assert done.code == 0, done.err
    assert "filling" in done.out
    assert "engine made from healthy.parquet" in done.err
    return folder / "engine.h5"


@pytest.mark.slow
def test_a_map_made_with_the_engine_is_the_change_since(lpvobs, engine, folder):
    today = written(folder / "today.parquet", 300.0, 3, gain=1.1)
    done = lpvobs("estimate", "--config", LIU_ICE, "--engine", engine, today, "--out", folder / "map.h5", "--json")
    assert done.code == 0, done.err
    assert done.json["engine"]["calibrated"]
    with h5py.File(folder / "map.h5") as file, h5py.File(engine) as known:
        for name in ("throttle/area", "filling/eta_vol", "numbers/covariance"):
            np.testing.assert_array_equal(file["engine"][name][()], known["engine"][name][()])
    healthy = lpvobs("estimate", "--config", LIU_ICE, today, "--out", folder / "itself.h5")
    assert healthy.code == 0, healthy.err
    maps = [h5py.File(folder / name)["map/delta_W_c"][()] for name in ("map.h5", "itself.h5")]
    # a tenth of flows of 2 to 30 g/s; an engine that is learned from the log itself takes its sensor for right
    assert 4e-4 < np.nanmedian(maps[0]) < 3e-3
    assert abs(np.nanmedian(maps[1])) < 0.2 * np.nanmedian(maps[0])


@pytest.mark.slow
def test_a_report_shows_its_curves(lpvobs, engine, folder):
    done = lpvobs("report", engine, "--html", folder / "engine.html", "--json")
    assert done.code == 0, done.err
    assert {item["component"] for item in done.json["components"]} == {"throttle", "filling", "fuel"}
    assert "throttle" in (folder / "engine.html").read_text()


@pytest.mark.parametrize("option", ["--bench", "--reference"])
def test_only_healthy_logs_teach_it(lpvobs, folder, option):
    done = lpvobs("calibrate", "--config", LIU_ICE, option, folder / "healthy.parquet", "--out", folder / "no.h5")
    assert done.code == 2
    assert "is calibrated from logs with a healthy MAF sensor only" in done.err


@pytest.mark.proof
def test_a_fleet_of_such_engines_is_tracked_with_what_was_taught_once(lpvobs, engine, folder):
    (folder / "fleet").mkdir()
    logs = [
        written(folder / "fleet" / f"V1-2025-0{month}-15.parquet", 100.0, 10 + month, 1.0 if month < 3 else 1.06)
        for month in range(1, 6)
    ]
    track = ("track", "--config", LIU_ICE, "--path", "{vehicle}-{date}.parquet", "--out", folder / "fleet.h5", "--json")
    untaught = lpvobs(*track, *logs)
    assert untaught.code == 2
    assert "learn them once with `lpvobs calibrate --healthy LOG`, and give --engine" in untaught.err
    done = lpvobs(*track, "--engine", engine, "--jobs", 1, *logs)
    assert done.code == 0, done.err
    (change,) = done.json["changes"]
    assert change["kind"] == "step"
    assert change["size"][1] == pytest.approx(0.06, abs=0.02)
