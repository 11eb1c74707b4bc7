"""Damaged and hostile inputs for every reader: no traceback, no hang over ten seconds, no memory above 2 GB.

    PYTHONPATH=.:tests python -m robust.fuzz [--number 100000] [--seed 1] [--kinds parquet,toml,...]
    PYTHONPATH=.:tests python -m robust.fuzz --command-line 2000 [--in-shell 200]

Inputs are mutations of good files, each from a seed of its own, so that a number names an input for ever. A worker process
reads them one after the other; if it dies or says nothing for ten seconds, the input it was at is the finding, and another
worker goes on behind it. Command lines run in forked processes that have everything imported, the first ones in real shells.
"""

import argparse
import multiprocessing
import os
import random
import resource
import signal
import tempfile
import time
import tomllib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from repository import DIESEL
from robust import foreign, mutate
from robust.defects import UNITS, moving
from robust.kill import CONFIGURED, prepare, start, warm
from robust.samples import Samples, make

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.errors import LpvobsError
from lpvobs.io.safety.seal import LENGTH

SECONDS, BYTES = 10.0, 2 * 2**30
"""For one input; memory is what is resident: libraries reserve more than that without using it."""
RESERVED = 12 * 2**30
"""[bytes] of addresses, so that what asks for terabytes fails at once."""
SHARES = {
    "parquet bytes": 0.3,
    "parquet content": 0.21,
    "toml": 0.21,
    "hdf5 bytes": 0.07,
    "hdf5 content": 0.05,
    "hdf5 bare": 0.0005,
    "csv": 0.1565,
    "mat": 0.002,
    "mat hdf5": 0.0005,
    "mdf": 0.0005,
}
"""Of the inputs. A bare HDF5 file, without its seal, costs a process of its own, and MAT and MDF two to four."""
FOREIGN = ("csv", "mat", "mat hdf5", "mdf")


@dataclass(frozen=True)
class Finding:
    """An input that did what no input may do."""

    kind: str
    number: int
    what: str


class Corpus:
    """Good files in memory, and the inputs made from them."""

    def __init__(self, samples: Samples, folder: Path):
        self.folder = folder
        columns = {name: column[:400] for name, column in moving().items()} | {
            "ref_W_c": np.ones(400),
            "fan": np.zeros(400),
        }
        units = UNITS | {"ref_W_c": "kg/s", "fan": "1"}
        fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in columns]
        self.table = pa.table([pa.array(column) for column in columns.values()], schema=pa.schema(fields))
        self.logs = []
        for compression in ("none", "snappy", "zstd"):
            path = folder / "seed.parquet"
            pq.write_table(self.table, path, compression=compression, row_group_size=150)
            self.logs.append(path.read_bytes())
        self.config = DIESEL.read_text(encoding="utf-8")
        self.effects = "".join(path.read_text() for path in sorted(DIESEL.parent.glob("surfaces/*.toml"))[:1])
        self.hdf = {"gain": samples.gain.read_bytes(), "result": samples.result.read_bytes()}
        self.seeds: dict[str, list[foreign.Seed]] = {}

    def write(self, kind: str, number: int) -> Path:
        """Write an input; return its path."""
        rng = random.Random(f"{kind} {number}")
        if kind in FOREIGN:
            return self._write_foreign(kind, rng)
        suffix, content = self._content(kind, rng)
        path = self.folder / f"input{suffix}"
        path.write_bytes(content)
        return path

    def _write_foreign(self, kind: str, rng: random.Random) -> Path:
        """Write a foreign recording, and `foreign.toml` beside it, which ingests the one that it was made from."""
        makers = {
            "csv": foreign.csv_seeds,
            "mat": foreign.mat_seeds,
            "mat hdf5": foreign.hdf_seeds,
            "mdf": foreign.mdf_seeds,
        }
        if kind not in self.seeds:
            self.seeds[kind] = makers[kind]()
        seed = rng.choice(self.seeds[kind])
        change = {"csv": foreign.mutate_csv, "mat": foreign.mutate_mat, "mdf": foreign.mutate_mdf}
        if kind in change:
            content = change[kind](seed.content, rng)
        elif rng.random() < 0.5:
            content = mutate.mutate_bytes(seed.content, rng)
        else:
            content = mutate.mutate_hdf(seed.content, rng, seed.content[:128])
        (self.folder / "foreign.toml").write_bytes(foreign.mutate_profile(seed.profile, rng))
        path = self.folder / f"input{seed.suffix}"
        path.write_bytes(content)
        return path

    def _content(self, kind: str, rng: random.Random) -> tuple[str, bytes]:
        if kind == "parquet bytes":
            return ".parquet", mutate.mutate_bytes(rng.choice(self.logs), rng)
        if kind == "parquet content":
            return ".parquet", mutate.mutate_table(self.table, rng)
        if kind == "toml":
            text, suffix = (self.config, ".toml") if rng.random() < 0.8 else (self.effects, ".effects")
            return suffix, mutate.mutate_toml(text, rng)
        which = rng.choice(list(self.hdf))
        content = self.hdf[which]
        if kind == "hdf5 bytes":
            return f".{which}", mutate.mutate_bytes(content, rng, same_length=True)
        if kind == "hdf5 bare":
            return f".{which}", mutate.mutate_bytes(content[:-LENGTH], rng)
        return f".{which}", mutate.mutate_hdf(content, rng)


