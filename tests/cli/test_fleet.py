"""Many logs from the command line: found by folder, done side by side, one bad log left out, resumed after a kill."""

import os
import shutil
import signal
import subprocess
import time
from dataclasses import replace
from xml.etree import ElementTree

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from hdf5 import contents
from reference.informing import point
from verbs import AFRESH

from lpvobs.api.fleet import PartTask, part_of
from lpvobs.io.configuration.config import load_config
from lpvobs.io.results.gains import read_gain
from lpvobs.io.results.parts import PartsFolder, StoredPart, run_key

LOGS = 4


@pytest.fixture(scope="session")
def fleet(pieces):
    assert len(list(pieces.iterdir())) == LOGS
    return pieces


@pytest.fixture(scope="session")
def estimate(lpvobs, config, chain):
    def run(*arguments):
        return lpvobs("estimate", "--config", config, "--gain", chain.gain, *arguments)

    return run


def test_a_folder_is_its_logs_and_says_which_agree(together):
    out, done = together
    shown = done.json
    assert [log["log"] for log in shown["logs"]] == [f"drive {number}" for number in range(LOGS)]
    assert [log["name"] for log in shown["agreement"]] == [f"drive {number}" for number in range(LOGS)]
    assert not any(log["disagrees"] for log in shown["agreement"])
    with h5py.File(out) as file:
        assert file["agreement/log"].size == LOGS
        assert {"nodes", "chi_square", "mean_difference", "deviation", "disagrees", "scatter"} < set(file["agreement"])
    assert sorted(path.name for path in out.parent.iterdir()) == ["r.h5", "said.json"]  # the parts are gone


@pytest.mark.parametrize("jobs", [pytest.param(jobs, marks=pytest.mark.proof) for jobs in (2, 3)])
def test_neither_the_jobs_nor_the_order_of_the_logs_change_a_byte(estimate, fleet, together, tmp_path, jobs):
    out = tmp_path / "r.h5"
    names = sorted(fleet.iterdir(), reverse=jobs == 3)
    done = estimate(*names, "--jobs", jobs, "--out", out)
    assert done.code == 0, done.err
    first, second = contents(together[0]), contents(out)
    if jobs == 3:  # the table of logs is in the order that they were named in
        first, second = ({k: v for k, v in found.items() if "agreement" not in k} for found in (first, second))
    assert first == second


def test_a_bad_log_among_many_is_named_and_the_rest_go_on(with_a_bad_one, together):
    out, bad, done = with_a_bad_one
    assert done.code == 3
    assert len(done.json["refused"]) == 1
    assert str(bad) in done.json["refused"][0]
    with h5py.File(out) as file, h5py.File(together[0]) as whole:
        np.testing.assert_array_equal(file["map/delta_W_c"], whole["map/delta_W_c"])


@pytest.mark.slow
def test_a_log_that_was_left_out_is_in_every_artefact(lpvobs, with_a_bad_one, tmp_path):
    out, bad, _ = with_a_bad_one
    page, suite = tmp_path / "r.html", tmp_path / "gates.xml"
    done = lpvobs("report", out, "--html", page, "--junit", suite, "--gate", "samples>=1", "--json")
    assert done.code == 3
    assert str(bad) in done.json["refused"][0]
    assert str(bad) in done.err
    assert str(bad) in page.read_text(encoding="utf-8")
    root = ElementTree.fromstring(suite.read_bytes())
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == (str(LOGS + 1), "0", "1")


@pytest.mark.proof
def test_logs_of_one_name_are_told_apart_by_their_folders(estimate, fleet, together, tmp_path):
    for number in range(LOGS):
        (tmp_path / f"V{number}").mkdir()
        shutil.copy(fleet / f"drive {number}.parquet", tmp_path / f"V{number}" / "jan.parquet")
    done = estimate(tmp_path, "--jobs", 1, "--out", tmp_path / "r.h5", "--json")
    assert done.code == 0, done.err
    assert [log["log"] for log in done.json["logs"]] == [f"V{number}_jan" for number in range(LOGS)]
    with h5py.File(tmp_path / "r.h5") as file, h5py.File(together[0]) as whole:
        np.testing.assert_array_equal(file["map/delta_W_c"], whole["map/delta_W_c"])


@pytest.mark.proof
def test_of_many_logs_a_summary_and_the_unusual_are_shown(estimate, table, tmp_path):
    bare = table.drop_columns([name for name in table.column_names if name.startswith("ref_")])
    place, field = table.column_names.index("W_maf"), table.schema.field("W_maf")
    for number in range(14):
        piece = bare.slice(300 * number, 2000)
        low = piece.set_column(place, field, [0.9 * piece["W_maf"].to_numpy()]) if number == 3 else piece
        pq.write_table(low, tmp_path / f"d{number}.parquet")
    done = estimate(tmp_path, "--jobs", 1, "--out", tmp_path / "r.h5")
    assert done.code == 0, done.err
    assert done.out.startswith("14 logs, 14 used, 0 left out; 0 finished in an earlier run\n")
    rows = [line for line in done.out.splitlines() if line.startswith("d")]
    assert {line.split()[0] for line in rows} == {"d3"}
    assert " - " not in done.out


