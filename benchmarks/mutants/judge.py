"""Whether the tests of a room notice a mutant: each in a process of its own, forked from one that has the libraries loaded."""

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

os.environ["NUMBA_DISABLE_JIT"] = "1"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # otherwise it compiles all of Hypothesis again for every mutant

import pytest
from change import Mutant, source

LONGEST = 1.0
"""[s] of computing; a test that takes longer without the compiler is left out."""
PRELOADED = {
    "cvxpy",
    "clarabel",
    "numba",
    "numpy",
    "scipy",
    "h5py",
    "pyarrow",
    "pandas",
    "msgspec",
    "pint",
    "hypothesis",
}
"""Libraries that are loaded once, for all mutants; nothing of the package is."""
BROKEN = 99
"""Exit code of a process that did not come to run the tests."""


@dataclass(frozen=True)
class Measured:
    """The tests of a room that count and how long they take, how many there are in all, and what they import."""

    durations: dict[str, float]
    number: int
    loaded: list[str]


class _Clock:
    """A pytest plugin: measures the computing of every test, and breaks off what takes long."""

    def __init__(self) -> None:
        self.durations: dict[str, float] = {}
        self.number, self.began = 0, 0.0

    def pytest_runtest_call(self, item: Any) -> None:
        _break_off_after(1.2 * LONGEST)
        self.began = time.process_time()

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when == "call":
            _break_off_after(0.0)
            self.number += 1
            if report.passed and time.process_time() - self.began < LONGEST:
                self.durations[report.nodeid] = time.process_time() - self.began


class _Quickest:
    """A pytest plugin: leaves out what takes long, puts the tests of the module and the quickest first, and stops what hangs."""

    def __init__(self, durations: dict[str, float], mutant: Mutant) -> None:
        self.durations, self.own = durations, f"/test_{mutant.module.split('.')[-1]}.py"

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        items[:] = [item for item in items if item.nodeid in self.durations]
        items.sort(key=lambda item: (self.own not in item.nodeid, self.durations[item.nodeid]))

    def pytest_runtest_call(self, item: Any) -> None:
        _break_off_after(2.0 + 5.0 * self.durations[item.nodeid])

    def pytest_runtest_teardown(self) -> None:
        _break_off_after(0.0)


def _break_off_after(seconds: float) -> None:
    """Let the test that begins now fail when it has computed for so long; 0 for never."""

    def stop(*_: Any) -> None:
        raise TimeoutError("takes too long")

    signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives out the mutant in the place of its module."""

    def __init__(self, mutant: Mutant) -> None:
        self.mutant = mutant

    def find_spec(self, name: str, path: Any, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        if name != self.mutant.module:
            return None
        return importlib.util.spec_from_file_location(name, source(name), loader=self)

    def exec_module(self, module: Any) -> None:
        exec(compile(self.mutant.tree(), module.__file__, "exec"), module.__dict__)


def measure(room: str) -> Measured:
    """Return how long each test of a room takes that passes within the limit; for a process of its own."""
    _hush()
    clock = _Clock()
    _pytest(room, clock)
    loaded = [name for name in sys.modules if name.split(".")[0] in PRELOADED]
    return Measured(clock.durations, clock.number, loaded)


def preload(measured: Iterable[Measured]) -> None:
    """Load the libraries that the tests load, so that no mutant pays for it."""
    for name in sorted({name for item in measured for name in item.loaded}):
        with suppress(Exception):  # what is loaded under another name, or in parts
            importlib.import_module(name)


def judge(mutant: Mutant, measured: Measured) -> bool:
    """Return whether a test notices a mutant, rather than all is well."""

    def work() -> int:
        sys.meta_path.insert(0, _Finder(mutant))
        return _pytest(mutant.room, _Quickest(measured.durations, mutant), "-x")

    code = _forked(work, int(60 + 5 * sum(measured.durations.values())))
    unwell = (BROKEN, pytest.ExitCode.INTERNAL_ERROR, pytest.ExitCode.USAGE_ERROR, pytest.ExitCode.NO_TESTS_COLLECTED)
    if code in unwell:
        raise RuntimeError(f"{mutant.place}: the tests did not run, code {code}")
    return code != 0


def _pytest(room: str, plugin: object, *options: str) -> int:
    """Run the tests of a room; return pytest's code.

    Compiled code says nothing of a division by zero, so nothing is said of it without the compiler.
    """
    quiet = ("-p", "no:cacheprovider", "-W", "ignore::RuntimeWarning")
    return int(pytest.main([*quiet, *options, f"tests/{room}"], plugins=[plugin]))


def _forked(work: Callable[[], int], seconds: int) -> int:
    """Run something in a process of its own; return its exit code, negative for a signal."""
    child = os.fork()
    if not child:
        code = BROKEN
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
            _hush()
            code = work()
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _hush() -> None:
    """Let this process say nothing on stdout."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
