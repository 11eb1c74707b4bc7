"""The README is short, and its first two screens answer what a stranger asks."""

import re

import pytest
from repository import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
SCREEN = 45
"""Lines that a screen shows."""


def test_it_has_less_than_a_thousand_words():
    assert len(TEXT.split()) < 1000


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        ("What is it?", r"estimates\s+that error from\s+recorded drives, as a map"),
        ("Can my log do it?", r"\*\*Can my log do it\?\*\* [^-]*docs/your-logs\.md"),
        (
            "Where do the constants come from?",
            r"\*\*Where do the constants come from\?\*\* [^-]*\s+`lpvobs\s+calibrate`",
        ),
        ("How good?", r"\*\*How good is it\?\*\* [^-]*%"),
        ("What next?", r"\*\*What next\?\*\* `make run`, then the \[tutorial\]"),
    ],
)
def test_the_first_two_screens_answer(question, answer):
    assert re.search(answer, "\n".join(TEXT.splitlines()[: 2 * SCREEN])), question


def test_every_page_and_picture_that_it_names_is_there():
    named = re.findall(r"\]\(([^)#:]+?)(?:#[^)]*)?\)", TEXT)
    assert len(named) > 10
    assert [name for name in named if not (ROOT / name).is_file()] == []