def read(path: Path) -> None:
    """Read an input as the verbs do; raises only what they turn into one line."""
    from lpvobs.api.inspect import inspect_log
    from lpvobs.api.verify import check_again
    from lpvobs.io.configuration.config import load_config, load_effects
    from lpvobs.io.logs.policies import LogPolicies
    from lpvobs.io.logs.reading import read_log, read_references
    from lpvobs.io.results.gains import read_gain
    from lpvobs.report.content import load, report_output

    if path.suffix in (".csv", ".mat", ".mdf", ".mf4"):
        read_foreign(path)
    elif path.suffix == ".parquet":
        policies = LogPolicies(backward_time="drop")
        inspect_log(path, Diesel.channels, policies)
        read_references(path, read_log(path, Diesel.channels, policies).rows)
    elif path.suffix == ".toml":
        load_config(path)
    elif path.suffix == ".effects":
        load_effects(path)
    elif path.suffix == ".gain":
        check_again(read_gain(path))
    else:
        report_output(load([path]))


def read_foreign(path: Path) -> None:
    """Draft a profile for a recording, and make a log of it by the one beside it, as `profile` and `ingest` do."""
    from lpvobs.api.ingest_log import ingest_log
    from lpvobs.ingest.drafting import draft_profile

    with suppress(LpvobsError):
        tomllib.loads(draft_profile(path).encode("utf-8").decode("utf-8"))
    ingest_log([path], str(path.with_name("foreign.toml")), path.with_name("made.parquet"))


def show(kind: str, number: int) -> str:
    """Return how an input is taken: "read", or the line that refuses it; what escapes is raised again."""
    with tempfile.TemporaryDirectory() as name:
        path = Corpus(make(Path(name)), Path(name)).write(kind, number)
        try:
            read(path)
        except LpvobsError as error:
            return str(error)
    return "read"


def worker(folder: Path, samples: Samples, kind: str, numbers: range, pipe: Connection) -> None:
    """Read inputs one after the other; send each number before, and what escaped after it."""
    resource.setrlimit(resource.RLIMIT_AS, (RESERVED, RESERVED))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    corpus = Corpus(samples, folder)
    for number in numbers:
        pipe.send((number, ""))
        path = corpus.write(kind, number)
        try:
            with np.errstate(all="ignore"):
                read(path)
        except LpvobsError as error:
            if len(str(error).encode("utf-8", errors="replace")) > 4000:
                pipe.send((number, f"a message of {len(str(error))} characters"))
        except BaseException as error:
            pipe.send((number, f"{type(error).__name__}: {error}"))
        if 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss > BYTES:
            pipe.send((number, "more than 2 GB of memory"))
            return
    pipe.send((-1, ""))


