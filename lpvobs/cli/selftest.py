"""`lpvobs selftest`."""

import typer

from lpvobs.cli.common import guarded, print_json, progress, say, table
from lpvobs.cli.options import JSON

VERDICTS = {True: "pass", False: "FAIL"}


@guarded
def selftest(as_json: bool = JSON) -> None:
    """Test the installed package on cases whose answers are known, for users who must qualify their tools.

    The command needs no files and leaves none. Exit code 1 if an answer is wrong.

    Example: lpvobs selftest
    """
    from lpvobs.errors import NotProven
    from lpvobs.selftest.cases import SelftestOutput, run_cases

    with progress("testing") as report:
        rows, versions = run_cases(report)
    failed = [row for row in rows if not row.passed]
    if as_json:
        print_json("selftest", SelftestOutput(passed=not failed, cases=rows, versions=versions))
    else:
        lines = []
        for row in rows:
            numbers = [f"{number:.6g}" for number in (row.expected, row.found, row.tolerance)]
            lines.append([row.case, *numbers, row.unit, VERDICTS[row.passed]])
        print(table(["case", "expected", "found", "tolerance", "unit", ""], lines))
        say(", ".join(f"{name} {number}" for name, number in versions.items()))
        for row in failed:
            say(f"{row.case}: {row.note or 'the answer is wrong'}")
        say(f"{len(rows) - len(failed)} of {len(rows)} cases passed")
    if failed:
        raise typer.Exit(NotProven.exit_code)
