"""The tests that take longest, each with its outcome and its time: `make proofs`, or `python benchmarks/proofs.py [OPTION...]`.

They are the tests marked `proof`, which CI leaves out. Options are those of pytest. Those that need recordings are skipped without
them, and the page says so.
"""

import os
import resource
import sys
from collections.abc import Generator

import pytest
from common import markdown, publish


class Watch:
    """Counts the processor time of every test, that of processes it starts included, and keeps how it ended."""

    def __init__(self) -> None:
        self.outcomes: dict[str, str] = {}
        self.seconds: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Time a test with its fixtures."""
        begin = _processor()
        try:
            return (yield)
        finally:
            self.seconds[item.nodeid] = _processor() - begin

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the outcome of the call, or that of a set-up that failed or skipped."""
        if report.when == "call" or not report.passed:
            self.outcomes[report.nodeid] = report.outcome


def main(options: list[str]) -> int:
    """Run the proofs and write their page; return pytest's exit code."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    watch = Watch()
    code = int(pytest.main(["-m", "proof", *options], plugins=[watch]))
    rows = [[f"`{name}`", outcome, f"{watch.seconds[name]:.0f}"] for name, outcome in sorted(watch.outcomes.items())]
    total = sum(watch.seconds[name] for name in watch.outcomes)
    text = f"Tests that CI leaves out because they take long; {total:.0f} s of processor time in all.\n\n"
    publish("proofs", "The longest tests", text + markdown(["test", "outcome", "CPU, s"], rows), "make proofs")
    return code


def _processor() -> float:
    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