def answers(receiver: Connection, process: int) -> bool:
    """Return whether a worker says something before it has computed for ten seconds, or stood still for two minutes."""
    began, before = time.monotonic(), computed(process)
    while not receiver.poll(0.5):
        if computed(process) - before > SECONDS or time.monotonic() - began > 12.0 * SECONDS:
            return False
    return True


def computed(process: int) -> float:
    """Return the time that a process has computed, [s]."""
    try:
        words = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError:
        return 0.0
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def fuzz_kind(samples: Samples, kind: str, numbers: range, say: Callable[[str], None]) -> list[Finding]:
    """Return what was found among the inputs of one kind."""
    context = multiprocessing.get_context("fork")
    findings: list[Finding] = []
    began, at = time.monotonic(), numbers.start
    with tempfile.TemporaryDirectory() as name:
        while at < numbers.stop:
            receiver, sender = context.Pipe(duplex=False)
            process = context.Process(target=worker, args=(Path(name), samples, kind, range(at, numbers.stop), sender))
            process.start()
            sender.close()
            try:
                while answers(receiver, process.pid or 0):
                    number, what = receiver.recv()
                    if number < 0:
                        at = numbers.stop
                        break
                    at = number
                    if what:
                        findings.append(Finding(kind, number, what))
                else:
                    findings.append(Finding(kind, at, f"nothing for {SECONDS:.0f} s of computing"))
                    at += 1
            except EOFError:
                process.join()
                if process.exitcode:
                    findings.append(Finding(kind, at, f"the process died with {process.exitcode}"))
                at += 1
            process.kill()
            process.join()
    say(f"{kind}: {len(numbers)} inputs, {time.monotonic() - began:.0f} s, {len(findings)} findings")
    return findings


def fuzz(number: int, seed: int, kinds: list[str] | None = None, say: Callable[[str], None] = print) -> list[Finding]:
    """Return what was found among so many inputs, shared out over the kinds."""
    findings: list[Finding] = []
    with tempfile.TemporaryDirectory() as name:
        samples = make(Path(name))
        for kind, share in SHARES.items():
            if kinds is None or kind in kinds:
                start = seed * 10_000_000
                many = max(1, round(share * number))
                findings += fuzz_kind(samples, kind, range(start, start + many), say)
    return findings


COMMANDS = {
    "parquet bytes": (("inspect", "{input}", "--json"), ("estimate", *CONFIGURED, "--gain", "gain.h5", "{input}", "--out", "o.h5")),
    "parquet content": (
        ("estimate", *CONFIGURED, "--gain", "gain.h5", "{input}", "--out", "o.h5"),
        ("inspect", "{input}"),
        ("synth-gain", *CONFIGURED, "{input}", "--out", "o.h5"),
        ("report", "result.h5", "{input}"),
        ("trace", "result.h5", "{input}"),
    ),
    "toml": (
        ("estimate", "--config", "{input}", "--gain", "gain.h5", "log.parquet", "--out", "o.h5"),
        ("estimate", "--config", "{input}", "--gain", "gain.h5", "log.parquet", "--out", "o.h5", "--method", "published"),
        ("synth-gain", "--config", "{input}", "--published", "ETC", "--out", "o.h5"),
        ("simulate", "--config", "{input}", "--cycle", "cycle.csv", "--rate", "20", "--out", "o.parquet"),
        ("inspect", "log.parquet", "--config", "{input}"),
    ),
    "hdf5 bytes": (("verify", "{input}"), ("report", "{input}"), ("extrapolate", "{input}")),
    "hdf5 bare": (("verify", "{input}"), ("report", "{input}", "--html", "o.html"), ("trace", "{input}", "log.parquet")),
    "hdf5 content": (
        ("verify", "{input}"),
        ("report", "{input}", "--html", "o.html"),
        ("extrapolate", "{input}"),
        ("export", "{input}", "--format", "csv", "--out", "o.csv"),
        ("trace", "{input}", "log.parquet"),
        ("estimate", *CONFIGURED, "--gain", "{input}", "log.parquet", "--out", "o.h5"),
    ),
    **dict.fromkeys(
        FOREIGN,
        (("ingest", "{input}", "--profile", "foreign.toml", "--out", "o.parquet"), ("profile", "{input}", "--out", "o.toml")),
    ),
}  # fmt: skip
LEFT = {"o.toml", "o.h5", "o.parquet", "o.html", "o.csv", "err.txt"}


