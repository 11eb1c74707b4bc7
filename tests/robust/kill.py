"""SIGKILL at random moments of every verb that writes: the target is absent, old or whole, every time.

    PYTHONPATH=.:tests python -m robust.kill [--number 1000] [--seed 1] [--verbs estimate,report]

Half of the trials kill anywhere in the verb's course, the other half in the moments after its first temporary file appeared
beside the target; a trial that ends before its kill does not count. Each trial is a forked process that has everything imported,
so that its time goes into the verb; only the workers of `--jobs` start afresh, as they always do. What `--jobs` keeps of finished
logs must be whole, too, and gone after the next run that is left alone.
"""

import argparse
import os
import random
import shlex
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import verbs
from repository import DIESEL, ROOT, short_cycle

from lpvobs.io.results.parts import StoredPart, part_of_bytes
from lpvobs.tracking.sums import KeptLog

SOURCE = "drive.csv"
PROFILE = """
schema = 1
[time]
source = "time"
unit = "s"
[channels.n_e]
source = "speed"
unit = "rpm"
source_unit = "rpm"
"""
LIMIT = 120.0
"""[s]; a verb that takes longer hangs."""
WRITING = 0.01
"""[s] from the first temporary file on that half of the kills aim at."""
PATIENCE = 5
"""Trials per kill that is wanted, before a verb is given up as too quick."""


@dataclass(frozen=True)
class Verb:
    """A command line with the file that it writes; `source` is what stands there before where the verb changes it in place.

    `share` says how many of the kills it gets; those that take seconds get fewer. `parts` is what it keeps of logs meanwhile; it
    `goes_on` with what stands in its target, so nothing of another kind may.
    """

    name: str
    arguments: tuple[str, ...]
    target: str
    source: str | None = None
    share: int = 10
    parts: type[Any] = StoredPart
    goes_on: bool = False


CONFIGURED = ("--config", "diesel.toml")
GAIN = ("--gain", "gain.h5")
ORIGIN = ("--path", "{vehicle}-{date}.parquet")
TRACK = ("track", *CONFIGURED, *GAIN, *ORIGIN, "fleet", "--out", "o.h5")
VERBS = (
    Verb("simulate", ("simulate", *CONFIGURED, "--cycle", "cycle.csv", "--rate", "20", "--out", "o.parquet"), "o.parquet", share=4),
    Verb("profile", ("profile", SOURCE, "--out", "o.toml"), "o.toml"),
    Verb("ingest", ("ingest", SOURCE, "--profile", "profile.toml", "--out", "o.parquet"), "o.parquet"),
    Verb("synth-gain", ("synth-gain", *CONFIGURED, "log.parquet", "--out", "o.h5"), "o.h5", share=5),
    Verb("estimate", ("estimate", *CONFIGURED, *GAIN, "log.parquet", "--out", "o.h5"), "o.h5"),
    Verb("estimate --jobs", ("estimate", *CONFIGURED, *GAIN, "fleet", "--jobs", "2", "--out", "o.h5"), "o.h5", share=4),
    Verb("track", (*TRACK, "--jobs", "1"), "o.h5", share=4, parts=KeptLog, goes_on=True),
    Verb("track more", (*TRACK, "--jobs", "2"), "o.h5", "fleet.h5", share=4, parts=KeptLog),
    Verb("extrapolate", ("extrapolate", "o.h5"), "o.h5", "result.h5", share=15),
    Verb("trace", ("trace", "o.h5", "log.parquet"), "o.h5", "result.h5", share=5),
    Verb("refine", ("refine", "result.h5", "log.parquet", "--out", "o.h5"), "o.h5", share=5),
    Verb("report", ("report", "result.h5", "log.parquet", "--html", "o.html"), "o.html", share=5),
    Verb("export", ("export", "filled.h5", "--format", "dcm", "--out", "o.dcm"), "o.dcm"),
    Verb("export netcdf", ("export", "filled.h5", "--format", "netcdf", "--out", "o.nc"), "o.nc"),
)  # fmt: skip


def lay_out(folder: Path) -> None:
    """Copy the configuration and the first 80 s of a drive into a folder."""
    shutil.copy(DIESEL, folder)
    short_cycle(folder)


def prepare(folder: Path) -> None:
    """Write the inputs of every verb, by the command line."""
    lay_out(folder)
    (folder / "profile.toml").write_text(PROFILE)
    rows = [f"{0.01 * k:.2f},{900 + k % 700}" for k in range(20_000)]
    (folder / SOURCE).write_text("time,speed\n" + "\n".join(rows) + "\n")
    (folder / "fleet").mkdir()
    for line in (
        *(
            ("simulate", *CONFIGURED, "--cycle", "cycle.csv", "--rate", "10", "--seed", str(seed), "--out", name)
            for seed, name in enumerate(("log.parquet", "fleet/a-2025-01-15.parquet", "fleet/a-2025-02-15.parquet"), 1)
        ),
        ("synth-gain", *CONFIGURED, "log.parquet", "--out", "gain.h5"),
        ("estimate", *CONFIGURED, "--gain", "gain.h5", "log.parquet", "--out", "result.h5"),
        ("estimate", *CONFIGURED, "--gain", "gain.h5", "log.parquet", "--out", "filled.h5"),
        ("extrapolate", "filled.h5"),
        ("track", *CONFIGURED, *GAIN, *ORIGIN, "fleet/a-2025-01-15.parquet", "--out", "fleet.h5"),
    ):
        done = verbs.lpvobs(*line, cwd=folder)
        assert done.code == 0, done.err


