"""A class name means one thing in the whole package."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1] / "lpvobs"


def places_of_classes():
    """Return where each class name is defined; an underscore in front makes no other name of it."""
    found = defaultdict(list)
    for path in sorted(ROOT.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                found[node.name.lstrip("_")].append(f"{path.relative_to(ROOT)}:{node.lineno}")
    return found


def test_a_class_name_means_one_thing():
    found = places_of_classes()
    assert len(found) > 200  # otherwise nothing was read
    assert not {name: places for name, places in found.items() if len(places) > 1}
