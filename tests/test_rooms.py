"""The house: each room imports only from rooms before it, none in a circle, heavy libraries only where they belong.

Reads the sources with `ast`; nothing is imported, so a broken room cannot hide another one's fault. Imports inside functions count
as well: a layer that is broken late is broken.
"""

import ast
from functools import cache
from graphlib import CycleError, TopologicalSorter

import pytest
from repository import ROOT

ROOT = ROOT / "lpvobs"
ROOMS = (
    "errors", "kinds", "compiled", "records", "engines", "maps", "synthesis", "observer", "calibration", "discovery",
    "tracking", "simulation", "io", "ingest", "report", "api", "selftest", "cli",
)  # fmt: skip
FORBIDDEN = {"selftest": {"report"}}
ASKED = {"api", "selftest", "report", "errors", "cli"}
"""What the command line may know: the functions behind the verbs, and the tables that say what came of them."""
HEAVY = {"numpy", "numba", "pandas", "pyarrow", "h5py", "cvxpy", "matplotlib", "scipy", "jinja2", "pint"}


def module_of(path):
    parts = ("lpvobs", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {module_of(path): path for path in sorted(ROOT.rglob("*.py"))}


@cache
def tree_of(module):
    return ast.parse(SOURCES[module].read_text(encoding="utf-8"))


def is_type_checking(node):
    return isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")


def statements(tree, *, late):
    """Yield the import statements of a module: at its top level only, or anywhere; never those for type checkers."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        elif is_type_checking(node):
            yield from (found for branch in node.orelse for found in statements(branch, late=late))
        elif late or not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from statements(node, late=late)


def imported(tree, *, late=True):
    """Return the full names of what a module imports; `from a import b` is a.b where that is a module, else a."""
    found = set()
    for node in statements(tree, late=late):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif node.level:
            pytest.fail(f"relative import in line {node.lineno}: the tests follow absolute ones")
        else:
            found |= {
                full if (full := f"{node.module}.{alias.name}") in SOURCES else str(node.module) for alias in node.names
            }
    return found


def room_of(module):
    parts = module.split(".")
    own = parts[1] if len(parts) > 1 else "__init__"
    return "cli" if own == "__main__" else own


def inside(module):
    """Return the modules of this package that a module imports."""
    return {name for name in imported(tree_of(module)) if name == "lpvobs" or name.startswith("lpvobs.")}


def test_there_is_something_to_read():
    assert len(SOURCES) > 40
    assert {room_of(module) for module in SOURCES} - {"__init__"} <= set(ROOMS)
    assert "lpvobs.maps.grid" in inside("lpvobs.maps.metrics")
    assert "cvxpy" in imported(tree_of("lpvobs.synthesis.lmi"))


def test_a_module_is_read_in_one_go():
    """350 lines are what a reader holds in mind at once; half of the modules have less than 150."""
    lines = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8").count("\n") for path in ROOT.rglob("*.py")}
    assert {name: count for name, count in lines.items() if count > 350} == {}
    assert sorted(lines.values())[len(lines) // 2] < 150


@pytest.mark.parametrize("module", SOURCES)
def test_a_room_imports_only_from_rooms_before_it(module):
    own = room_of(module)
    if own == "__init__":
        assert inside(module) == set()
        return
    for name in inside(module):
        if name == "lpvobs":  # the version, which the package's own root holds and which imports nothing
            continue
        other = room_of(name)
        assert ROOMS.index(other) <= ROOMS.index(own), f"{module} imports {name}"
        assert other not in FORBIDDEN.get(own, ()), f"{module} imports {name}"


def test_no_circle_inside_a_room():
    graph = {module: inside(module) - {"lpvobs"} for module in SOURCES}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"import cycle: {' -> '.join(error.args[1])}")


@pytest.mark.parametrize("module", SOURCES)
def test_the_solver_is_imported_by_synthesis_alone(module):
    if room_of(module) != "synthesis":
        libraries = {name.split(".")[0] for name in imported(tree_of(module))}
        assert not libraries & {"cvxpy", "clarabel"}


def test_the_certificate_and_what_it_needs_import_no_solver():
    """`verify` repeats the proof: everything that loads with the certificate is looked through."""
    todo, seen = ["lpvobs.synthesis.certificate"], set()
    while todo:
        module = todo.pop()
        if module in seen:
            continue
        seen.add(module)
        names = imported(tree_of(module))
        assert not {name.split(".")[0] for name in names} & {"cvxpy", "clarabel"}, module
        todo += [name for name in names if name in SOURCES]
    assert len(seen) > 3


@pytest.mark.parametrize("module", [module for module in SOURCES if room_of(module) == "cli"])
def test_the_command_line_loads_nothing_heavy_before_it_knows_the_verb(module):
    libraries = {name.split(".")[0] for name in imported(tree_of(module), late=False)}
    assert not libraries & HEAVY
    for name in inside_at_import(module):
        assert room_of(name) in ("cli", "errors", "__init__"), f"{module} imports {name} at its top"


@pytest.mark.parametrize("module", [module for module in SOURCES if room_of(module) == "cli"])
def test_the_command_line_asks_the_functions_and_nobody_else(module):
    for name in inside(module) - {"lpvobs"}:
        assert room_of(name) in ASKED, f"{module} imports {name}: let a function of lpvobs.api do it"


def inside_at_import(module):
    return {name for name in imported(tree_of(module), late=False) if name.split(".")[0] == "lpvobs"}


@pytest.mark.parametrize(
    "module",
    [
        module
        for module in SOURCES
        if room_of(module) in ("engines", "maps", "observer", "calibration", "tracking", "records")
    ],
)
def test_the_numerical_core_knows_no_files(module):
    """The core runs on NumPy, SciPy and Numba alone."""
    libraries = {name.split(".")[0] for name in imported(tree_of(module))}
    assert not libraries & {
        "pandas",
        "pyarrow",
        "h5py",
        "matplotlib",
        "typer",
        "jinja2",
        "msgspec",
        "pathlib",
        "os",
        "io",
    }
