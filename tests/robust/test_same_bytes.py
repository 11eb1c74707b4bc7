"""Same inputs, same bytes, whatever the threads of the linear algebra and of the kernels, and the number of processes.

That slabs and pieces of a log change nothing is shown in tests/io/test_stream.py and tests/observer/test_pieces.py.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hdf5 import contents
from robust.kill import CONFIGURED, GAIN, ROOT, lay_out

# Everything in one process per setting: loading the libraries takes longer than the verbs do.
SCRIPT = """
import sys
from lpvobs.cli.main import run
for line in {lines!r}:
    sys.argv = ["lpvobs", *line]
    try:
        run()
    except SystemExit as end:
        if end.code:
            sys.exit(f"{{line}}: exit code {{end.code}}")
"""
RATE = ("--rate", "10")
pytestmark = pytest.mark.proof


def lines(jobs: int) -> list[tuple[str, ...]]:
    """Return every verb that computes, on 80 s of driving."""
    drive = ("simulate", *CONFIGURED, "--cycle", "cycle.csv", *RATE)
    return [
        *((*drive, "--seed", str(seed), "--out", f"{seed}.parquet") for seed in (1, 2, 3)),
        ("synth-gain", *CONFIGURED, "1.parquet", "--out", "gain.h5"),
        ("estimate", *CONFIGURED, *GAIN, "1.parquet", "2.parquet", "--jobs", str(jobs), "--out", "map.h5"),
        ("extrapolate", "map.h5"),
        ("refine", "map.h5", "1.parquet", "2.parquet", "--out", "refined.h5"),
        ("trace", "map.h5", "3.parquet"),
    ]


def ran(folder: Path, threads: int, jobs: int) -> Path:
    """Run the verbs in a folder of their own and return it."""
    folder.mkdir()
    lay_out(folder)
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **dict.fromkeys(names, str(threads))}
    call = [sys.executable, "-c", SCRIPT.format(lines=lines(jobs))]
    done = subprocess.run(call, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def alone(tmp_path_factory) -> Path:
    return ran(tmp_path_factory.mktemp("same") / "one", threads=1, jobs=1)


@pytest.fixture(scope="module")
def two(tmp_path_factory) -> Path:
    return ran(tmp_path_factory.mktemp("same") / "two", threads=2, jobs=2)


@pytest.mark.parametrize("name", ["1.parquet", "2.parquet", "3.parquet"])
def test_logs(alone, two, name):
    assert (alone / name).read_bytes() == (two / name).read_bytes()


@pytest.mark.parametrize("name", ["gain.h5", "map.h5", "refined.h5"])
def test_gains_maps_and_what_is_missing_in_them(alone, two, name):
    one, other = contents(alone / name), contents(two / name)
    assert one.keys() == other.keys()
    assert [key for key in one if one[key] != other[key]] == []
    if name == "map.h5":
        assert {"trace", "extrapolation", "map/delta_W_c"} <= one.keys()  # every verb has left what is compared
