"""Every equation of the paper stands on a line that says so, or has a reason why not; the page of the documentation lists them."""

import importlib.util
import re

import pytest
from repository import ROOT


def _tool():
    spec = importlib.util.spec_from_file_location("equations", ROOT / "tools" / "equations.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


equations = pytest.fixture(scope="module")(_tool)


@pytest.mark.parametrize("number", range(1, 41))
def test_an_equation_has_a_line_or_a_reason(equations, number):
    has_line, reason = number in equations.places(), equations.WITHOUT_LINE.get(number, "")
    assert has_line != bool(reason), f"Eq. ({number})"
    assert has_line or reason.startswith(("proof only: ", "definition: "))


def test_there_are_forty(equations):
    assert list(equations.EQUATIONS) == list(range(1, 41))
    assert set(equations.places()) <= set(equations.EQUATIONS)


def test_there_is_one_spelling_at_the_end_of_a_line_of_code(equations):
    for path in (path for folder in equations.FOLDERS for path in (ROOT / folder).rglob("*.py")):
        for line, code, comment in equations.comments(path):
            if re.search(r"\b[Ee]qs?\b|\b[Ee]quations? ?\(?\d", comment):
                assert equations.SPELLING.fullmatch(comment), f"{path}:{line}: {comment}"
                assert code, f"{path}:{line}: no code before the comment"


def test_the_page_shows_them_all(equations):
    page = equations.page()
    for number in range(1, 41):
        assert re.search(rf"\*\*Eq\. \({number}\)\*\*, .+\n\n- .+\n", page)
    assert re.search(r"\*\*Eq\. \(26\)\*\*.+\n\n- `lpvobs/observer/step\.py:\d+`: `dx = ", page)
    assert '--8<-- "equations.md"' in (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")


def test_a_line_is_found_where_it_is(equations):
    for found in equations.places().values():
        for place in found:
            line = (ROOT / place.path).read_text(encoding="utf-8").splitlines()[place.line - 1]
            assert line.strip().startswith(place.code)
