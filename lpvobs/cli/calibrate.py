"""`lpvobs calibrate`."""

from pathlib import Path

import lpvobs
from lpvobs.cli.common import chosen_config, guarded, print_json, progress, say, table
from lpvobs.cli.options import CONFIG, JSON, flag, needed, option


@guarded
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