@pytest.mark.proof
def test_a_sensor_that_has_drifted_is_shown(estimate, fleet, together, table, tmp_path):
    place = table.column_names.index("W_maf")
    field, column = table.schema.field("W_maf"), table["W_maf"].to_numpy()
    drifted = tmp_path / "drifted.parquet"
    pq.write_table(table.set_column(place, field, [1.05 * column]), drifted)
    done = estimate(fleet, drifted, "--out", tmp_path / "r.h5", "--json")
    assert done.code == 0, done.err
    assert [log["name"] for log in done.json["agreement"] if log["disagrees"]] == ["drifted"]
    assert "log drifted: its map differs from the map of all logs by" in done.err


@pytest.mark.proof
def test_a_killed_run_goes_on_where_it_was(estimate, config, chain, fleet, together, tmp_path):
    out = tmp_path / "r.h5"
    parts = tmp_path / "r.h5.parts"
    call = ["estimate", "--config", config, "--gain", chain.gain, fleet, "--jobs", "1", "--out", out]
    process = subprocess.Popen([*AFRESH, *map(str, call)], stderr=subprocess.DEVNULL)
    while len(list(parts.glob("[!.]*.part"))) < 2 and process.poll() is None:
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=60)
    done = list(parts.glob("[!.]*.part"))
    assert 2 <= len(done) < LOGS, "killed too late: the machine was faster than the look into the folder"
    assert not out.exists()
    (parts / f".{done[0].name}.lock").touch()  # what remains if the signal comes between a part and the end of its lock
    (parts / f"{'0' * 64}.part").write_bytes(b"half a file of another program")
    again = estimate(fleet, "--jobs", 2, "--out", out)
    assert again.code == 0, again.err
    assert contents(out) == contents(together[0])
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.proof
def test_parts_of_another_configuration_are_not_taken(estimate, config, chain, fleet, together, tmp_path):
    out, other = tmp_path / "r.h5", tmp_path / "other.toml"
    other.write_text(config.read_text().replace("smoothing = 0.05 ", "smoothing = 0.06 "))
    configuration, text = load_config(other)
    stored = read_gain(chain.gain)
    gain = stored.state
    folder = PartsFolder(out, run_key(text, gain), StoredPart)
    there = point(configuration.engine_path(), configuration.estimate)
    task = PartTask(there, configuration.grid(), gain, configuration.policies, configuration.kind.suspects, alone=True)
    for path in sorted(fleet.iterdir())[:2]:
        outcome = part_of(task, path)
        folder.keep(outcome.sha256, outcome.stored)
        assert part_of(replace(task, done=frozenset({outcome.sha256})), path).stored is None  # not done again
    done = estimate(fleet, "--out", out)
    assert done.code == 0, done.err
    assert contents(out) == contents(together[0])


@pytest.mark.parametrize("sent", [pytest.param(signal.SIGINT, marks=pytest.mark.proof), signal.SIGKILL])
@pytest.mark.slow
def test_no_process_is_left_behind(config, chain, fleet, tmp_path, sent):
    out, parts = tmp_path / "r.h5", tmp_path / "r.h5.parts"
    call = ["estimate", "--config", config, "--gain", chain.gain, fleet, "--jobs", "2", "--out", out]
    process = subprocess.Popen(
        [*AFRESH, *map(str, call)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not list(parts.glob("*.part")) and process.poll() is None:
        time.sleep(0.002)
    if sent == signal.SIGINT:
        os.killpg(process.pid, sent)  # as a terminal does: to the parent and its workers
        _, err = process.communicate(timeout=60)
        assert process.returncode == 130, err
        assert len(err.strip().splitlines()) == 1, err
    else:
        process.send_signal(sent)  # to the parent alone, which cannot tell them
        process.communicate(timeout=60)
    assert not out.exists()
    for _ in range(400):  # the library's own helper process ends when it notices that the others have
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("processes are left")


def test_usage_of_jobs(estimate, chain, fleet, tmp_path):
    out = tmp_path / "r.h5"
    for arguments, word in (
        (("--jobs", 2, "--method", "published"), "one log after the other"),
        (("--jobs", 2, "--scheduler", "tcp://127.0.0.1:1"), "drop one"),
        (("--jobs", 0), "jobs"),
    ):
        done = estimate(fleet, *arguments, "--out", out)
        assert done.code == 2, done.err
        assert word in done.err
    assert list(tmp_path.iterdir()) == []
    assert estimate(tmp_path / "*.parquet", "--out", out).code == 2


def test_a_log_that_informs_no_node_makes_no_map(estimate, table, tmp_path):
    log, out = tmp_path / "moment.parquet", tmp_path / "r.h5"
    pq.write_table(table.slice(0, 40), log)
    done = estimate(log, "--out", out)
    assert done.code == 3
    assert "moment: no node of the map was driven for long enough" in done.err
    assert not out.exists()
