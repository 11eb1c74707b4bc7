"""Every test lies where it is looked for, is collected, and its folder is told of in README.md."""

import re
from pathlib import Path

import pytest
from repository import ROOT

TESTS = Path(__file__).parent
APART = {
    "benchmarks": "of the folder beside the package",
    "contract": "what others rely on, whichever room provides it",
    "docs": "of the pages",
    "measured": "recordings that are no part of the repository",
    "properties": "invariants across rooms",
    "reference": "twins and textbooks, no tests",
    "robust": "damage, strangers and kills, whichever room they meet",
}
"""Folders that are named after no room of the package, and why."""
FOLDERS = sorted(path.name for path in TESTS.iterdir() if any(path.rglob("*.py")))


def test_a_folder_is_a_room_or_says_why_it_is_none():
    rooms = {path.name for path in (ROOT / "lpvobs").iterdir() if (path / "__init__.py").exists()}
    assert set(FOLDERS) - set(APART) <= rooms
    assert set(APART) <= set(FOLDERS)


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_readme_tells_of_a_folder(folder):
    assert f"| `{folder}` |" in (TESTS / "README.md").read_text(encoding="utf-8")


def test_whatever_looks_like_a_test_is_collected():
    """Pytest takes files called test_*.py alone, and says nothing of the others."""
    found = {path for path in TESTS.rglob("*.py") if re.search(r"^def test_", path.read_text(encoding="utf-8"), re.M)}
    assert [path for path in found if not path.name.startswith("test_")] == []
    assert set(TESTS.rglob("test_*.py")) - found == set()


@pytest.mark.parametrize("folder", ["benchmarks", "configs", "data", "docs", "lpvobs", "schemas", "tests", "tools"])
def test_no_file_is_a_link_to_somewhere_else(folder):
    """A link that leaves the checkout is a missing file for everybody else, and the package cannot be built."""
    assert not [path for path in (ROOT / folder).rglob("*") if path.is_symlink()]
