"""The page of what is written by hand: every file is there, and about as long as it says."""

import re

import pytest
from repository import ROOT

ROWS = [
    (row.split("|")[1].strip(), re.findall(r"`([^`]+)`", row.split("|")[2]), int(row.split("|")[3]))
    for row in (ROOT / "docs" / "by-hand.md").read_text(encoding="utf-8").splitlines()
    if re.match(r"\|.*\| \d+ \|", row)
]


@pytest.mark.parametrize(("what", "files", "lines"), ROWS, ids=[row[0] for row in ROWS])
def test_files_are_there_and_about_as_long_as_the_page_says(what, files, lines):
    found = sum(len((ROOT / name).read_text(encoding="utf-8").splitlines()) for name in files)
    assert files
    assert found == pytest.approx(lines, rel=0.25), "a quarter more or less is another module"
