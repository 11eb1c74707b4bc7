"""`lpvobs estimate`."""

from pathlib import Path
from typing import Annotated

import typer

from lpvobs.cli.common import ConfigOption, JsonOption, guarded, print_json, progress, refuse_overwriting, say, table


@guarded
def estimate(
    config: ConfigOption,
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Parquet logs.")],
    out: Annotated[Path, typer.Option(metavar="RESULT.h5", help="The result to write.")],
    gain: Annotated[
        Path | None,
        typer.Option(
            metavar="GAIN.h5",
            help="A gain made by synth-gain; without it, one is made and proven first.",
        ),
    ] = None,
    method: Annotated[
        str, typer.Option(metavar="NAME", help="observer; published: Gamma = 200 I as in the paper; ekf; batch.")
    ] = "observer",
    as_json: JsonOption = False,
) -> None:
    """Estimate the error map of the sensor from logs.

    Example: lpvobs estimate --config configs/diesel.toml --gain gain.h5 nedc.parquet --out nedc.h5
    """
    from lpvobs.errors import DataError
    from lpvobs.io.config import load_config
    from lpvobs.report.tables import log_rows, logs_content
    from lpvobs.steps.estimate import estimate_logs, gain_for

    refuse_overwriting(out, [config, *logs, *([gain] if gain else [])])
    configuration, text = load_config(config)
    stored = gain_for(configuration, logs, gain, method)
    with progress("estimating") as report:
        found, summaries, refused = estimate_logs(configuration, text, stored, logs, out, method, report)
    nodes = int(found.supported.sum())
    if as_json:
        content = {
            "result": str(out),
            "method": found.method,
            "logs": logs_content(summaries),
            "refused": refused,
            "map": {"nodes": found.grid.size, "estimated": nodes},
        }
        print_json("estimate", content)
    else:
        print(table(*log_rows(summaries)))
        say(f"{out}: {nodes} of {found.grid.size} nodes estimated by method {found.method}")
    for message in refused:
        say(f"lpvobs: left out: {message}")
    if refused:
        raise typer.Exit(DataError.exit_code)