def command(line: tuple[str, ...], folder: Path, *, in_shell: bool = False) -> str:
    """Run a command line in a process of its own; return what was wrong with it, or nothing."""
    child = start(line, folder, folder / "err.txt", in_shell=in_shell)
    began = time.monotonic()
    while True:
        ended, status, usage = os.wait4(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() - began > 10.0 * SECONDS:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.002)
    code = os.waitstatus_to_exitcode(status)
    said = (folder / "err.txt").read_text(encoding="utf-8", errors="replace")
    if usage.ru_utime + usage.ru_stime > SECONDS:
        return f"{usage.ru_utime + usage.ru_stime:.0f} s of computing"
    if 1024 * usage.ru_maxrss > BYTES:
        return "more than 2 GB of memory"
    if code not in (0, 1, 2, 3):
        return f"exit code {code}: {said[-300:]}"
    if "Traceback" in said or (code and len(said.splitlines()) > 12) or (code and not said.strip()):
        return f"exit code {code} and on stderr: {said[-300:]}"
    left = {path.name for path in folder.iterdir() if path.name.startswith(".")}
    return f"left {left}" if left else ""


def fuzz_commands(number: int, seed: int, in_shell: int, say: Callable[[str], None] = print) -> list[Finding]:
    """Return what was found among so many command lines, the first `in_shell` of them in real shells."""
    findings: list[Finding] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        corpus = Corpus(make_elsewhere(), folder)
        corpus.hdf = {kind: (folder / f"{kind}.h5").read_bytes() for kind in ("gain", "result")}
        warm()
        kinds = random.Random(seed).choices(list(COMMANDS), (30, 40, 50, 10, 10, 40, 12, 12, 2, 2), k=number)
        for place, kind in enumerate(kinds):
            at = seed * 10_000_000 + place
            path = corpus.write(kind, at)
            line = tuple(word.format(input=path.name) for word in random.Random(f"{kind} {at}").choice(COMMANDS[kind]))
            if what := command(line, folder, in_shell=place < in_shell):
                findings.append(Finding(f"{kind}: {' '.join(line)}", at, what))
            for leftover in LEFT:
                (folder / leftover).unlink(missing_ok=True)
            if place % 100 == 99:
                say(
                    f"{place + 1} command lines, {min(place + 1, in_shell)} of them in shells, {len(findings)} findings"
                )
    return findings


def make_elsewhere() -> Samples:
    """Return good files without running anything in this process, whose threads would not survive a fork."""
    folder = Path(tempfile.mkdtemp())
    context = multiprocessing.get_context("fork")
    with context.Pool(1) as pool:
        return pool.apply(make, (folder,))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--number", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", type=lambda text: text.split(","))
    parser.add_argument("--command-line", type=int, metavar="NUMBER", help="command lines instead, so many")
    parser.add_argument("--in-shell", type=int, default=200, metavar="NUMBER", help="of the command lines")
    options = parser.parse_args()

    def tell(line: str) -> None:
        print(line, flush=True)

    if options.command_line:
        found = fuzz_commands(options.command_line, options.seed, options.in_shell, tell)
    else:
        found = fuzz(options.number, options.seed, options.kinds, tell)
    for item in found[:50]:
        print(f"{item.kind} {item.number}: {item.what}")
    print(f"{options.command_line or options.number} inputs, {len(found)} findings")
    os._exit(1 if found else 0)
