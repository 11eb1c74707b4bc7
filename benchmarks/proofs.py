"""The tests that take longest, and how each ended: `make proofs`, or `python benchmarks/proofs.py [OPTION...]`.

They are the tests marked `proof`, which CI leaves out. Options are those of pytest. Those that need recordings are skipped without
them, and the page says so.
"""

import os
import sys
import time

import pytest
from common import markdown, publish


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
    code = int(pytest.main(["-m", "proof", *options], plugins=[watch]))
    rows = [[f"`{name}`", outcome] for name, outcome in sorted(watch.outcomes.items())]
    took = f"{time.perf_counter() - begin:.0f} s on the clock, one after the other"
    text = f"Tests that CI leaves out because they take long: {took}.\n\n{markdown(['test', 'outcome'], rows)}"
    publish("proofs", "The longest tests", text, "make proofs")
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
