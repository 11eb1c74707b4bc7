"""How long verbs take to start, and the first `estimate`: `python benchmarks/start.py [TREE [LOG]]`.

TREE is another state of these sources; both are timed in one run, in turn. Processor time counts, and the least of several: on a
shared machine everything else measures its other users. Bytecode is kept, as pip and Python do it. LOG saves the simulation of one.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from subprocess import DEVNULL

from common import CONFIG, markdown, publish

HERE = Path(__file__).parents[1]
ROUNDS = 3
STARTS = {
    "--version": ("--version",),
    "verify": ("verify", "nothing.h5"),
    "extrapolate": ("extrapolate", "nothing.h5"),
    "trace": ("trace", "nothing.h5", "nothing.parquet"),
    "refine": ("refine", "nothing.h5", "nothing.parquet", "--out", "r.h5"),
    "report": ("report", "nothing.h5"),
    "export": ("export", "nothing.h5", "--format", "csv", "--out", "m.csv"),
    "inspect": ("inspect", "nothing.parquet"),
    "estimate": ("estimate", "--config", "diesel.toml", "--gain", "nothing.h5", "nothing.parquet", "--out", "m.h5"),
}
"""Verbs that load what they need and find no file: what is left is the start."""


def taken(tree: Path, folder: Path, cache: Path, *arguments: str, call: Sequence[str] = ()) -> float:
    """Return the processor time of a verb, or of another call, children included [s]."""
    compiled = {
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPYCACHEPREFIX": str(cache.parent / "bytecode"),
        "PYTHONDONTWRITEBYTECODE": "",
    }
    environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"} | compiled
    own = [sys.executable, "-c", "from lpvobs.cli.start import run; run()", *arguments]
    with subprocess.Popen(call or own, cwd=folder, env=environment, stdout=DEVNULL, stderr=DEVNULL) as process:
        used = os.wait4(process.pid, 0)[2]
        process.returncode = 0  # that it has ended, the process itself no longer finds out
    return used.ru_utime + used.ru_stime


def prepared(tree: Path, folder: Path, cache: Path, log: Path | None) -> None:
    """Make a configuration, a log and a gain of a tree."""
    folder.mkdir()
    configuration = tree / CONFIG.relative_to(HERE)
    (folder / "diesel.toml").write_text(configuration.read_text(encoding="utf-8"), encoding="utf-8")
    simulated = ("--cycle", "ftp75_cold", "--rate", "20", "--out", "drive.parquet")
    if log is None:
        taken(tree, folder, cache, "simulate", "--config", "diesel.toml", *simulated)
    else:
        shutil.copy(log, folder / "drive.parquet")
    taken(tree, folder, cache, "synth-gain", "--config", "diesel.toml", "drive.parquet", "--out", "gain.h5")


def first_times(tree: Path, folder: Path, root: Path, name: str) -> list[str]:
    """Return the first `estimate` with nothing compiled, after a self-test, and the next one; and the self-test."""
    estimate = ("estimate", "--config", "diesel.toml", "--gain", "gain.h5", "drive.parquet", "--out", "map.h5")
    cold = taken(tree, folder, root / f"{name}-cold", *estimate)
    test = taken(tree, folder, root / f"{name}-tested", "selftest")
    first = taken(tree, folder, root / f"{name}-tested", *estimate)
    warm = min(taken(tree, folder, root / f"{name}-tested", *estimate) for _ in range(ROUNDS))
    return [f"{cold:.2f}", f"{test:.1f}", f"{first:.2f}", f"{warm:.2f}", f"{first / warm:.2f}"]


def first_run(tree: Path, root: Path, name: str) -> list[str]:
    """Return the processor time of compiling in `make setup`, and of the first `make run` after it, and how long that took."""
    venv, cache = root / f"{name}-venv", root / f"{name}-set-up"
    (venv / "bin").mkdir(parents=True)
    script = venv / "bin" / "lpvobs"
    code = "from lpvobs.cli.start import run; run()"
    script.write_text(f"#!/bin/sh\nexec {sys.executable} -c '{code}' \"$@\"\n", encoding="utf-8")
    script.chmod(0o755)
    for done in (".installed", ".ready"):
        (venv / done).touch()
    compiles = "bin/lpvobs selftest" in (tree / "Makefile").read_text(encoding="utf-8")
    set_up = taken(tree, root / name, cache, "selftest") if compiles else 0.0
    build, begin = root / f"{name}-build", time.monotonic()
    first = taken(tree, root / name, cache, call=("make", "-C", str(tree), "run", f"VENV={venv}", f"BUILD={build}"))
    took = time.monotonic() - begin
    if not (build / "report.html").exists():
        raise RuntimeError(f"{tree}: make run made no report")
    return [f"{set_up:.1f}", f"{first:.1f}", f"{took:.0f}"]


def main() -> None:
    log = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    trees = {"now": HERE} | ({"before": Path(sys.argv[1]).resolve()} if len(sys.argv) > 1 else {})
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        for tree, path in trees.items():
            prepared(path, root / tree, root / f"{tree}-made", log)
        rows = []
        for verb, arguments in STARTS.items():
            least = dict.fromkeys(trees, float("inf"))
            for _ in range(ROUNDS):
                for tree, path in trees.items():
                    least[tree] = min(least[tree], taken(path, root / tree, root / f"{tree}-made", *arguments))
            rows.append([f"`{verb}`", *(f"{seconds:.2f}" for seconds in reversed(least.values()))])
        firsts = [[tree, *first_times(path, root / tree, root, tree)] for tree, path in reversed(trees.items())]
        runs = [[tree, *first_run(path, root, tree)] for tree, path in reversed(trees.items())]
    text = [
        "## Starts of verbs, s",
        markdown(("verb", *reversed(trees)), rows),
        f"Processor time until the verb finds that its file is not there, least of {ROUNDS}.",
        "## The first `estimate`, one drive of 505 s at 20 Hz, s",
        markdown(
            ("", "nothing compiled", "`selftest`, nothing compiled", "first after it", "warm", "first over warm"),
            firsts,
        ),
        "## `make run`, s",
        markdown(("", "compiling in `make setup`", "the first after it", "its time by the clock"), runs),
        "Processor time but for the last column, which is short where processors are free: verbs that do not wait for each other "
        "run side by side. `make setup` runs `lpvobs selftest`, which calls every kernel; `docs/ci.md` says where to do the same "
        "in a container.",
    ]
    publish("start", "From the first second", "\n\n".join(text), "python benchmarks/start.py TREE")


main()
