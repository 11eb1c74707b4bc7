"""`lpvobs report`."""

from pathlib import Path

import typer

from lpvobs.cli.changes import show_fleet
from lpvobs.cli.common import guarded, leave, print_json, say, table, visible
from lpvobs.cli.options import JSON, REGION, argument, flag, option
from lpvobs.errors import UsageError


def _list_metrics(asked: bool) -> None:
    """List the metrics that a gate may ask for, and end."""
    if asked:
        from lpvobs.report.gates import METRICS, OF_RESULT

        rows = [
            [name, item.unit, of, item.meaning + (f"; needs {item.needs}" if item.needs else "")]
            for of, metrics in (("log", METRICS), ("result", OF_RESULT))
            for name, item in metrics.items()
        ]
        print(table(["metric", "unit", "of a", "meaning"], rows, left=4))
        raise typer.Exit


@guarded
def report(
    result: Path = argument(
        "RESULT.h5", "A result of estimate or refine, an engine made by calibrate, or a fleet made by track."
    ),
    further: list[Path] | None = argument(
        "[LOG|RESULT]...",
        "Logs from which the results were made, to show signals over time and how well the model fits; or further results.",
        default=None,
    ),
    html: Path | None = option("FILE", "Also write the report as one self-contained HTML page."),
    gate: list[str] | None = option(
        "EXPR",
        "A limit on a metric, such as residual<=0.001 (also <, >=, >, ==, !=), or verdict==none: trace has found nothing. If a "
        "gate fails, the exit code is 1. Repeatable.",
    ),
    junit: Path | None = option("FILE", "Write as JUnit XML which logs pass each gate, for CI systems."),
    region: str | None = REGION,
    list_metrics: bool = flag(
        "--list-metrics", "List the metrics that --gate accepts, and exit.", callback=_list_metrics, is_eager=True
    ),
    as_json: bool = JSON,
) -> None:
    """Show a result and its quality as tables, JSON or an HTML page, and check limits on its metrics (gates).

    Example: lpvobs report nedc.h5 nedc.parquet --html nedc.html --gate "mean_relative_error<=0.05"
    """
    from lpvobs.api.compare import region_of
    from lpvobs.api.write_report import kind_of, make_report
    from lpvobs.report import tables
    from lpvobs.report.gates import enforce

    if (kind := kind_of(result)) in ("engine", "fleet"):
        if gate or junit or region or further:
            raise UsageError(
                f"{result}: holds a {kind}, but logs, --gate, --junit and --region are only for results of estimate; drop them"
            )
        _other(kind, result, html, as_json)
        return
    wanted = None if region is None else region_of(region)
    done = make_report(result, further or (), html=html, gates=gate or (), junit=junit, region=wanted)
    for written in (html, junit):
        if written is not None:
            say(f"{written}: written")
    if as_json:
        print_json("report", done.content)
    else:
        named = done.report.named
        print(table(*tables.told(tables.report_rows(named)), labels=3))
        for coefficients in tables.coefficient_tables(named, tables.beside_paper(named)):
            print("\n" + table(*coefficients))
        if done.content.fits:
            print("\n" + table(*tables.fit_rows(done.content.fits), labels=3))
        for mean in done.content.regions:
            print("\n" + tables.region_line(mean))
        if done.report.sentences:
            print("\n" + "\n".join(map(visible, done.report.sentences)))
        print("\n" + "\n".join(visible(f"gain of {name}: {tables.gain_line(item.gain)}") for name, item in named))
    enforce(done.verdicts)
    leave(done.content.refused)


def _other(kind: str, path: Path, html: Path | None, as_json: bool) -> None:
    """Show an engine or a fleet."""
    from lpvobs.api.track import output_of
    from lpvobs.api.write_report import report_engine, report_fleet
    from lpvobs.report.engines import calibration_tables

    fleet = report_fleet(path, html=html) if kind == "fleet" else None
    engine = None if fleet else report_engine(path, html=html)
    if html is not None:
        say(f"{html}: written")
    if fleet:
        print_json("track", output_of(fleet, 0, 0, fleet.refused)) if as_json else show_fleet(fleet)
        leave(fleet.refused)
    elif engine and as_json:
        print_json("calibrate", engine)
    elif engine:
        print("\n\n".join(table(*part) for part in calibration_tables(engine)))
