"""What the reference says of a record's fields stands in comments beside them."""

import ast
import importlib.util

import pytest
from repository import ROOT

pytest.importorskip("griffe", reason="comes with the extra 'docs'")
SOURCE = '''
WHERE = "through the"


class Heat:
    """What warms the air."""

    wall: float  # K, of the ports
    # a line above
    # and another
    share: float
    plain: float

    # before a line of its own
    flow: float  # kg/s
    kind: str = "#"
    loss: Annotated[Array, Item("W", f"{WHERE} wall", ("node", "time"))]
    rows: Annotated[int, Meta(description="how many")]
'''


@pytest.fixture(scope="module")
def fields():
    spec = importlib.util.spec_from_file_location("fields", ROOT / "tools" / "fields.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def field_of(name):
    (found,) = (
        item for item in ast.walk(ast.parse(SOURCE)) if getattr(item, "annotation", None) and item.target.id == name
    )
    return found


@pytest.mark.parametrize(
    ("name", "said"),
    [("wall", "K, of the ports"), ("share", "a line above and another"), ("plain", ""), ("flow", "kg/s"), ("kind", "")],
)
def test_a_field_has_the_comment_behind_it_or_above_it(fields, name, said):
    assert fields.comment_at(field_of(name), fields.comments_of(SOURCE)) == said


@pytest.mark.parametrize(
    ("name", "said"),
    [("loss", ("Array", "(node, time) [W] through the wall")), ("rows", ("int", "how many")), ("wall", ("float", ""))],
)
def test_what_an_annotation_says_is_shown(fields, name, said):
    assert fields.split(field_of(name).annotation, fields.texts_of(SOURCE)) == said
