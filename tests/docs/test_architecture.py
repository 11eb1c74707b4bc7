"""The page of the architecture: its picture has every room in its order, and what it names is there."""

import ast
import re
from functools import cache

import pytest
from repository import ROOT
from test_rooms import ROOMS

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
STEPS = [
    (path, name)
    for path, names in re.findall(r"^\|(?: *\d+ *\|)? `([a-z_/]+\.py)` \| ([^|]+) \|", PAGE, re.MULTILINE)
    for name in re.findall(r"`([\w.]+)`", names)
]


@cache
def defined(path):
    """Return the functions, classes and methods that a module defines."""
    tree = ast.parse((ROOT / "lpvobs" / path).read_text(encoding="utf-8"))
    found = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{own.name}" for own in node.body if isinstance(own, ast.FunctionDef)}
    return found


def test_the_picture_has_every_room_in_its_order():
    drawn = re.findall(r'class="room"[^>]*>(\w+)<', (ROOT / "docs" / "rooms.svg").read_text(encoding="utf-8"))
    assert tuple(drawn) == ROOMS
    told = re.search(r"!\[.*?: (.*?)\.\]\(rooms\.svg\)", PAGE, re.DOTALL).group(1)
    assert tuple(re.findall(r"\w+", told)) == ROOMS


def test_both_ways_are_there():
    assert len(STEPS) > 30


@pytest.mark.parametrize(("path", "name"), STEPS)
def test_what_a_step_names_is_there(path, name):
    assert name in defined(path)


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`(?:lpvobs/)?([a-z_]+(?:/[a-z_]+)+\.py)`", PAGE))))
def test_every_file_that_is_named_is_there(path):
    assert any((folder / path).is_file() for folder in (ROOT / "lpvobs", ROOT))


@pytest.mark.parametrize("what", ["an effect", "a file format", "an engine"])
def test_adding_takes_ten_lines_at_most(what):
    lines = re.search(rf"^## Adding {what}\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE).group(1)
    numbers = [int(number) for number in re.findall(r"^(\d+)\. ", lines, re.MULTILINE)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert 5 < len(numbers) <= 10