def warm() -> None:
    """Import what the verbs import; running any of it would start threads that do not survive a fork."""
    import clarabel  # noqa: F401
    import cvxpy  # noqa: F401
    import h5py  # noqa: F401
    import jinja2  # noqa: F401
    import numba  # noqa: F401
    import pyarrow.parquet  # noqa: F401


def start(arguments: tuple[str, ...], folder: Path, errors: Path = Path(os.devnull), *, in_shell: bool = False) -> int:
    """Run a command line in a forked process, as it is or by a shell that starts Python afresh; return its id."""
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        os.chdir(folder)
        nothing, said = os.open(os.devnull, os.O_RDWR), os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for stream, where in enumerate((nothing, nothing, said)):
            os.dup2(where, stream)
        if in_shell:
            afresh = shlex.join((*verbs.AFRESH, *arguments))
            os.execvpe("sh", ["sh", "-c", f"exec {afresh}"], {**os.environ, "PYTHONPATH": str(ROOT)})
        sys.argv = ["lpvobs", *arguments]
        from lpvobs.cli.main import run

        run()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    finally:
        sys.stderr.flush()
        os._exit(code)


def finish(verb: Verb, folder: Path) -> float:
    """Run a verb to its end; return the time it took."""
    began = time.monotonic()
    _, status = os.waitpid(start(verb.arguments, folder), 0)
    if os.waitstatus_to_exitcode(status) != 0:
        raise RuntimeError(f"{verb.name}: exit code {os.waitstatus_to_exitcode(status)} when nobody killed it")
    return time.monotonic() - began


def hidden(folder: Path) -> list[str]:
    """Return what writers have left or are working on."""
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def strange(folder: Path, target: str, inputs: set[str], parts: type[Any]) -> list[str]:
    """Return what a writer of `target` must not leave: other files than its own, and parts of logs that are not whole."""
    names = {path.name for path in folder.iterdir()} - inputs - {target, f"{target}.parts"}
    found = [name for name in names if not name.startswith(f".{target}.")]
    for part in (folder / f"{target}.parts").glob("*"):
        try:
            if not part.name.startswith("."):
                part_of_bytes(part.read_bytes(), parts)
        except ValueError:
            found.append(part.name)
    return found


def kill(child: int, moment: float, folder: Path, after_part: bool) -> int:
    """Kill a process after a time, counted from its start or from its first temporary file; return its exit code."""
    limit = time.monotonic() + LIMIT
    waiting = after_part
    while waiting and time.monotonic() < limit:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        waiting = not any(name.endswith(".part") for name in hidden(folder))
        time.sleep(0.0002)
    time.sleep(moment)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def trials(verb: Verb, folder: Path, number: int, rng: random.Random, say: Callable[[str], None]) -> int:
    """Kill a verb so many times; return how many kills hit, raise on the first file that is neither old nor whole."""
    target = folder / verb.target
    old = (folder / verb.source).read_bytes() if verb.source else b"old, and precious\n" * 1000

    def lay(content: bytes | None) -> None:
        target.unlink(missing_ok=True)
        if content is not None:
            target.write_bytes(content)

    inputs = {path.name for path in folder.iterdir()}
    lay(old if verb.source else None)
    finish(verb, folder)  # compiles what is not compiled yet
    lay(old if verb.source else None)
    length = finish(verb, folder)
    whole = target.read_bytes()
    hits = trial = 0
    while hits < number and trial < PATIENCE * number:
        trial += 1
        before = old if verb.source or (not verb.goes_on and rng.random() < 0.5) else None
        lay(before)
        if rng.random() < 0.5:  # what a run before this one has done is there, or is not
            shutil.rmtree(folder / f"{verb.target}.parts", ignore_errors=True)
        after_part = trial % 2 == 1
        moment = rng.uniform(0.0, WRITING if after_part else length)
        code = kill(start(verb.arguments, folder), moment, folder, after_part)
        hits += code == -signal.SIGKILL
        now = target.read_bytes() if target.exists() else None
        if now not in (before, whole):
            raise AssertionError(
                f"{verb.name}: trial {trial}, killed after {moment:.4f} s, left {len(now or b'')} bytes"
            )
        if left := strange(folder, verb.target, inputs, verb.parts):
            raise AssertionError(f"{verb.name}: trial {trial} left {left}")
        if code not in (0, -signal.SIGKILL):
            raise AssertionError(f"{verb.name}: trial {trial} ended with {code}")
    lay(old if verb.source else None)
    finish(verb, folder)
    left = {path.name for path in folder.iterdir()} - inputs - {verb.target}
    if left or target.read_bytes() != whole:
        raise AssertionError(f"{verb.name}: a whole run after the kills left {left}")
    target.unlink()
    say(f"{verb.name}: {trial} trials, {hits} killed, {length:.2f} s when left alone; always absent, old or whole")
    return hits


def run(number: int, seed: int, names: list[str] | None = None, say: Callable[[str], None] = print) -> int:
    """Spread so many kills over the verbs; return how many hit before the verb had ended."""
    chosen = [verb for verb in VERBS if names is None or verb.name in names]
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        warm()
        ends = [
            round(number * total / sum(verb.share for verb in chosen))
            for total in accumulate(verb.share for verb in chosen)
        ]
        many = [stop - start for start, stop in pairwise([0, *ends])]
        return sum(trials(verb, folder, part, rng, say) for verb, part in zip(chosen, many, strict=True))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--number", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--verbs", type=lambda text: text.split(","))
    options = parser.parse_args()
    killed = run(options.number, options.seed, options.verbs, lambda line: print(line, flush=True))
    print(f"{killed} killed before they had ended, of {options.number} wanted; no file torn, none lost")
