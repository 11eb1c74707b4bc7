"""The tests that CI has no time for, and how each ended: `make proofs`, or `python benchmarks/proofs.py [OPTION...]`.

They are the tests marked `proof`. Options are those of pytest; what it selects of one commit is added to what the page has of that
commit.
"""

import os
import re
import sys

import pytest
from common import RESULTS, commit, markdown, publish

ROW = re.compile(r"^\| `(.+)` \| (\w+) \|$", re.MULTILINE)


class Watch:
    """Keeps how every test ended."""

    def __init__(self) -> None:
        self.outcomes: dict[str, str] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the outcome of the call, or that of a set-up that failed or skipped."""
        if report.when == "call" or not report.passed:
            self.outcomes[report.nodeid] = report.outcome


def main(options: list[str]) -> int:
    """Run the proofs and write their page; return pytest's exit code."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    watch, page = Watch(), RESULTS / "proofs.md"
    together = ["-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder"]
    code = int(pytest.main(["-m", "proof", *together, *options], plugins=[watch]))
    head = f"Tests that CI leaves out because they take long. The code is that of commit {commit()}."
    text = page.read_text(encoding="utf-8") if page.exists() else ""
    outcomes = dict(ROW.findall(text) if head in text else ()) | watch.outcomes
    rows = [[f"`{name}`", outcome] for name, outcome in sorted(outcomes.items())]
    publish("proofs", "The longest tests", f"{head}\n\n{markdown(['test', 'outcome'], rows)}", "make proofs")
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
