"""What results say: `lpvobs compare`, `lpvobs track`, `lpvobs report`."""

from pathlib import Path
from typing import Any

import typer

import lpvobs
from lpvobs.cli import options
from lpvobs.cli.common import chosen_config, leave, print_json, progress, say, table, visible
from lpvobs.cli.options import CONFIG, GAIN, JOBS, JSON, OWN_ENGINE, REGION, SCHEDULER, argument, flag, needed, option
from lpvobs.errors import UsageError


def compare(
    first: Path = argument(
        "A.h5", "The earlier result of estimate; or a fleet made by track, to compare two periods of one vehicle."
    ),
    second: Path | None = argument("[B.h5]", "The later result of estimate; leave it out if A.h5 is a fleet."),
    vehicle: str = option("NAME", "For a fleet: the vehicle whose maps of two periods are compared.", default=""),
    period: list[str] | None = option(
        "PERIOD",
        "For a fleet: a period to compare, such as 2025-01. Give this option twice, with the earlier period first.",
    ),
    values: str = option(
        "GROUP",
        "map: compare the nodes that both results have estimated; extrapolation: compare every node of both extrapolated maps.",
        default="map",
    ),
    region: str | None = REGION,
    gate: list[str] | None = option(
        "EXPR",
        'A limit on the change, such as "largest_change<=0.5 g/s"; if it is exceeded, the exit code is 1. '
        "Other metrics: mean_change and p_value. Repeatable.",
    ),
    figure: Path | None = option(
        "FILE.svg", "Draw the change at every node as SVG. A frame marks each node whose change exceeds its error."
    ),
    as_json: bool = JSON,
) -> None:
    """Show how two maps differ, and where the difference exceeds their errors. The difference is map B minus map A.

    Example: lpvobs compare january.h5 june.h5 --gate "largest_change<=0.5 g/s"

    Two periods of one vehicle of a fleet: lpvobs compare fleet.h5 --vehicle V1 --period 2025-01 --period 2025-10
    """
    from lpvobs.api.compare import expect_gates, region_of
    from lpvobs.report.tables import grams

    over = None if region is None else region_of(region)
    found = lpvobs.compare(
        first, second, vehicle=vehicle, periods=period or (), values=values, region=over, figure=figure
    )
    if figure is not None:
        say(f"{figure}: written")
    if as_json:
        print_json("compare", found)
    else:
        low, high = (grams(end) for end in found.mean.ci90)
        where = f"in {region}" if region else f"over the {found.nodes} nodes with a value in both maps"
        print(f"mean change {where}: {grams(found.mean.value)} g/s (90 %: {low} to {high})")
        many = len(found.significant)
        print(f"p-value of 'no change': {found.p_value:.2g}; {many} nodes have changed by more than their errors")
        if found.significant:
            rows = [
                [f"{node.speed:g}", f"{node.fuel:g}", *map(grams, (node.before, node.after, node.change, *node.ci90))]
                for node in found.significant
            ]
            print(table([*found.axes, "A [g/s]", "B [g/s]", "change [g/s]", "5 %", "95 %"], rows))
    expect_gates(found, gate or ())
    if gate:
        say(f"{found.second}: every gate passes")


def track(
    logs: list[Path] | None = argument(
        "[LOG]...",
        "Parquet logs, patterns such as logs/*.parquet, or folders. Without any log, track evaluates the logs in the fleet again.",
    ),
    out: Path = needed(
        "FLEET.h5", "The fleet file to write, or to add logs to. Logs that are already in the fleet are not read again."
    ),
    by: str = option(
        "KEY", "The field that contains the vehicle's name, in the log, in --path or in --origins.", default="vehicle"
    ),
    every: str = option(
        "PERIOD",
        "Length of a period: day, week, month or year. Each vehicle gets one map per period.",
        offers=options.PERIODS,
        default="month",
    ),
    path: str | None = option(
        "PATTERN", 'Pattern of the log paths, which marks vehicle and date, such as "{vehicle}/{month}.parquet".'
    ),
    origins: Path | None = option(
        "TABLE",
        "A table (CSV or Parquet) with a row for each log. Column log is the log's path; other columns give vehicle, engine, date.",
    ),
    gain: Path | None = GAIN,
    engine: Path | None = OWN_ENGINE,
    to_table: Path | None = option(
        "FILE.parquet", "Also write the maps as a table with a row for each vehicle, period and node.", "--table"
    ),
    refined: list[Path] | None = option(
        "REFINED.h5",
        "A result of refine on logs of this fleet. track then shows when the effects in it were present. Repeatable.",
    ),
    jobs: int | None = JOBS,
    scheduler: str | None = SCHEDULER,
    verbose: bool = flag(
        "--verbose", "Show every vehicle, not only vehicles that drift, have changed or differ from their type."
    ),
    config: Path | None = CONFIG,
    as_json: bool = JSON,
) -> None:
    """Follow the maps of many vehicles over time. It shows trends, changes with their dates, and what to drive next.

    The vehicle and date of a log come from the log itself, from its path (--path) or from a table (--origins). `simulate` and
    `ingest` store both in the log with --vehicle and --date.

    Example: lpvobs track logs/ --path "{vehicle}/{month}.parquet" --gain gain.h5 --out fleet.h5
    """
    config = chosen_config(config)
    with progress("tracking") as report:
        fleet, content = lpvobs.track(
            config, logs or (), out=out, by=by, every=every, path=path, origins=origins, gain=gain, engine=engine,
            table=to_table, refined=refined or (), jobs=jobs, scheduler=scheduler, progress=report,
        )  # fmt: skip
    if as_json:
        print_json("track", content)
    else:
        show_fleet(fleet, verbose)
        stopped = f", {content.reused} of them read by an earlier run that was stopped" * bool(content.reused)
        say(f"{out}: {content.new} new logs{stopped}, {content.logs - content.new} were in the fleet before")
    leave(content.refused)


def show_fleet(fleet: Any, verbose: bool = False) -> None:
    """Print a summary, the vehicles that stand out, or all, and changes."""
    from lpvobs.report.fleets import change_rows, effect_rows, fleet_summary, vehicle_rows

    print(fleet_summary(fleet))
    for rows in (vehicle_rows(fleet, verbose), change_rows(fleet), effect_rows(fleet)):
        if rows[1]:
            print("\n" + table(*rows))


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


def report(
    result: Path = argument(
        "RESULT.h5", "A result of estimate or refine, an engine made by calibrate, or a fleet made by track."
    ),
    further: list[Path] | None = argument(
        "[LOG|RESULT]...",
        "Logs from which the results were made, to show signals over time and how well the model fits; or further results.",
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
    """Show a result as tables or an HTML page, and check limits on its metrics (gates).

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
        print_json("track", output_of(fleet, 0, 0)) if as_json else show_fleet(fleet)
        leave(fleet.refused)
    elif engine and as_json:
        print_json("calibrate", engine)
    elif engine:
        print("\n\n".join(table(*part) for part in calibration_tables(engine)))
