"""Processes of their own for libraries that a stranger's file may crash, keep busy for ever or fill the memory with."""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

PATIENCE = 15  # times as long as it may compute; on a busy machine a process may stand still
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMEXPR_MAX_THREADS")
"""Each thread would take addresses from the limit."""


def answer(module: str, path: Path, seconds: int, most_bytes: int, asked: str = "") -> bytes:
    """Return what a module writes to stdout about a file, nothing if it dies or comes to no end.

    It runs as `python -m MODULE FILE SECONDS BYTES` with the question on stdin, and begins with `limited`. This package is found
    wherever it lies, but the working folder, where strangers' files lie, is no place of modules.
    """
    paths = [str(Path(__file__).parents[3]), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    own = {**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONPATH": os.pathsep.join(paths)}
    line = [sys.executable, "-P", "-m", module, str(path.absolute()), str(seconds), str(most_bytes)]
    with tempfile.TemporaryDirectory() as folder:  # of the library's copies, which a killed process leaves behind
        try:
            done = subprocess.run(
                line,
                env=own | {"TMPDIR": folder},
                input=asked.encode(),
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                timeout=PATIENCE * seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return b""
    return b"" if done.returncode else done.stdout


def limited() -> Path:
    """Let this process compute for so long, and take so many bytes of addresses, as it was told; return the file to read."""
    path, seconds, most_bytes = sys.argv[1:]
    _lower(resource.RLIMIT_CPU, int(seconds), 1)
    _lower(resource.RLIMIT_AS, int(most_bytes))
    _lower(resource.RLIMIT_CORE, 0)
    return Path(path)


def _lower(kind: int, value: int, grace: int = 0) -> None:
    """Set a limit, or leave the lower one that is there."""
    _, hard = resource.getrlimit(kind)
    most = value + grace if hard == resource.RLIM_INFINITY else min(hard, value + grace)
    resource.setrlimit(kind, (min(value, most), most))
