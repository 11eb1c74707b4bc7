"""The examples for CI: the Makefile fragment is run, the workflow calls it and keeps what it writes."""

import os
import re
import shlex
import shutil
import subprocess
from xml.etree import ElementTree

import pyarrow.parquet as pq
import pytest
from repository import ROOT
from verbs import AFRESH

EXAMPLES = ROOT / "examples" / "ci"
FRAGMENT, WORKFLOW = EXAMPLES / "lpvobs.mk", EXAMPLES / "github.yml"
CALLED = re.compile(r"run: (make -f \S*lpvobs\.mk .*)")


@pytest.fixture
def project(config, chain, table, tmp_path):
    """Return a folder as a user has it: a configuration, and two short logs."""
    shutil.copy(config, tmp_path / "lpvobs.toml")
    shutil.copy(chain.gain, tmp_path / "gain.h5")
    (tmp_path / "logs").mkdir()
    for name, start in (("monday", 0), ("tuesday", 4000)):
        pq.write_table(table.slice(start, 4000), tmp_path / "logs" / f"{name}.parquet")
    return tmp_path


def validate(project, gates):
    lpvobs = f"LPVOBS={shlex.join(AFRESH)}"
    call = ["make", "-f", FRAGMENT, "lpvobs-validate", lpvobs, "LPVOBS_GAIN=gain.h5", f"LPVOBS_GATES={gates}"]
    return subprocess.run(call, cwd=project, env=ALONE, capture_output=True, text=True, timeout=300, check=False)


def outcomes(project):
    root = ElementTree.parse(project / "build" / "lpvobs" / "gates.xml").getroot()
    return {case.get("name"): next(item.tag for item in case) for case in root.iter("testcase")}


ALONE = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
"""Environment of a make that is nobody's part: the tests themselves may have been started by one."""
needs_make = pytest.mark.skipif(shutil.which("make") is None, reason="no make here")


@needs_make
@pytest.mark.slow
def test_good_logs_pass(project):
    done = validate(project, "mean_relative_error<=0.2 samples>=4000")
    assert done.returncode == 0, done.stderr
    assert set(outcomes(project).values()) == {"system-out"}
    assert len(outcomes(project)) == 4
    assert "<html" in (project / "build" / "lpvobs" / "report.html").read_text(encoding="utf-8")


@needs_make
@pytest.mark.parametrize(
    ("folder", "named"),
    [("my logs", "my logs"), ("it's here", "it's here"), ("two words", "'two words' 'two words/monday.parquet'")],
)
def test_folders_may_be_called_anything(tmp_path, folder, named):
    """The command shows its arguments instead of running, which is what matters here."""
    (tmp_path / folder).mkdir()
    out = f"LPVOBS_OUT={folder}/a b"
    call = ["make", "-f", FRAGMENT, "lpvobs-validate", "LPVOBS=printf '%s\\n'", f"LPVOBS_LOGS={named}", out]
    done = subprocess.run(call, cwd=tmp_path, env=ALONE, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    words = [named] if named == folder else shlex.split(named)
    assert done.stdout.splitlines() == ["estimate", *words, "--out", f"{folder}/a b/map.h5"]
    assert (tmp_path / folder / "a b").is_dir()


@pytest.mark.slow
@needs_make
def test_a_gate_that_a_log_fails_and_a_log_that_is_none_fail_the_run(project):
    (project / "logs" / "damaged.parquet").write_bytes(b"PAR1")
    done = validate(project, "mean_relative_error<=0.2 samples>=4001")
    assert done.returncode != 0
    assert "left out: logs/damaged.parquet" in done.stderr
    assert "gate failed" in done.stderr
    found = outcomes(project)
    assert [name for name, outcome in found.items() if outcome == "failure"] == [
        "monday: samples>=4001", "tuesday: samples>=4001",
    ]  # fmt: skip
    assert (project / "build" / "lpvobs" / "exit_codes").read_text() == "estimate 3\nreport 1\n"
    (project / "logs" / "tuesday.parquet").unlink()
    (project / "logs" / "monday.parquet").unlink()
    assert validate(project, "samples>=1").returncode != 0
    assert not (project / "build" / "lpvobs" / "gates.xml").exists()  # nothing of the run before is left
    assert (project / "build" / "lpvobs" / "exit_codes").read_text() == "estimate 3\n"


def test_the_workflow_calls_the_fragment_with_gates_that_exist():
    from lpvobs.report.gates import parse_gate

    (call,) = (shlex.split(found) for found in CALLED.findall(WORKFLOW.read_text(encoding="utf-8")))
    assert f".PHONY: {call[3]}" in FRAGMENT.read_text(encoding="utf-8")
    (gates,) = (word.removeprefix("LPVOBS_GATES=") for word in call[4:])
    (default,) = re.findall(r"LPVOBS_GATES +\?= (.*)", FRAGMENT.read_text(encoding="utf-8"))
    for gate in (*gates.split(), *default.split()):
        parse_gate(gate)


def test_the_workflow_keeps_what_the_fragment_writes():
    yaml = pytest.importorskip("yaml", reason="comes with the extra lpvobs[cluster]")
    steps = yaml.safe_load(WORKFLOW.read_text(encoding="utf-8"))["jobs"]["validate"]["steps"]
    (folder,) = re.findall(r"LPVOBS_OUT +\?= (\S+)", FRAGMENT.read_text(encoding="utf-8"))
    kept = steps[-1]
    assert (kept["if"], kept["with"]["path"]) == ("always()", folder)
    call, told, published, _ = steps[-4:]
    assert CALLED.search(f"run: {call['run']}")
    assert told["run"].split()[1] == f"{folder}/exit_codes"
    assert "junit" in published["uses"]
    assert published["with"]["report_paths"] == f"{folder}/gates.xml"
    assert {step["if"] for step in (told, published)} == {"always()"}
