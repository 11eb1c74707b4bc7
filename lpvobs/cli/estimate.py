"""`lpvobs estimate`."""

from pathlib import Path
from typing import Annotated

import typer

from lpvobs.cli.common import ConfigOption, JsonOption, guarded, print_json, progress, say, table


@guarded
def estimate(
    config: ConfigOption,
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Parquet logs.")],
    out: Annotated[Path, typer.Option(metavar="RESULT.h5", help="The result to write.")],
    gain: Annotated[
        Path | None,
        typer.Option(metavar="GAIN.h5", help="A gain made by synth-gain; without it, one is made and proven first."),
    ] = None,
    method: Annotated[
        str, typer.Option(metavar="NAME", help="observer, or published: Gamma = 200 I as in the paper.")
    ] = "observer",
    as_json: JsonOption = False,
) -> None:
    """Estimate the error map of the sensor from logs.

    Example: lpvobs estimate --config configs/diesel.toml --gain gain.h5 nedc.parquet --out nedc.h5
    """
    from lpvobs.io.config import load_config
    from lpvobs.io.gains import expect_engine, read_gain
    from lpvobs.report.tables import log_rows, logs_content
    from lpvobs.steps.estimate import estimate_logs

    configuration, text = load_config(config)
    if gain is None:
        from lpvobs.steps.gain import make_gain

        stored, _ = make_gain(configuration, logs)
    else:
        stored = read_gain(gain)
        air_path = configuration.engine_path()
        expect_engine(gain, stored, air_path.name, air_path.engine_constants())
    with progress("estimating") as report:
        found, summaries = estimate_logs(configuration, text, stored, logs, out, method, report)
    nodes = int(found.supported.sum())
    if as_json:
        content = {
            "result": str(out),
            "method": found.method,
            "logs": logs_content(summaries),
            "map": {"nodes": found.grid.size, "estimated": nodes},
        }
        print_json("estimate", content)
        return
    print(table(*log_rows(summaries)))
    say(f"{out}: {nodes} of {found.grid.size} nodes estimated by method {found.method}")
