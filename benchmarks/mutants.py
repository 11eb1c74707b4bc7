"""How many deliberate faults in the core rooms the tests notice.

    python benchmarks/mutants.py [--number 300] [--seed 1] [--rooms maps,observer,synthesis] [--workers 2]

Each mutant changes one place of one module: an operator, a comparison, a number, a condition, a call of min or max, a statement
that is left out. The tests of its room run with the compiler off, in a process of its own, those of its module first and then the
quickest, until one fails. The process is forked from one that has collected the tests, and takes the code of the functions from
the mutant; what takes effect while modules are imported is imported afresh. Before that, modules without a change go the same
ways, and must not be noticed.

Tests that take long without the compiler are left out (LONGEST), so a survivor may be one that they would notice. A test that
takes many times what it takes without a fault has noticed it, too.
"""

import argparse
import ast
import contextlib
import copy
import gc
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import platform
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import pytest

os.environ["NUMBA_DISABLE_JIT"] = "1"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "mutants.md"
ROOMS = ("maps", "observer", "synthesis")
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
}
"""Libraries that are loaded once, for all mutants; nothing of the package is."""

BROKEN = 99
"""Exit code of a process that did not come to run the tests."""
EQUIVALENT = {
    "the matrix is square": {
        ("maps/excitation.py:42", "0", "1"),
    },
    "NumPy takes any negative length for the one that it finds itself": {
        ("maps/excitation.py:87", "1", "2"),
        ("observer/balance_errors.py:116", "1", "2"),
    },
    "below the first node the interval is sought again, and found again": {
        ("maps/grid.py:97", "i > 0", "i >= 0"),
    },
    "a buffer may be longer than what is used of it": {
        ("maps/grid.py:125", "4", "5"),
        ("maps/grid.py:117", "4", "5"),
        ("maps/metrics.py:133", "4", "5"),
        ("observer/cells.py:91", "1", "2"),
        ("observer/ekf.py:136", "3", "4"),
        ("observer/recursion.py:138", "12", "13"),
        ("observer/smoothing.py:255", "5", "6"),
    },
    "the scale of the coordinates is taken back exactly": {
        ("maps/quadratic.py:174", "0.5", "1.0"),
    },
    "the matrices are square": {
        ("observer/balance_errors.py:90", "-1", "1"),
        ("observer/parts.py:267", "1", "2"),
    },
    "the first sample begins a segment, and its step is zero whatever it was": {
        ("observer/estimate.py:93", "0", "1"),
    },
    "both sequences are made from one": {
        ("observer/estimate.py:144", "True", "False"),
    },
    "a state has a column for each name": {
        ("observer/parts.py:209", "True", "False"),
    },
    "every segment has a first state": {
        ("observer/recursion.py:99", "True", "False"),
    },
    "the general way gives a cascade the same, and takes longer": {
        ("observer/recursion.py:136", "0.0", "1.0"),
    },
    "no cell yet: the first sample fetches its own values": {
        ("observer/recursion.py:143", "0.0", "1.0"),
    },
    "a column that nothing is added to, and nobody reads": {
        ("observer/rivals.py:56", "0", "1"),
    },
    "one by one gives the bits of side by side": {
        ("observer/smoothing.py:197", "k - first >= LEAST", "k - first > LEAST"),
        ("observer/smoothing.py:198", "start - side >= low", "start - side > low"),
    },
    "no units change the fastest rate; these keep rounding small": {
        ("synthesis/balance.py:48", "1.0", "2.0"),
    },
    "only the symmetric part counts, in the trace and in the inequality": {
        ("synthesis/lmi.py:66", "True", "False"),
    },
    "only the symmetric part counts in either inequality": {
        ("synthesis/lmi.py:110", "True", "False"),
    },
    "another uneven mixture": {
        ("synthesis/problem.py:69", "2", "3"),
    },
    "a corner has a value for each name": {
        ("synthesis/problem.py:80", "True", "False"),
    },
    "a region of other lengths is refused": {
        ("synthesis/region.py:113", "True", "False"),
    },
    "a corner on the cut comes twice, and none is kept twice": {
        ("synthesis/region.py:130", "sum_here * sum_there < 0", "sum_here * sum_there <= 0"),
    },
    "other lengths have been refused": {
        ("synthesis/region.py:142", "True", "False"),
    },
    "where no state is heard any weight will do": {
        ("synthesis/sensor_state.py:121", "1e-300", "2e-300"),
    },
}
"""Mutants that do what the original does, as place, before and after, by the reason."""

