"""`lpvobs report`."""

from pathlib import Path

from lpvobs.cli.common import guarded, print_json, say, table, visible
from lpvobs.cli.options import JSON, REGION, argument, option


@guarded
def report(
    result: Path = argument("RESULT.h5", "A result of estimate, or an engine of calibrate."),
    further: list[Path] | None = argument(
        "[LOG|RESULT]...",
        "Logs that the results were made from (courses over time), and further results.",
        default=None,
    ),
    html: Path | None = option("FILE", "Write one self-contained page."),
    gate: list[str] | None = option(
        "EXPR", "metric<=number, also <, >=, >; exit code 1 if a log fails it. Repeatable."
    ),
    junit: Path | None = option("FILE", "Write every gate's verdict on every log as JUnit XML, for CI systems."),
    region: str | None = REGION,
    as_json: bool = JSON,
) -> None:
    """Show how far the corrected sensor is from the truth: as a table, JSON, or a page with the paper's figures.

    Example: lpvobs report nedc.h5 nedc.parquet --html nedc.html --gate "mean_relative_error<=0.05"
    """
    from lpvobs.api.compare import region_of
    from lpvobs.api.write_report import is_engine, make_report, report_engine
    from lpvobs.report.engines import calibration_tables
    from lpvobs.report.gates import enforce
    from lpvobs.report.tables import coefficient_tables, gain_line, region_line, report_rows

    if is_engine(result):
        engine = report_engine(result, html=html)
        if html is not None:
            say(f"{html}: written")
        if as_json:
            print_json("calibrate", engine)
        else:
            print("\n\n".join(table(*part) for part in calibration_tables(engine)))
        return
    wanted = None if region is None else region_of(region)
    done = make_report(result, further or (), html=html, gates=gate or (), junit=junit, region=wanted)
    for written in (html, junit):
        if written is not None:
            say(f"{written}: written")
    if as_json:
        print_json("report", done.content)
    else:
        print(table(*report_rows(done.results), labels=3))
        for coefficients in coefficient_tables(done.results):
            print("\n" + table(*coefficients))
        for mean in done.content.regions:
            print("\n" + region_line(mean))
        if done.told:
            print("\n" + "\n".join(visible(line) for line in done.told))
        print("\n" + "\n".join(visible(f"gain of {name}: {gain_line(item.gain)}") for name, item in done.results))
    enforce(done.verdicts)
