"""How many deliberate faults in the core rooms the tests notice.

    python benchmarks/mutants.py [--number 300] [--seed 1] [--rooms maps,observer,synthesis]

Each mutant changes one place of one module: an operator, a comparison, a number, a condition, a call of min or max, a statement
that is left out. The tests of its room run with the compiler off, in a process of its own, the quickest first, until one fails.
Tests that take long without the compiler are left out (LONGEST), so a survivor may be one that they would notice.
"""

import argparse
import ast
import copy
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

os.environ["NUMBA_DISABLE_JIT"] = "1"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "mutants.md"
ROOMS = ("maps", "observer", "synthesis")
LONGEST = 1.0
"""[s] of computing; a test that takes longer without the compiler is left out."""

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
    """One change: the module, where, and what it says before and after."""

    module: str
    line: int
    before: str
    after: str
    tree: ast.Module


class _Marker(ast.NodeVisitor):
    """Collects the nodes that may be changed: code that runs, not annotations, messages or documentation."""

    def __init__(self) -> None:
        self.found: list[ast.AST] = []

    def visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
            return
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        self.found.append(node)
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "bases", "type_comment"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    self.visit(child)


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
    path = ROOT / Path(*module.split(".")).with_suffix(".py")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    marker = _Marker()
    marker.visit(tree)
    found = []
    for place, node in enumerate(marker.found):
        for field, value in changes(node):
            changed = copy.deepcopy(tree)
            again = _Marker()
            again.visit(changed)
            target = again.found[place]
            if field:
                setattr(target, field, value)
                after = target
            else:
                after = ast.copy_location(copy.deepcopy(value), target)
                changed = _Replace(target, after).visit(changed)
            line = getattr(node, "lineno", 0)
            ast.fix_missing_locations(changed)
            found.append(Mutant(module, line, _short(node), _short(after), changed))
    return found


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
        exec(compile(self.mutant.tree, self.origin, "exec"), module.__dict__)


class _Quickest:
    """A pytest plugin: leaves out what takes long, and puts the tests of the module and the quickest first."""

    def __init__(self, durations: dict[str, float], own: str) -> None:
        self.durations, self.own = durations, own

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        items[:] = [item for item in items if self.durations.get(item.nodeid, LONGEST) < LONGEST]
        items.sort(key=lambda item: (self.own not in item.nodeid, self.durations[item.nodeid]))


class _Clock:
    """A pytest plugin: measures the computing of every test, and breaks off what takes long."""

    def __init__(self) -> None:
        self.durations: dict[str, float] = {}
        self.began = 0.0

    def pytest_runtest_call(self, item: Any) -> None:
        def stop(*_: Any) -> None:
            raise TimeoutError("takes long without the compiler")

        signal.signal(signal.SIGVTALRM, stop)
        signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
        self.began = time.process_time()

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.when == "call":
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
            if report.passed:
                self.durations[report.nodeid] = time.process_time() - self.began


def forked(work: Any, seconds: int) -> int:
    """Run something in a process of its own, quietly; return its exit code, negative for a signal."""
    child = os.fork()
    if not child:
        code = 99
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


def measure(room: str) -> dict[str, float]:
    """Return how long each test of a room takes that passes within the limit."""
    place = Path(tempfile.gettempdir()) / f"mutants-{os.getpid()}-{room}.json"

    def work() -> int:
        clock = _Clock()
        pytest.main(["-q", "-p", "no:cacheprovider", str(ROOT / "tests" / room)], plugins=[clock])
        place.write_text(json.dumps(clock.durations))
        return 0

    forked(work, 1200)
    found = json.loads(place.read_text())
    place.unlink()
    return dict(found)


def judge(mutant: Mutant, durations: dict[str, float]) -> bool:
    """Return whether a test notices a mutant: it fails, or does not come to an end."""
    room = ROOT / "tests" / mutant.module.split(".")[1]
    own = room / ("test_" + mutant.module.rsplit(".", 1)[-1] + ".py")

    def work(*arguments: str) -> int:
        sys.meta_path.insert(0, _Finder(mutant))
        options = ["-x", "-q", "-p", "no:cacheprovider", *arguments]
        return int(pytest.main(options, plugins=[_Quickest(durations, own.name)]))

    limit = int(20 + 3 * sum(value for value in durations.values() if value < LONGEST))
    if own.exists() and forked(partial(work, str(own)), limit) != 0:
        return True
    return forked(partial(work, str(room), f"--ignore={own}"), limit) != 0


