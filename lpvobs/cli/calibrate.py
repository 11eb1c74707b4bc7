"""`lpvobs calibrate`."""

from pathlib import Path

from lpvobs.cli.common import chosen_config, guarded, print_json, progress, say, table
from lpvobs.cli.options import CONFIG, JSON, flag, needed, option


@guarded
def calibrate(
    out: Path = needed("ENGINE.h5", "The engine file to write."),
    bench: list[Path] | None = option(
        "TABLE", "Stationary points with W_reference: CSV with a second line of units, or Parquet.", "--bench"
    ),
    healthy: list[Path] | None = option("LOG", "A log whose air flow sensor reads right.", "--healthy"),
    reference: list[Path] | None = option(
        "LOG", "A log that also has W_reference, the flow from a reference meter in the same air path.", "--reference"
    ),
    maps: list[str] | None = option(
        "KIND=FILE",
        "The map of one component: CSV with a second line of units, Parquet, or FILE.dcm:LABEL. A compressor's map states "
        "T_reference and p_reference.",
        "--map",
    ),
    gain: Path | None = option(
        "GAIN.h5", "A gain made by synth-gain, for calibrating from logs. By default a gain is made and proven first."
    ),
    plan: bool = flag("--plan", "Say which further bench points would help most; needs no data yet."),
    config: Path | None = CONFIG,
    as_json: bool = JSON,
) -> None:
    """Find an engine's constants and the corrections of its components. `estimate` then starts from these.

    Each of --bench, --healthy, --reference and --map can be given several times. The search starts from the constants and
    tolerances of the configuration.

    Example: lpvobs calibrate --config configs/diesel.toml --bench bench.csv --out engine.h5
    """
    from lpvobs.api.calibrate import calibrate as find_engine
    from lpvobs.api.calibrate import plan_bench
    from lpvobs.report.engines import calibration_tables, told

    config = chosen_config(config)
    with progress("calibrating") as report:
        stored = find_engine(
            config,
            bench=bench or (),
            healthy=healthy or (),
            reference=reference or (),
            maps=maps or (),
            out=out,
            gain=gain,
            prior=plan,
            progress=report,
        )
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
            "constants that the data did not determine, so the configuration's value and tolerance stay: "
            f"{', '.join(by_prior) or 'none'}"
        )
    points = f", {found.points} bench points" if found.points else ""
    say(f"{out}: engine from {', '.join(found.inputs) or 'the configuration alone'}{points}")
    if found.plan:
        before = 100 * found.plan[0].before
        say(f"the air flow is uncertain by {before:.2g} % now, over all stationary points of the engine")
