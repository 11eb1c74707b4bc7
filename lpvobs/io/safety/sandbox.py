"""Processes of their own for libraries that a stranger's file may crash, keep busy for ever or fill the memory with."""

import os
import resource
import sys
from collections.abc import Mapping
from pathlib import Path

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMEXPR_MAX_THREADS")
"""Each thread would take addresses from the limit."""


def call(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module; the working folder, where strangers' files lie, is no place of modules."""
    return [sys.executable, "-P", "-m", module, *arguments]


def environment(**more: str) -> Mapping[str, str]:
    """Return the environment of such a process: this package is found wherever it lies, and every library has one thread."""
    paths = [str(Path(__file__).parents[3]), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    return {**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONPATH": os.pathsep.join(paths), **more}


def limit(seconds: int, most_bytes: int) -> None:
    """Let this process compute for so long, and take so many bytes of addresses, at most."""
    _lower(resource.RLIMIT_CPU, seconds, 1)
    _lower(resource.RLIMIT_AS, most_bytes)
    _lower(resource.RLIMIT_CORE, 0)


def _lower(kind: int, value: int, grace: int = 0) -> None:
    """Set a limit, or leave the lower one that is there."""
    _, hard = resource.getrlimit(kind)
    most = value + grace if hard == resource.RLIM_INFINITY else min(hard, value + grace)
    resource.setrlimit(kind, (min(value, most), most))
