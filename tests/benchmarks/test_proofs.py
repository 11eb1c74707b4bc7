"""The page of the proofs is true of the tests that are marked so: each has run, and passed."""

import re

from repository import ROOT

ROW = re.compile(r"^\| `([^`]+)` \| (\w+) \|$", re.MULTILINE)


def test_every_proof_has_run_and_passed(proofs):
    page = (ROOT / "benchmarks" / "results" / "proofs.md").read_text(encoding="utf-8")
    outcomes = dict(ROW.findall(page))
    assert set(outcomes.values()) == {"passed"}
    assert set(proofs) <= set(outcomes)
