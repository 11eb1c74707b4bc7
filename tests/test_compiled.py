"""The compiler and what else is heavy are loaded by whoever needs them, and compiled functions are what they would be with it."""

import ast
import subprocess
import sys

import pytest
from repository import ROOT

HEAVY = (
    "numba",
    "cvxpy",
    "matplotlib",
    "pandas",
    "pint",
    *(f"scipy.{x}" for x in ("stats", "signal", "interpolate", "optimize", "sparse")),
)


def loaded_after(code):
    """Return what is loaded after lines of code, in a process of its own."""
    call = [sys.executable, "-c", f"{code}\nimport sys; print(*sys.modules)"]
    return set(subprocess.run(call, capture_output=True, text=True, check=True, timeout=120).stdout.split())


@pytest.mark.parametrize("verb", ["verify", "extrapolate", "export", "trace", "refine"])
def test_a_verb_on_stored_results_starts_without_what_is_heavy(verb):
    assert loaded_after(f"import lpvobs; lpvobs.{verb}") & set(HEAVY) == set()


@pytest.mark.parametrize("path", sorted((ROOT / "lpvobs" / "discovery").glob("*.py")), ids=lambda path: path.stem)
def test_a_search_uses_nothing_of_scipy_that_takes_long_to_load(path):
    parts = {
        node.attr
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "scipy"
    }
    # a healthy drive is learned from once, by `estimate`, and a search needs no optimiser
    assert parts <= {"linalg", "ndimage", "special", "sparse"} | ({"optimize"} if path.stem == "likeliest" else set())


def test_the_first_call_compiles_in_every_module_that_has_the_function():
    code = """
import sys
import numpy as np
from lpvobs.maps import grid
from lpvobs.observer import ekf
assert "numba" not in sys.modules
kept = [grid.share]
assert ekf.local is grid.local and grid.local.__name__ == "local"
assert kept[0](np.array([0.0, 1.0, 2.0]), 1.5, 1) == 0.5
assert "numba" in sys.modules
assert ekf.local is grid.local and hasattr(grid.local, "py_func")
assert kept[0](np.array([0.0, 1.0, 2.0]), 0.25, 0) == 0.25
from lpvobs.observer import windows
assert not any(type(value).__name__ == "_Waiting" for module in (grid, windows) for value in vars(module).values())
"""
    assert "numba" in loaded_after(code)


def test_numba_that_is_there_already_is_used_at_once():
    code = """
from lpvobs.maps import grid
import numba
from lpvobs.observer import recursion
assert hasattr(grid.share, "py_func") and hasattr(recursion._recursion, "py_func")
"""
    assert "numba" in loaded_after(code)
