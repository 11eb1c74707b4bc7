"""`lpvobs report`."""

from pathlib import Path
from typing import Annotated

import typer

from lpvobs.cli.common import JsonOption, guarded, print_json, refuse_overwriting, say, table, visible


@guarded
def report(
    result: Annotated[Path, typer.Argument(readable=False, metavar="RESULT.h5", help="A result of estimate.")],
    further: Annotated[
        list[Path] | None,
        typer.Argument(
            readable=False,
            metavar="[LOG|RESULT]...",
            help="Logs that the results were made from (time series), and further results.",
        ),
    ] = None,
    html: Annotated[
        Path | None, typer.Option(readable=False, metavar="FILE", help="Write one self-contained page.")
    ] = None,
    gate: Annotated[
        list[str] | None,
        typer.Option(metavar="EXPR", help="metric<=number, also <, >=, >; exit code 1 if a log fails it. Repeatable."),
    ] = None,
    junit: Annotated[
        Path | None,
        typer.Option(
            readable=False, metavar="FILE", help="Write every gate's verdict on every log as JUnit XML, for CI systems."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show how far the corrected sensor is from the truth: as a table, JSON, or a page with the paper's figures.

    Example: lpvobs report nedc.h5 nedc.parquet --html nedc.html --gate "mean_relative_error<=0.05"
    """
    from lpvobs.errors import UsageError
    from lpvobs.report.discovered import contents, sentences
    from lpvobs.report.gates import enforce, judge, parse_gate
    from lpvobs.report.load import load
    from lpvobs.report.names import distinct
    from lpvobs.report.tables import coefficient_tables, gain_line, report_content, report_rows

    gates = list(dict.fromkeys(parse_gate(expression) for expression in gate or []))
    if junit is not None and not gates:
        raise UsageError(f"--junit {junit}: there is no verdict to write; give a --gate, or leave it out")
    if junit is not None and html is not None and junit.resolve() == html.resolve():
        raise UsageError(f"--junit {junit}: is also the HTML page; name two files")
    inputs = [result, *(further or [])]
    for option, target in (("--html", html), ("--junit", junit)):
        if target is not None:
            refuse_overwriting(target, inputs, option)
    loaded = load(inputs)
    names = distinct([item.path for item in loaded.results])
    results = list(zip(names, loaded.results, strict=True))
    content = report_content(results)
    for item, found in zip(content["results"], loaded.discovered, strict=True):
        item.update(contents(found))
    if html is not None:
        from lpvobs.report.content import gather
        from lpvobs.report.page import write_page

        write_page(html, gather(loaded))
        say(f"{html}: written")
    if as_json:
        print_json("report", content)
    else:
        print(table(*report_rows(results), labels=3))
        for coefficients in coefficient_tables(results):
            print("\n" + table(*coefficients))
        told = sentences(list(zip(names, loaded.discovered, strict=True)))
        if told:
            print("\n" + "\n".join(visible(line) for line in told))
        print("\n" + "\n".join(visible(f"gain of {name}: {gain_line(item.gain)}") for name, item in results))
    verdicts = judge(gates, content["logs"])
    if junit is not None:
        from lpvobs.report.junit import write_junit

        write_junit(junit, verdicts)
        say(f"{junit}: written")
    enforce(verdicts)
