"""The tests that CI has no time for, and how each ended: `make proofs`, or `python benchmarks/proofs.py [OPTION...]`.

They are the tests marked `proof`. Options are those of pytest. The page also says which were skipped.
"""

import os
import sys
import time

import pytest
from common import commit, markdown, publish


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
    watch, begin = Watch(), time.perf_counter()
    together = ["-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder"]
    code = int(pytest.main(["-m", "proof", *together, *options], plugins=[watch]))
    rows = [[f"`{name}`", outcome] for name, outcome in sorted(watch.outcomes.items())]
    took = f"{time.perf_counter() - begin:.0f} s on the clock"
    head = f"Tests that CI leaves out because they take long: {len(rows)} in {took}. The code is that of commit {commit()}."
    publish("proofs", "The longest tests", f"{head}\n\n{markdown(['test', 'outcome'], rows)}", "make proofs")
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
