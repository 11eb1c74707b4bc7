"""What the README says of accuracy is what the pages of results say: figures are made, not typed."""

import re

import pytest
from repository import ROOT

SHARE = 0.01
README = (ROOT / "README.md").read_text(encoding="utf-8")
CYCLES = ("ETC surrogate, part 1", "FTP75, cold transient")


def row(page, *starts):
    """Return the numbers of the row that begins as given, below the headings given before it."""
    text = (ROOT / "benchmarks" / "results" / f"{page}.md").read_text(encoding="utf-8")
    for start in starts[:-1]:
        text = text[text.index(f"## {start}") :]
    line = next(line for line in text.splitlines() if line.startswith(f"| {starts[-1]} |"))
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", line.removeprefix(f"| {starts[-1]} |"))]


def told(words):
    """Return the numbers of the README in words, where # stands for one."""
    pattern = re.escape(words).replace(r"\#", r"(-?\d+(?:\.\d+)?)").replace(r"\ ", r"\s+")
    found = re.search(pattern, README)
    assert found, f"the README does not say '{words}'"
    return [float(number) for number in found.groups()]


def alike(mine, theirs):
    return mine == pytest.approx(theirs, rel=SHARE)


def table(start):
    """Return the numbers of a row of the README's table."""
    line = next(line for line in README.splitlines() if line.startswith(f"| {start}"))
    return [float(number) for number in re.findall(r"\d+\.\d+", line)]


@pytest.mark.parametrize("place", [0, 1])
def test_the_table_of_accuracy(place):
    cycle, method = CYCLES[place], "a) as published, Gamma = 200"
    assert alike(table("exact constants, no sensor noise")[place::2], row("accuracy", "Without sensor noise", cycle))
    noisy = [row("accuracy", cycle, name)[0] for name in (method, "default")]
    assert alike(table("exact constants, noise")[place::2], noisy)
    within = row("drawn_constants", f"within 1 % | {cycle}")
    assert alike(table("constants drawn within 1 %")[place], within[0])
    assert alike(told("fitted to the truth is off by # and # %")[place], within[2])


def test_the_engine_of_another_structure():
    found = row("structures", "all")
    assert alike(table("another structure"), [found[0], found[2]])


def test_the_blind_bank():
    single = "single effect: first named right, or in a set of three at most"
    (logs,) = told("**# simulated drives**")
    right, of = told("it named # of # single effects rightly, and both")
    sound, clean = told("# of # healthy drives got the verdict `none`")
    assert [right, of] == row("blind", "diesel", single)[:2]
    assert row("blind", "diesel", "clean: `none`")[:2] == [sound, clean]
    assert told("both effects in # of # drives with two") == row("blind", "diesel", "pair: both found")[:2]
    throttled = *row("blind", "throttled", single)[:2], *row("blind", "throttled", "truth inside its 90 % interval")[:2]
    assert told("it named # of # single effects rightly, and # of # of the 90 % intervals") == [*throttled]
    text = (ROOT / "benchmarks" / "results" / "blind.md").read_text(encoding="utf-8")
    assert f"\n{logs:.0f} logs: {clean:.0f} clean" in text
    assert re.search(rf"\| clean \| none {sound:.0f}\b", text)


def test_the_bank_says_which_commit_judged():
    text = (ROOT / "benchmarks" / "results" / "blind.md").read_text(encoding="utf-8")
    assert re.search(r"were judged by commit [0-9a-f]{7,40}\b", text)