SWAPS: dict[type, tuple[type, ...]] = {
    ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,), ast.Pow: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,), ast.Mod: (ast.Mult,), ast.MatMult: (ast.Mult,),
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,), ast.And: (ast.Or,), ast.Or: (ast.And,), ast.BitAnd: (ast.BitOr,), ast.BitOr: (ast.BitAnd,),
}  # fmt: skip
NAMES = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "any": "all",
    "all": "any",
    "zeros": "ones",
}
NAMES |= {"floor": "ceil", "sin": "cos", "argmin": "argmax", "argmax": "argmin", "cumsum": "cumprod", "sqrt": "abs"}


@dataclass(frozen=True)
class Mutant:
    """One change: the module, where, what it says before and after, and where in the tree.

    `node` and `change` are numbers, the latter -1 for no change at all; what is in the body of a function takes effect after
    everything has been imported, too.
    """

    module: str
    line: int
    before: str
    after: str
    node: int
    change: int
    in_function: bool

    @property
    def name(self) -> str:
        """What tells it from every other mutant of the same sources."""
        return f"{self.place} {self.node} {self.change}"

    @property
    def room(self) -> str:
        return self.module.split(".")[1]

    @property
    def place(self) -> str:
        """File and line, within the package."""
        return self.module.removeprefix("lpvobs.").replace(".", "/") + f".py:{self.line}"


@dataclass(frozen=True)
class Measured:
    """The tests of a room that count and how long they take, how many there are in all, and what they import."""

    durations: dict[str, float]
    number: int
    loaded: list[str]


class _Marker(ast.NodeVisitor):
    """Collects the nodes that may be changed: code that runs, not annotations, messages or documentation."""

    def __init__(self) -> None:
        self.found: list[ast.AST] = []
        self.inside: list[bool] = []
        self.depth = 0

    def visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
            return
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        self.found.append(node)
        self.inside.append(self.depth > 0)
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "bases", "type_comment"):
                continue
            enters = isinstance(node, ast.FunctionDef) and name == "body"
            self.depth += enters
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    self.visit(child)
            self.depth -= enters


def changes(node: ast.AST) -> Iterator[tuple[str, Any]]:  # noqa: PLR0912 one line per kind
    """Yield the changes that a node admits: a field's name and its new value; "" replaces the node itself."""
    if isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp):
        for other in SWAPS.get(type(node.op), ()):
            yield "op", other()
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        for other in SWAPS.get(type(node.ops[0]), ()):
            yield "ops", [other()]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        yield "", node.operand
    if isinstance(node, ast.If | ast.IfExp | ast.While):
        yield "test", ast.UnaryOp(ast.Not(), node.test)
    if isinstance(node, ast.Constant):
        if isinstance(node.value, bool):
            yield "value", not node.value
        elif isinstance(node.value, int):
            yield "value", node.value + 1
        elif isinstance(node.value, float):
            yield "value", 2.0 * node.value if node.value else 1.0
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in NAMES:
        yield "id", NAMES[node.id]
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load) and node.attr in NAMES:
        yield "attr", NAMES[node.attr]
    if isinstance(node, ast.AugAssign) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        yield "", ast.Pass()
    if isinstance(node, ast.Continue):
        yield "", ast.Pass()


class _Replace(ast.NodeTransformer):
    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self.old, self.new = old, new

    def visit(self, node: ast.AST) -> Any:
        return self.new if node is self.old else super().generic_visit(node)


def mutants(module: str) -> list[Mutant]:
    """Return every mutant of a module."""
    found = []
    marker = _marked(_parsed(module))
    for place, node in enumerate(marker.found):
        for which, (field, value) in enumerate(changes(node)):
            after = value
            if field:
                after = copy.deepcopy(node)
                setattr(after, field, value)
            found.append(
                Mutant(
                    module, getattr(node, "lineno", 0), _short(node), _short(after), place, which, marker.inside[place]
                )
            )
    return found


def tree_of(mutant: Mutant) -> ast.Module:
    """Return the whole module with the change in it."""
    tree = _parsed(mutant.module)
    if mutant.change < 0:
        return tree
    node = _marked(tree).found[mutant.node]
    field, value = list(changes(node))[mutant.change]
    if field:
        setattr(node, field, value)
    else:
        tree = _Replace(node, ast.copy_location(value, node)).visit(tree)
    return ast.fix_missing_locations(tree)