def modules(room: str) -> list[str]:
    """Return the modules of a room."""
    found = sorted((ROOT / "lpvobs" / room).glob("*.py"))
    return [f"lpvobs.{room}.{path.stem}" for path in found if path.stem != "__init__"]


def written(number: int, seed: int, judged: Sequence[tuple[Mutant, bool]], left_out: dict[str, tuple[int, int]]) -> str:
    """Return the page of results."""
    lines = [
        "# Deliberate faults, and whether the tests notice",
        "",
        f"`benchmarks/mutants.py --number {number} --seed {seed}`, {date.today().isoformat()}, compiler off: {len(judged)} judged. "
        f"Of the tests of each room those count that take less than {LONGEST:g} s of computing without the compiler.",
        "",
        "| room | mutants | noticed | score | tests used | left out |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for room in [*left_out, "all"]:
        of = [noticed for mutant, noticed in judged if room in ("all", mutant.module.split(".")[1])]
        used, out = left_out.get(room, tuple(map(sum, zip(*left_out.values(), strict=True))))
        lines.append(f"| {room} | {len(of)} | {sum(of)} | {100 * sum(of) / max(len(of), 1):.1f} % | {used} | {out} |")
    lines += ["", "## Survivors", "", "| place | before | after |", "|---|---|---|"]
    for mutant, noticed in sorted(judged, key=lambda item: (item[0].module, item[0].line)):
        if not noticed:
            place = mutant.module.removeprefix("lpvobs.").replace(".", "/") + f".py:{mutant.line}"
            before, after = (text.replace("|", "\\|") for text in (mutant.before, mutant.after))
            lines.append(f"| {place} | `{before}` | `{after}` |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Judge a sample of mutants, in no order, and write the page as it grows."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rooms", type=lambda text: text.split(","), default=list(ROOMS))
    parser.add_argument("--modules", type=lambda text: text.split(","), help="only these, such as lpvobs.maps.grid")
    parser.add_argument("--times", type=Path, help="keep the durations of the tests here, and use what is kept")
    options = parser.parse_args()
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    for library in ("cvxpy", "numba", "scipy.linalg"):
        importlib.import_module(library)  # once for all
    kept = json.loads(options.times.read_text()) if options.times and options.times.exists() else {}
    durations = {room: kept.get(room) or measure(room) for room in options.rooms}
    if options.times:
        options.times.write_text(json.dumps(kept | durations))
    everything = [mutant for room in options.rooms for name in modules(room) for mutant in mutants(name)]
    if options.modules:
        everything = [mutant for mutant in everything if mutant.module in options.modules]
    chosen = random.Random(options.seed).sample(everything, min(options.number, len(everything)))
    counts = {}
    for room in options.rooms:
        used = sum(value < LONGEST for value in durations[room].values())
        counts[room] = (used, _number_of_tests(room) - used)
    judged: list[tuple[Mutant, bool]] = []
    for mutant in chosen:
        began = time.monotonic()
        noticed = judge(mutant, durations[mutant.module.split(".")[1]])
        judged.append((mutant, noticed))
        verdict = f"{'noticed ' if noticed else 'SURVIVED'} {time.monotonic() - began:5.1f} s"
        print(f"{verdict} {mutant.module}:{mutant.line}: {mutant.before} -> {mutant.after}", flush=True)
        if options.modules is None and options.rooms == list(ROOMS):
            RESULTS.write_text(written(options.number, options.seed, judged, counts), encoding="utf-8")
    print(written(options.number, options.seed, judged, counts))


def _number_of_tests(room: str) -> int:
    """Return how many tests a room has."""

    class Counter:
        number = 0

        def pytest_collection_modifyitems(self, items: list[Any]) -> None:
            Counter.number = len(items)

    place = Path(tempfile.gettempdir()) / f"mutants-{os.getpid()}-count"

    def work() -> int:
        pytest.main(["--collect-only", "-q", "-p", "no:cacheprovider", str(ROOT / "tests" / room)], plugins=[Counter()])
        place.write_text(str(Counter.number))
        return 0

    forked(work, 120)
    number = int(place.read_text())
    place.unlink()
    return number


if __name__ == "__main__":
    main()
