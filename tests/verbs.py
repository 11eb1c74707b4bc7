"""Runs the command line as its users do, in a process of its own, but in one that has the libraries loaded already.

Loading them takes longer than most verbs do. Python's fork server loads them once and forks for every call: nothing that one call
does reaches the next. Tests about starting, loading, streams or signals start Python afresh instead.
"""

import json
import os
import sys
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

from repository import ROOT

PATIENCE = 300.0
"""[s]; no call of the tests takes a tenth of it."""
LIBRARIES = (
    "numba", "h5py", "pyarrow.parquet", "cvxpy", "clarabel", "jinja2", "matplotlib.backends.backend_svg", "scipy.signal",
    "scipy.stats",
)  # fmt: skip
"""What the package imports late."""
PACKAGE = tuple(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in sorted((ROOT / "lpvobs").rglob("*.py"))
)
AFRESH = (sys.executable, "-c", "from lpvobs.cli.start import run; run()")
"""A call of the command line that loads everything itself."""


@dataclass(frozen=True)
class Done:
    """What a call left: exit code, stdout, stderr."""

    code: int
    out: str
    err: str

    @property
    def json(self):
        return json.loads(self.out)


def lpvobs(*arguments, cwd=None) -> Done:
    """Run a command line to its end."""
    context = get_context("forkserver")
    context.set_forkserver_preload([*LIBRARIES, *PACKAGE, "tests.warm"])
    with TemporaryDirectory() as name:
        streams = [Path(name) / stream for stream in ("out", "err")]
        process = context.Process(target=_called, args=([str(one) for one in arguments], cwd, *map(str, streams)))
        process.start()
        process.join(PATIENCE)
        if process.is_alive():
            process.kill()
            process.join()
        out, err = (stream.read_text(encoding="utf-8", errors="replace") for stream in streams)
    assert process.exitcode is not None
    return Done(process.exitcode, out, err)


def _called(arguments: list[str], cwd: str | None, out: str, err: str) -> None:
    """Be the command line: take its streams, folder and arguments."""
    os.chdir(cwd or ".")
    for stream, (where, how) in enumerate(
        ((os.devnull, os.O_RDONLY), (out, os.O_WRONLY | os.O_CREAT), (err, os.O_WRONLY | os.O_CREAT))
    ):
        handle = os.open(where, how)
        os.dup2(handle, stream)
        os.close(handle)
    sys.argv = ["lpvobs", *arguments]
    from lpvobs.cli.main import run

    run()
