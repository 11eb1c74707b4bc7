"""The engine and the map: `lpvobs calibrate`, `lpvobs estimate`, `lpvobs extrapolate`, `lpvobs export`."""

from functools import partial
from pathlib import Path

import lpvobs
from lpvobs.cli import options
from lpvobs.cli.common import chosen_config, leave, print_json, progress, say, table
from lpvobs.cli.options import argument, flag, needed, option
from lpvobs.errors import UsageError

WITH_OR_WITHOUT = (
    "joint: estimate the engine's constants and corrections together with the map; consider: keep them as configured and widen "
    "the map's intervals by their tolerances. By default the configuration decides."
)
MOST_ROWS = 12
"""Logs that are shown one by one; of more, a summary and the unusual ones."""
MOST_LINES = 5
"""Doubts that are shown; of a fleet with a wrong constant every log has one."""
HOW = "kriging: the quadratic of Eq. (37) plus the deviations from it; quadratic: Eq. (37) alone, as in the paper."


def calibrate(
    out: Path = needed("ENGINE.h5", "The engine file to write."),
    bench: list[Path] | None = option(
        "TABLE",
        "Stationary bench points with the reference air flow W_reference: Parquet, or CSV with the units in the second line.",
    ),
    healthy: list[Path] | None = option("LOG", "A log from a day on which the MAF sensor was in order."),
    reference: list[Path] | None = option(
        "LOG", "A log with the extra channel W_reference, the air flow from a reference meter in the same air path."
    ),
    maps: list[str] | None = option(
        "KIND=FILE",
        "The map of one component, such as compressor=FILE: Parquet, CSV with the units in the second line, or FILE.dcm:LABEL. "
        "A map in corrected quantities needs T_reference and p_reference.",
        "--map",
    ),
    gain: Path | None = options.GAIN,
    plan: bool = flag(
        "--plan",
        "List the further bench points that would reduce the uncertainty of the air flow most. Works without data, too.",
    ),
    config: Path | None = options.CONFIG,
    as_json: bool = options.JSON,
) -> None:
    """Find an engine's constants and component corrections from bench points and logs with a healthy MAF sensor.

    `estimate --engine` starts from them. Each of --bench, --healthy, --reference and --map can be given several times. The search
    starts from the constants and tolerances of the configuration.

    Example: lpvobs calibrate --config configs/diesel.toml --bench bench.csv --out engine.h5
    """
    from lpvobs.api.calibrate import plan_bench
    from lpvobs.report.engines import calibration_tables, told

    config = chosen_config(config)
    with progress("calibrating") as report:
        stored = lpvobs.calibrate(
            config, bench=bench or (), healthy=healthy or (), reference=reference or (), maps=maps or (), out=out, gain=gain,
            prior=plan, progress=report,
        )  # fmt: skip
    with progress("planning") as report:
        found = told(stored, str(out), plan_bench(config, out, progress=report) if plan else ())
    if as_json:
        print_json("calibrate", found)
        return
    print("\n\n".join(table(*part) for part in calibration_tables(found)))
    by_data = [name for name, item in found.constants.items() if item.determined]
    by_prior = [name for name, item in found.constants.items() if not item.determined]
    if found.constants:
        say(f"constants that the data determined: {', '.join(by_data) or 'none'}")
        say(
            "constants that the data hardly determined (at least half of the configured tolerance is left): "
            f"{', '.join(by_prior) or 'none'}"
        )
    points = f", {found.points} bench points" if found.points else ""
    say(f"{out}: engine made from {', '.join(found.inputs) or 'the configuration alone'}{points}")
    if found.plan:
        before = 100 * found.plan[0].before
        say(f"uncertainty of the air flow before the planned points: {before:.2g} % rms over all stationary points")