def _parsed(module: str) -> ast.Module:
    return ast.parse((ROOT / Path(*module.split(".")).with_suffix(".py")).read_text(encoding="utf-8"))


def _marked(tree: ast.Module) -> _Marker:
    marker = _Marker()
    marker.visit(tree)
    return marker


def _short(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= 90 else text[:87] + "..."


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives out the mutant in the place of its module."""

    def __init__(self, mutant: Mutant) -> None:
        self.mutant = mutant
        self.origin = str(ROOT / Path(*mutant.module.split(".")).with_suffix(".py"))

    def find_spec(self, name: str, path: Any, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        if name != self.mutant.module:
            return None
        return importlib.util.spec_from_file_location(name, self.origin, loader=self)

    def exec_module(self, module: ModuleType) -> None:
        exec(compile(tree_of(self.mutant), self.origin, "exec"), module.__dict__)


class _Quickest:
    """A pytest plugin: leaves out what takes long, puts the tests of the module and the quickest first, and stops what hangs."""

    def __init__(self, durations: dict[str, float], mutant: Mutant) -> None:
        self.durations, self.own = durations, f"{mutant.room}/test_{mutant.module.split('.')[-1]}.py"

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        items[:] = [item for item in items if item.nodeid in self.durations]
        items.sort(key=lambda item: (self.own not in item.nodeid, self.durations[item.nodeid]))

    def pytest_runtest_call(self, item: Any) -> None:
        break_off_after(2.0 + 5.0 * self.durations[item.nodeid])

    def pytest_runtest_teardown(self) -> None:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)


class _Clock:
    """A pytest plugin: measures the computing of every test, and breaks off what takes long."""

    def __init__(self) -> None:
        self.durations: dict[str, float] = {}
        self.number, self.began = 0, 0.0

    def pytest_runtest_call(self, item: Any) -> None:
        break_off_after(1.2 * LONGEST)
        self.began = time.process_time()

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when == "call":
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
            self.number += 1
            if report.passed and time.process_time() - self.began < LONGEST:
                self.durations[report.nodeid] = time.process_time() - self.began


def break_off_after(seconds: float) -> None:
    """Let the test that begins now fail when it has computed for so long."""

    def stop(*_: Any) -> None:
        raise TimeoutError("takes too long")

    signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)


def forked(work: Callable[[], int], seconds: int) -> int:
    """Run something in a process of its own, quietly; return its exit code, negative for a signal."""
    child = os.fork()
    if not child:
        code = BROKEN
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
            null = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1):
                os.dup2(null, stream)
            code = int(work())
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def pytest_on(room: str, plugin: object, *options: str) -> int:
    """Run the tests that follow a room; return pytest's code."""
    return int(pytest.main(["-q", "-p", "no:cacheprovider", *options, f"tests/{room}"], plugins=[plugin]))


def measure(room: str) -> Measured:
    """Return how long each test takes that passes within the limit, and how many there are."""
    place = Path(tempfile.gettempdir()) / f"mutants-{os.getpid()}-{room}.json"

    def work() -> int:
        clock = _Clock()
        pytest_on(room, clock)
        loaded = [name for name in sys.modules if name.split(".")[0] in PRELOADED]
        place.write_text(json.dumps({"durations": clock.durations, "number": clock.number, "loaded": loaded}))
        return 0

    forked(work, 3600)
    found = json.loads(place.read_text())
    place.unlink()
    return Measured(found["durations"], found["number"], found["loaded"])


def put_in(mutant: Mutant) -> None:
    """Give the functions of a module that is loaded the code that they have in the mutant."""
    origin = str(ROOT / Path(*mutant.module.split(".")).with_suffix(".py"))
    waiting, codes = [compile(tree_of(mutant), origin, "exec")], {}
    while waiting:
        code = waiting.pop()
        codes[code.co_qualname, code.co_firstlineno] = code
        waiting += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
    for function in gc.get_objects():
        if isinstance(function, FunctionType) and function.__code__.co_filename == origin:
            function.__code__ = codes[function.__code__.co_qualname, function.__code__.co_firstlineno]


class _Judge:
    """A pytest plugin: in the place of running the tests once, runs them for every mutant, in a process of its own each."""

    def __init__(self, measured: Measured, todo: Sequence[tuple[int, Mutant]], say: Callable[[int, bool, float], None]):
        self.measured, self.todo, self.say = measured, todo, say

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        limit = int(60 + 5 * sum(self.measured.durations.values()))
        for place, mutant in self.todo:
            began = time.monotonic()
            self.say(place, noticed(forked(partial(self._tried, session, mutant), limit)), time.monotonic() - began)
        return True

    def _tried(self, session: pytest.Session, mutant: Mutant) -> int:
        put_in(mutant)
        order = _Quickest(self.measured.durations, mutant)
        session.config.pluginmanager.register(order)
        items = list(session.items)
        order.pytest_collection_modifyitems(items)
        for item, following in zip(items, [*items[1:], None], strict=True):
            session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if session.testsfailed:
                return 1
        return 0


def judge(mutant: Mutant, measured: Measured) -> bool:
    """Return whether a test notices a mutant that takes effect while modules are imported."""

    def work() -> int:
        sys.meta_path.insert(0, _Finder(mutant))
        return pytest_on(mutant.room, _Quickest(measured.durations, mutant), "-x")

    return noticed(forked(work, int(60 + 5 * sum(measured.durations.values()))))


def noticed(code: int) -> bool:
    """Return whether a run says that a test failed, nothing could be imported, or the time was up, rather than all is well."""
    if code in (
        BROKEN,
        pytest.ExitCode.INTERNAL_ERROR,
        pytest.ExitCode.USAGE_ERROR,
        pytest.ExitCode.NO_TESTS_COLLECTED,
    ):
        raise RuntimeError(f"the tests did not run, code {code}")
    return code != 0


def judged(chosen: Sequence[Mutant], measured: dict[str, Measured], workers: int) -> Iterator[tuple[int, bool, float]]:
    """Yield number, verdict and seconds of every mutant, as they come from so many processes side by side."""
    reading, writing = os.pipe()

    def say(place: int, found: bool, seconds: float) -> None:
        os.write(writing, f"{place} {int(found)} {seconds}\n".encode())

    def work(worker: int) -> int:
        mine = [(place, chosen[place]) for place in range(worker, len(chosen), workers)]
        for room, tests in measured.items():
            todo = [(place, mutant) for place, mutant in mine if mutant.room == room and mutant.in_function]
            if todo:
                forked(partial(pytest_on, room, _Judge(tests, todo, say), "-s"), 36_000)
        for place, mutant in mine:
            if not mutant.in_function:
                began = time.monotonic()
                say(place, judge(mutant, measured[mutant.room]), time.monotonic() - began)
        return 0

    children = []
    for worker in range(workers):
        child = os.fork()
        if not child:
            os.close(reading)
            os._exit(work(worker))
        children.append(child)
    os.close(writing)
    with os.fdopen(reading, encoding="ascii") as lines:
        for line in lines:
            place, verdict, seconds = line.split()
            yield int(place), verdict == "1", float(seconds)
    for child in children:
        os.waitpid(child, 0)


def modules(room: str) -> list[str]:
    """Return the modules of a room."""
    found = sorted((ROOT / "lpvobs" / room).glob("*.py"))
    return [f"lpvobs.{room}.{path.stem}" for path in found if path.stem != "__init__"]


def written(number: int, seed: int, verdicts: Sequence[tuple[Mutant, bool]], measured: dict[str, Measured]) -> str:
    """Return the page of results."""
    lines = [
        "# Deliberate faults, and whether the tests notice",
        "",
        f"`benchmarks/mutants.py --number {number} --seed {seed}`, {date.today().isoformat()}, {platform.machine()} with "
        f"{os.cpu_count()} processors, compiler off: {len(verdicts)} of {number} judged. Of the tests of each room those count "
        f"that take less than {LONGEST:g} s of computing without the compiler.",
        "",
        "| room | mutants | noticed | score | tests used | left out |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for room, tests in measured.items():
        of = [found for mutant, found in verdicts if room == mutant.room]
        lines.append(_row(room, of, str(len(tests.durations)), str(tests.number - len(tests.durations))))
    lines.append(_row("all", [found for _, found in verdicts], "", ""))
    survivors = sorted((mutant for mutant, found in verdicts if not found), key=lambda item: (item.module, item.line))
    same = [mutant for mutant in survivors if reason(mutant)]
    lines.append(
        _row(
            "all, without those that change nothing",
            [found for mutant, found in verdicts if mutant not in same],
            "",
            "",
        )
    )
    lines += ["", "## Survivors", "", "| place | before | after | why no test can tell |", "|---|---|---|---|"]
    for mutant in survivors:
        before, after = (text.replace("|", "\\|") for text in (mutant.before, mutant.after))
        lines.append(f"| {mutant.place} | `{before}` | `{after}` | {reason(mutant)} |")
    return "\n".join(lines) + "\n"


def _row(name: str, found: Sequence[bool], *more: str) -> str:
    cells = (name, str(len(found)), str(sum(found)), f"{100 * sum(found) / max(len(found), 1):.1f} %", *more)
    return "| " + " | ".join(cells) + " |"


def reason(mutant: Mutant) -> str:
    """Return why a mutant does what the original does, or nothing."""
    change = (mutant.place, mutant.before, mutant.after)
    return next((why for why, same in EQUIVALENT.items() if change in same), "")


def main() -> None:
    """Judge a sample of mutants, in no order, and write the page as it grows."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rooms", type=lambda text: text.split(","), default=list(ROOMS))
    parser.add_argument("--modules", type=lambda text: text.split(","), help="only these, such as lpvobs.maps.grid")
    parser.add_argument("--times", type=Path, help="keep the durations of the tests here, and use what is kept")
    parser.add_argument(
        "--out", type=Path, help="the page, by default benchmarks/results/mutants.md for a whole sample"
    )
    parser.add_argument("--verdicts", type=Path, help="keep the verdicts here, line by line, and go on where they end")
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    kept = json.loads(options.times.read_text()) if options.times and options.times.exists() else {}
    measured = {room: Measured(**kept[room]) if room in kept else measure(room) for room in options.rooms}
    if options.times:
        options.times.write_text(json.dumps(kept | {room: asdict(item) for room, item in measured.items()}))
    preload(measured.values())
    wanted = options.modules or [name for room in options.rooms for name in modules(room)]
    everything = [mutant for name in wanted for mutant in mutants(name)]
    chosen = random.Random(options.seed).sample(everything, min(options.number, len(everything)))
    whole = options.modules is None and options.rooms == list(ROOMS)
    page = options.out or (RESULTS if whole else None)
    known = verdicts_in(options.verdicts)
    verdicts = [(mutant, known[mutant.name]) for mutant in chosen if mutant.name in known]
    controls = [
        Mutant(modules(room)[0], 1, "as it is", "as it is", 0, -1, warm) for room in measured for warm in (True, False)
    ]
    waiting = controls + [mutant for mutant in chosen if mutant.name not in known]
    for place, found, seconds in judged(waiting, evened_out(measured, verdicts), options.workers):
        mutant = waiting[place]
        if mutant.change < 0:
            if found:
                raise SystemExit(f"{mutant.module}: the tests fail without any change")
            continue
        verdicts.append((mutant, found))
        verdict = f"{'noticed ' if found else 'SURVIVED'} {seconds:5.1f} s"
        print(f"{len(verdicts)} {verdict} {mutant.place}: {mutant.before} -> {mutant.after}", flush=True)
        if options.verdicts:
            with options.verdicts.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps([mutant.name, found]) + "\n")
        if page:
            page.write_text(written(options.number, options.seed, verdicts, measured), encoding="utf-8")
    if page:
        page.write_text(written(options.number, options.seed, verdicts, measured), encoding="utf-8")
    if len(verdicts) != len(chosen):
        raise SystemExit(f"{len(chosen) - len(verdicts)} mutants were not judged, see above")


def verdicts_in(path: Path | None) -> dict[str, bool]:
    """Return the verdicts that an earlier run has kept, by the name of the mutant."""
    if path is None or not path.exists():
        return {}
    return dict(json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())


def evened_out(measured: dict[str, Measured], verdicts: Sequence[tuple[Mutant, bool]]) -> dict[str, Measured]:
    """Return the rooms with those first of which least has been judged."""
    done = Counter(mutant.room for mutant, _ in verdicts)
    return dict(sorted(measured.items(), key=lambda item: done[item[0]]))


def preload(measured: Iterable[Measured]) -> None:
    """Load the libraries that the tests load, so that no mutant pays for it."""
    for name in sorted({name for item in measured for name in item.loaded}):
        with contextlib.suppress(Exception):  # what is loaded under another name, or in parts
            importlib.import_module(name)


if __name__ == "__main__":
    main()
