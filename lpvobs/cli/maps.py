"""The engine and the map: `lpvobs calibrate`, `lpvobs estimate`, `lpvobs extrapolate`."""

from pathlib import Path

import lpvobs
from lpvobs.cli import options
from lpvobs.cli.common import chosen_config, leave, print_json, progress, say, table
from lpvobs.cli.options import CONFIG, GAIN, JOBS, JSON, LOGS, OWN_ENGINE, SCHEDULER, argument, flag, needed, option

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
        "--bench",
    ),
    healthy: list[Path] | None = option("LOG", "A log from a day on which the MAF sensor was in order.", "--healthy"),
    reference: list[Path] | None = option(
        "LOG",
        "A log with the extra channel W_reference, the air flow from a reference meter in the same air path.",
        "--reference",
    ),
    maps: list[str] | None = option(
        "KIND=FILE",
        "The map of one component, such as compressor=FILE: Parquet, CSV with the units in the second line, or FILE.dcm:LABEL. "
        "A map in corrected quantities needs T_reference and p_reference.",
        "--map",
    ),
    gain: Path | None = option(
        "GAIN.h5",
        "An observer gain made by synth-gain, used for logs only. Without it, the command makes and proves a gain first.",
    ),
    plan: bool = flag(
        "--plan",
        "List the further bench points that would reduce the uncertainty of the air flow most. Works without data, too.",
    ),
    config: Path | None = CONFIG,
    as_json: bool = JSON,
) -> None:
    """Find an engine's constants and the corrections of its component models. `estimate --engine` starts from them.

    Each of --bench, --healthy, --reference and --map can be given several times. The search starts from the constants and
    tolerances of the configuration.

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
        say(
            f"uncertainty of the air flow before the planned points: {before:.2g} % rms over the engine's stationary points"
        )


def estimate(
    logs: list[Path] = LOGS,
    out: Path = needed("RESULT.h5", "The result to write."),
    gain: Path | None = GAIN,
    engine: Path | None = OWN_ENGINE,
    method: str = option(
        "NAME",
        "The estimator: observer; published, the observer with the paper's map gain Gamma = 200 I; ekf, a Kalman filter; batch, "
        "least squares.",
        offers=options.METHODS,
        default="observer",
    ),
    constants: str | None = option("NAME", WITH_OR_WITHOUT, offers=options.CONSTANTS),
    jobs: int | None = JOBS,
    scheduler: str | None = SCHEDULER,
    verbose: bool = flag("--verbose", f"Print a row for each log even if there are more than {MOST_ROWS}."),
    config: Path | None = CONFIG,
    as_json: bool = JSON,
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
    as_json: bool = JSON,
) -> None:
    """Fill the map nodes that no log visited, and give a 90 % interval for each.

    Example: lpvobs extrapolate nedc.h5
    """
    from lpvobs.api.extrapolate import ExtrapolateOutput, fill, half_widths
    from lpvobs.report.outputs import quadratic_fields
    from lpvobs.report.tables import beside_paper, coefficient_tables, grams, percent

    stored, fitted, held = fill(result, method, smooth)
    half = half_widths(fitted)
    if as_json:
        filled = quadratic_fields(fitted)
        print_json(
            "extrapolate", ExtrapolateOutput(result=str(result), outer_coverage=held, half_widths=half, **filled)
        )
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
