"""The proofs run rarely: that every name they take from the package is still there."""

import ast
from importlib import import_module

import pytest
from repository import ROOT


def taken(path):
    """Yield the module and the name of everything that a file imports from the package."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lpvobs"):
            yield from ((node.module, alias.name) for alias in node.names)


def there(module, name):
    if hasattr(import_module(module), name):
        return True
    try:
        import_module(f"{module}.{name}")
    except ImportError:
        return False
    return True


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").rglob("*.py")), ids=lambda path: path.stem)
def test_it_is_still_there(path):
    gone = [f"{module}.{name}" for module, name in taken(path) if not there(module, name)]
    assert gone == []
