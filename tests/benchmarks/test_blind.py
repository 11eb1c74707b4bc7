"""A small fixed part of the blind bank (`make blind` runs the whole of it): one log of every kind."""

import json
import os
import subprocess
import sys

from repository import ROOT

NUMBERS = (
    "0",
    "10",
    "23",
    "26",
    "28",
)  # clean, one effect, a pair, driven by a logged channel, driven by nothing logged


def test_one_log_of_every_kind_is_judged_rightly(tmp_path):
    call = [
        sys.executable,
        "benchmarks/blind",
        "--only",
        *NUMBERS,
        "--folder",
        str(tmp_path),
        "--out",
        "-",
        "--jobs",
        "1",
    ]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(call, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    rates = {rate["what"]: rate for rate in json.loads((tmp_path / "rates_1.json").read_text())}
    for what in ("single effect", "pair", "driven by a logged channel", "driven by nothing logged", "clean"):
        (rate,) = (rate for name, rate in rates.items() if name.startswith(what))
        assert (rate["seen"], rate["of"]) == (1, 1), done.stdout
    assert "unlogged" in (tmp_path / "truth_1.json").read_text()


def test_the_judged_side_cannot_import_what_knows_the_truth(tmp_path):
    code = (
        "import sys; sys.argv = ['judge.py', '.', '0', '1', 'refine']; sys.path.insert(0, 'benchmarks/blind');"
        "import judge; import draw"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode != 0
    assert "tried to import draw" in done.stderr
