"""The second bank is told in README and documentation as its page has it."""

import re

import pytest
from repository import ROOT

ROW = re.compile(r"^\| (?:- )?(.+?) \| (\d+) \| (\d+) \|", re.MULTILINE)
TOLD = {
    "clean: `none`": "{} of {} clean drives got the verdict `none`",
    "single effect, true change above 1 %: named right, nothing beside it": "{} of {} single effects",
    "pairs: both found": "{} of {} pairs",
    "formulas: found": "found the formula in {} of",
    "courses: found": "{} of {} courses",
    "wrong name where nothing in the catalogue is true": "{} of {} drives that were clean or had",
    "size inside its 90 % interval": "{} of {} intervals contained the true size",
    "component curves, true change above 1 %: named": "{} of the {} that change a flow by 1 % or more",
}


@pytest.fixture(scope="module")
def rows():
    page = (ROOT / "benchmarks" / "results" / "blind2.md").read_text(encoding="utf-8")
    return {what: (seen, of) for what, seen, of in ROW.findall(page)}


@pytest.mark.parametrize("what", TOLD)
def test_the_documentation_has_the_figures_of_the_page(rows, what):
    """After a new seed README and documentation still had the figures of the one before, which were better."""
    text = (ROOT / "docs" / "closing-the-loop.md").read_text(encoding="utf-8")
    assert TOLD[what].format(*rows[what]) in " ".join(text.split())


def test_so_has_the_readme(rows):
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    none, clean = map(int, rows["clean: `none`"])
    curves = [rows[f"component curves, true change {where} 1 %: named"] for where in ("above", "below")]
    found, of = (sum(map(int, each)) for each in zip(*curves, strict=True))
    (single, singles), (pair, pairs), (form, forms) = (rows[what] for what in list(TOLD)[1:4])
    assert f"it suspected {clean - none} of {clean} healthy drives" in text
    assert (
        f"{single} of {singles} single effects, {pair} of {pairs} pairs, {form} of {forms} unlisted causes, "
        f"{found} of {of} component curves" in text
    )