def estimate(
    logs: list[Path] = options.LOGS,
    out: Path = needed("RESULT.h5", "The result to write."),
    gain: Path | None = options.GAIN,
    engine: Path | None = options.OWN_ENGINE,
    method: str = option(
        "NAME",
        "The estimator: observer; published, the observer with the paper's map gain Gamma = 200 I; ekf, a Kalman filter; batch, "
        "least squares.",
        offers=options.METHODS,
        default="observer",
    ),
    constants: str | None = option("NAME", WITH_OR_WITHOUT, offers=options.CONSTANTS),
    jobs: int | None = options.JOBS,
    scheduler: str | None = options.SCHEDULER,
    verbose: bool = flag("--verbose", f"Print a row for each log even if there are more than {MOST_ROWS}."),
    config: Path | None = options.CONFIG,
    as_json: bool = options.JSON,
) -> None:
    """Estimate the error map of the mass air flow sensor from logs.

    With several logs, RESULT.h5.parts keeps the finished logs until RESULT.h5 is written. If a run is killed, the same command
    continues from there.

    Example: lpvobs estimate --config configs/diesel.toml --gain gain.h5 nedc.parquet --out nedc.h5
    """
    from lpvobs.api.estimate import EngineUsed, EstimateOutput, NodeCounts
    from lpvobs.report.outputs import LogOutput, log_fields
    from lpvobs.report.tables import agreement_rows, log_rows, many_lines, told, unusual

    config = chosen_config(config)
    with progress("estimating") as report:
        done = lpvobs.estimate(
            config, logs, out, gain=gain, engine=engine, method=method, constants=constants, jobs=jobs, scheduler=scheduler,
            progress=report,
        )  # fmt: skip
    found, summaries = done.estimate, done.summaries
    nodes = int(found.supported.sum())
    if as_json:
        content = EstimateOutput(
            result=str(out),
            method=found.method,
            headline=done.headline,
            logs=[LogOutput(**log_fields(log)) for log in summaries],
            refused=done.refused,
            map=NodeCounts(nodes=found.grid.size, estimated=nodes),
            scatter=done.scatter,
            agreement=done.agreement,
            balance_agreement=done.doubts.agreement,
            engine=EngineUsed(source=str(done.engine or "configuration"), calibrated=done.engine is not None),
            along_flow=found.along_flow,
            doubts=done.doubts.says,
        )
        print_json("estimate", content)
    else:
        agreement = done.agreement
        if len(summaries) > MOST_ROWS and not verbose:
            print(many_lines(summaries, agreement, len(done.refused), done.reused) + "\n")
            summaries = tuple(unusual(summaries, agreement))
            agreement = tuple(item for item in agreement if item.disagrees)
        elif done.reused:
            say(f"{done.reused} logs were finished by an earlier run and are not processed again")
        if summaries:
            print(table(*told(log_rows(summaries))))
        if agreement:
            print("\n" + table(*told(agreement_rows(agreement))))
        if done.agreement:
            say(f"the maps of single logs scatter by {1e3 * done.scatter:.3g} g/s per node more than noise explains")
        say(f"{out}: {nodes} of {found.grid.size} nodes estimated by method {found.method}")
        say(f"{done.headline}; next: lpvobs extrapolate {out}")
    for item in done.agreement:
        if item.disagrees:
            by = f"{1e3 * item.mean_difference:+.3g} g/s on average"
            say(f"lpvobs: log {item.name}: its map differs from the map of all logs by {by}")
    for line in done.doubts.says[:MOST_LINES]:
        say(f"lpvobs: {line}")
    if len(done.doubts.says) > MOST_LINES:
        say(f"lpvobs: and {len(done.doubts.says) - MOST_LINES} more warnings; --json prints all of them")
    leave(done.refused)


def extrapolate(
    result: Path = argument(
        "RESULT.h5", "A result of estimate. The filled map is written into this file as /extrapolation."
    ),
    method: str = option("NAME", HOW, offers=options.EXTRAPOLATIONS, default="kriging"),
    smooth: bool = flag(
        "--smooth",
        "Replace the estimated nodes in /extrapolation by smoothed values, too, and mark them there as smoothed.",
    ),
    as_json: bool = options.JSON,
) -> None:
    """Fill the map nodes that no log visited. Each of them gets a 90 % interval.

    Example: lpvobs extrapolate nedc.h5
    """
    from lpvobs.api.extrapolate import ExtrapolateOutput, fill, half_widths
    from lpvobs.report.outputs import quadratic_fields
    from lpvobs.report.tables import beside_paper, coefficient_tables, grams, percent

    stored, fitted, held = fill(result, method, smooth)
    half = half_widths(fitted)
    if as_json:
        made = ExtrapolateOutput(result=str(result), outer_coverage=held, half_widths=half, **quadratic_fields(fitted))
        print_json("extrapolate", made)
        return
    for coefficients in coefficient_tables(mine := [("this map", stored)], beside_paper(mine)):
        print(table(*coefficients))
    more = f", {fitted.nodes} smoothed" if smooth else ""
    say(
        f"check: {percent(held, 0)} of the outer estimated nodes lie inside the 90 % interval predicted from the other nodes"
    )
    say(f"{result}: {int((fitted.support == 2).sum())} nodes filled by {fitted.method}{more}")
    if half is not None:
        say(f"90 % intervals of the filled nodes: +-{grams(half[0])} g/s in the median, +-{grams(half[1])} g/s at most")


WHAT = "dcm, cdfx, csv or netcdf: the map; lab: a label list for INCA; c99 or fmu: the observer for a control unit."


