"""What the reference says of a record's fields stands in comments beside them."""

import ast
import importlib.util

import pytest
from repository import ROOT

pytest.importorskip("griffe", reason="comes with the extra 'docs'")
SOURCE = '''
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
'''


@pytest.fixture(scope="module")
def fields():
    spec = importlib.util.spec_from_file_location("fields", ROOT / "tools" / "fields.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("name", "said"),
    [("wall", "K, of the ports"), ("share", "a line above and another"), ("plain", ""), ("flow", "kg/s"), ("kind", "")],
)
def test_a_field_has_the_comment_behind_it_or_above_it(fields, name, said):
    (field,) = (
        item for item in ast.walk(ast.parse(SOURCE)) if getattr(item, "target", None) and item.target.id == name
    )
    assert fields.comment_at(field, fields.comments_of(SOURCE)) == said
