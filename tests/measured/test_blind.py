"""Two altered drives of the real engine, judged blindly (`make blind` runs ninety)."""

import json
import os
import subprocess
import sys

import pytest
from repository import ROOT

CLEAN, LEAK = "0", "16"


@pytest.mark.proof
def test_a_clean_day_and_a_leak_are_told_apart_on_altered_recordings(measured, tmp_path):
    call = [sys.executable, "benchmarks/blind", "--engine", "throttled", "--bank", "77", "--only", CLEAN, LEAK]
    call += ["--jobs", "1", "--folder", str(tmp_path), "--out", "-"]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "LPVOBS_MEASURED_DIR": str(measured.resolve())}
    done = subprocess.run(call, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    rates = {rate["what"]: rate for rate in json.loads((tmp_path / "rates_77.json").read_text())["throttled"]}
    for what in ("clean: `none`", "the same log without", "single effect"):
        (rate,) = (rate for name, rate in rates.items() if name.startswith(what))
        assert (rate["seen"], rate["of"]) == (1, 1), done.stdout
