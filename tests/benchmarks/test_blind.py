"""A small fixed part of the blind bank (`make blind` runs the whole of it): one log of every kind."""

import json
import os
import subprocess
import sys

import pytest
from repository import ROOT

NUMBERS = ("0", "10", "23", "26", "28")
"""Clean, one effect, a pair, driven by a logged channel, driven by nothing logged."""


def run(*arguments, **environment):
    call = [sys.executable, "benchmarks/blind", "--out", "-", "--jobs", "1", *map(str, arguments)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", **environment}
    return subprocess.run(call, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=3600, check=False)


@pytest.mark.proof
def test_one_log_of_every_kind_is_judged_rightly(tmp_path):
    done = run("--engine", "diesel", "--only", *NUMBERS, "--folder", tmp_path)
    assert done.returncode == 0, done.stderr
    rates = {rate["what"]: rate for rate in json.loads((tmp_path / "rates_1.json").read_text())["diesel"]}
    for what in ("single effect", "pair", "driven by a logged channel", "driven by nothing logged", "clean"):
        (rate,) = (rate for name, rate in rates.items() if name.startswith(what))
        assert (rate["seen"], rate["of"]) == (1, 1), done.stdout
    assert "unlogged" in (tmp_path / "1" / "diesel" / "truth.json").read_text()


@pytest.mark.slow
def test_without_recordings_the_throttled_drives_are_left_out_and_said_to_be(tmp_path):
    done = run("--engine", "throttled", "--folder", tmp_path, LPVOBS_MEASURED_DIR="")
    assert done.returncode == 0, done.stderr
    for told in (done.stdout, done.stderr):
        assert "LPVOBS_MEASURED_DIR is not set" in told


@pytest.mark.parametrize("known", ["draw", "alter", "diesel", "throttled", "score", "lpvobs.simulation.simulate"])
def test_the_judged_side_cannot_import_what_knows_the_truth(known):
    code = f"import sys; sys.path.insert(0, 'benchmarks/blind'); import judge; import {known}"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode != 0
    assert f"tried to import {known}" in done.stderr


def test_a_package_other_than_the_one_asked_for_does_not_judge(tmp_path):
    call = [sys.executable, "benchmarks/blind/judge.py", *map(str, [tmp_path] * 4), "refine", "a"]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode != 0
    assert f"instead of the package in {tmp_path}" in done.stderr