def export(
    result: Path = argument("RESULT.h5", "A result of estimate. For c99 and fmu: an observer gain made by synth-gain."),
    file_format: str = needed("FORMAT", WHAT, "--format", offers=options.FORMATS),
    out: Path = needed("FILE", "The file to write. For c99: the folder to write."),
    start: Path | None = argument(
        "[RESULT.h5]", "For c99 and fmu: a result of estimate. The observer starts with its map and engine."
    ),
    source: str = option(
        "GROUP",
        "Which values to export: map or extrapolation. By default extrapolation if the result has one, else map.",
        "--values",
        default="",
    ),
    only_estimated: bool = flag(
        "--only-estimated", "Export estimated nodes only. Other nodes keep their value from --old, or stay empty."
    ),
    old: Path | None = option(
        "OLD.dcm", "A DCM with the old map. The export keeps its axes, units and kind of map, and lists the changes."
    ),
    name: str = option("LABEL", "Label of the map, in the exported file and in the old one.", default="delta_W_c"),
    a2l: Path | None = option(
        "FILE.a2l",
        "The control unit's A2L description, from which axes, units, limits and rounding of the map are taken. Needs lpvobs[a2l].",
    ),
    unit: str = option(
        "UNIT",
        "Unit of the values: a flow such as kg/h, mg/stroke, % of the reading, or factor: truth is reading times factor.",
        offers=options.UNITS,
        default="",
    ),
    kind: str = option(
        "KIND",
        "Kind of map in a DCM: KENNFELD or GRUPPENKENNFELD. By default the kind of the old map, else KENNFELD.",
        default="",
    ),
    digits: int = option("N", "Significant digits of the numbers in dcm and csv.", default=7),
    engine: Path | None = options.ENGINE,
    map_gain: str = option(
        "GAIN",
        "For c99 and fmu: whether the map gain Gamma is constant or falls with the time driven. By default it falls, if the "
        "observer gain is proven for a falling Gamma.",
        offers=options.MAP_GAINS,
        default="",
    ),
    rate: float = option(
        "HZ", "For c99 and fmu: the highest sample rate of the signals, in samples per second.", default=100.0
    ),
    widest: float = option(
        "SHARE",
        "Leave out nodes whose 90 % interval has a half-width above this share of the logs' mean air flow.",
        default=0.1,
    ),
    as_json: bool = options.JSON,
) -> None:
    """Write the map for calibration tools (DCM, CSV, netCDF), or the observer for a control unit (C99, FMU).

    With --old, the command lists the changes against an old DCM.

    Example: lpvobs export nedc.h5 --format dcm --out maf.dcm --only-estimated --old ecu.dcm --name delta_W_c;
    lpvobs export gain.h5 nedc.h5 --format c99 --out unit
    """
    from lpvobs.api.export import export as export_map
    from lpvobs.api.export_unit import FORMATS as OBSERVERS
    from lpvobs.api.export_unit import ExportOutput, export_unit
    from lpvobs.report.tables import change_rows, grams, origin_counts

    file_format = file_format.lower()
    said = partial(ExportOutput, out=str(out), format=file_format)
    if file_format in OBSERVERS:
        made = export_unit(result, out, file_format, result=start, engine=engine, map_gain=map_gain, rate=rate)
        if as_json:
            print_json("export", said(values=made.start, digits=17, nodes={}, changes=None, widest=None, unit=made))
            return
        for number, size in made.bytes_of_state.items():
            pivot = made.smallest_pivot[number]
            print(
                f"{number}: state {size} bytes; Theorem 1 proven again for the rounded gain, smallest pivot {pivot:.3g}"
            )
        say(
            f"{out}: the observer with {made.map_gain} map gain; its output lags by {made.delay:g} s and up to two samples"
        )
        return
    if start is not None or engine is not None or map_gain:
        raise UsageError(
            f"--format {file_format}: expected one result alone; drop the second result, --engine and --map-gain, which only "
            f"{' and '.join(OBSERVERS)} take"
        )

    done = export_map(
        result, out, file_format, values=source, only_estimated=only_estimated, old=old, name=name, kind=kind, digits=digits,
        widest=widest, unit=unit, a2l=a2l,
    )  # fmt: skip
    counts = origin_counts(done.surface)
    if as_json:
        where, changed = done.surface.source, done.changes
        told = said(values=where, digits=digits, nodes=counts, changes=changed, widest=done.widest, unit=None)
        print_json("export", told)
        return
    if done.changes:
        print(table(*change_rows(done.surface, done.changes)))
    if done.changes is not None:
        say(f"{len(done.changes)} of {done.surface.origin.size} nodes differ from {old}")
    if file_format == "lab":
        say(f"{out}: a list of the label {name} and the channels that a log needs")
        return
    say(f"{out}: {', '.join(f'{count} {origin}' for origin, count in counts.items())}")
    if left := counts.get("left_out", 0):
        say(
            f"{left} nodes left out, because their 90 % interval is wider than +-{grams(done.widest)} g/s; --widest sets this limit"
        )
    if done.limited:
        say(f"{done.limited} values were clipped to the limits of the control unit")
