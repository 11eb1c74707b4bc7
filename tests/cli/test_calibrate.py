"""`lpvobs calibrate`, and `estimate` on what it has found."""

import json
import shutil

import h5py
import pytest
from repository import DIESEL, LIU_ICE


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("calibrate")


def estimated(lpvobs, other_engine, chain, out, *options):
    """Return what `estimate` prints of the drive with the configuration, whose engine is not quite the one driven."""
    done = lpvobs(
        "estimate", "--config", DIESEL, "--gain", chain.gain, other_engine.drive, "--out", out, "--json", *options
    )
    assert done.code == 0, done.err
    return done.json


def test_points_that_were_held_out_are_predicted(lpvobs, other_engine, folder):
    done = lpvobs("calibrate", "--config", DIESEL, "--bench", other_engine.bench, "--out", folder / "a.h5", "--json")
    assert done.code == 0, done.err
    rows = {row["kind"]: row for row in done.json["rows"]}
    assert done.json["points"] == 40
    assert rows["compressor"]["held_out"] < 0.2 * rows["compressor"]["configured"]
    assert rows["filling"]["held_out"] < 0.8 * rows["filling"]["configured"]
    constant = done.json["constants"]["R_c"]
    assert constant["determined"]
    assert abs(constant["deviation"] - (0.0243 / 0.0245 - 1.0)) < 4.0 * constant["standard_error"]


def test_text_names_what_the_data_determined(lpvobs, other_engine, folder):
    done = lpvobs("calibrate", "--config", DIESEL, "--bench", other_engine.bench, "--out", folder / "b.h5")
    assert "as configured" in done.out
    assert "constants that the data determined: R_c" in done.err
    with h5py.File(folder / "b.h5") as file:
        assert json.loads(file["provenance"].attrs["inputs_sha256"]).keys() == {"bench.csv"}


@pytest.mark.proof
def test_estimate_is_better_with_the_engine(lpvobs, other_engine, chain, folder):
    without = estimated(lpvobs, other_engine, chain, folder / "without.h5")
    known = estimated(lpvobs, other_engine, chain, folder / "with.h5", "--engine", other_engine.known)
    errors = [said["logs"][0]["mean_relative_error"] for said in (without, known)]
    assert errors[1] < errors[0]  # by a fifth: without it the drive itself tells of most of the constants
    assert without["engine"] == {"source": "configuration", "calibrated": False}
    assert known["engine"] == {"source": str(other_engine.known), "calibrated": True}
    with h5py.File(folder / "with.h5") as file:
        assert "engine.h5" in json.loads(file["provenance"].attrs["inputs_sha256"])


def test_healthy_logs_and_meters_teach(lpvobs, other_engine, chain, folder):
    made = folder / "healthy.h5"
    call = ("calibrate", "--config", DIESEL, "--gain", chain.gain, "--healthy", other_engine.healthy, "--out", made)
    done = lpvobs(*call, "--json")
    assert done.code == 0, done.err
    assert done.json["inputs"] == ["healthy.parquet"]
    waves = {item["component"]: item for item in done.json["components"]}["W_maf_lag"]
    assert waves["standard_error"] < 0.5 * waves["before"]
    lacking = lpvobs("calibrate", "--config", DIESEL, "--reference", other_engine.healthy, "--out", folder / "no.h5")
    assert (lacking.code, "'W_reference' is missing" in lacking.err) == (3, True)


@pytest.mark.proof
def test_a_plan_names_points_that_help(lpvobs, other_engine, folder):
    bench = ("--bench", other_engine.bench, "--plan", "--out", folder / "plan.h5")
    known = lpvobs("calibrate", "--config", DIESEL, *bench, "--json")
    assert known.code == 0, known.err
    nothing = lpvobs("calibrate", "--config", DIESEL, "--plan", "--out", folder / "nothing.h5", "--json")
    assert nothing.code == 0, nothing.err
    for done in (known, nothing):
        assert len(done.json["plan"]) == 8
        assert set(done.json["plan"][0]["point"]) == {"u_delta", "n_e", "u_egr", "p_amb", "T_amb"}
        before = [item["before"] for item in done.json["plan"]]
        assert before == sorted(before, reverse=True)
    assert known.json["plan"][0]["before"] < 0.2 * nothing.json["plan"][0]["before"]
    assert nothing.json["inputs"] == []


@pytest.mark.slow
def test_tables_of_components_are_taken(lpvobs, folder):
    table = folder / "compressor.csv"
    lines = ["corrected_speed,corrected_flow,pressure_ratio", "rpm,kg/s,1"]
    lines += [
        f"{speed},{flow},{ratio}" for speed, flow, ratio in ((9e4, 0.05, 1.2), (9e4, 0.046, 1.3), (12e4, 0.07, 1.4))
    ]
    table.write_text("\n".join([*lines, "120000,0.066,1.5"]), encoding="utf-8")
    call = ("calibrate", "--config", DIESEL, "--map", f"compressor={table}", "--out", folder / "map.h5")
    done = lpvobs(*call)
    assert (
        done.code,
        "compressor.csv: value 'T_reference' (temperature that corrected quantities refer to) is missing" in done.err,
    ) == (3, True), done.err
    text = table.read_text(encoding="utf-8")
    table.write_text("# T_reference = 298 K\n# p_reference = 1 bar\n" + text, encoding="utf-8")
    done = lpvobs(*call, "--json")
    assert done.code == 0, done.err
    assert (done.json["points"], [row["kind"] for row in done.json["rows"]]) == (0, ["compressor map"])
    assert done.json["inputs"] == ["compressor.csv"]


def test_what_makes_no_sense_is_refused(lpvobs, other_engine, chain, folder):
    copy = folder / "copy.csv"
    shutil.copy(other_engine.bench, copy)
    bench = ("--bench", other_engine.bench)
    for options, code, said in (
        (("--config", DIESEL), 2, "no data to calibrate from"),
        (("--config", LIU_ICE, *bench), 2, "is calibrated from logs with a healthy MAF sensor only"),
        (("--config", DIESEL, *bench, "--bench", copy), 2, "same content"),
        (("--config", DIESEL, "--bench", other_engine.drive), 3, "'W_reference' is missing"),
    ):
        done = lpvobs("calibrate", *options, "--out", folder / "refused.h5")
        assert (done.code, said in done.err) == (code, True), done.err
        assert not (folder / "refused.h5").exists()
    call = ("--gain", chain.gain, other_engine.drive, "--engine", other_engine.known, "--out", folder / "refused.h5")
    done = lpvobs("estimate", "--config", DIESEL, *call, "--method", "batch")
    assert (done.code, "drop --engine" in done.err) == (2, True)
    done = lpvobs("estimate", "--config", other_engine.config, other_engine.drive, *call[3:])
    assert (done.code, "calibrated from another engine" in done.err) == (3, True)
