"""`lpvobs simulate`."""

from pathlib import Path
from typing import Annotated

import typer

from lpvobs.cli.common import chosen_config, guarded, print_json, progress, say
from lpvobs.cli.options import CYCLES, ConfigOption, JsonOption, file_option, offer


@guarded
def simulate(
    cycle: Annotated[
        str,
        typer.Option(
            metavar="NAME|CSV",
            autocompletion=offer(CYCLES),
            help="etc (surrogate), etc_part1, ftp75, ftp75_cold, nedc, whtc, wltc, or your own table.",
        ),
    ],
    out: Annotated[Path, file_option("LOG.parquet", "The log to write.")],
    effects: Annotated[
        Path | None,
        file_option(
            "TOML",
            "What is wrong with engine or sensors, and a drive on the road: an example of each in configs/effects; "
            "another error surface: configs/surfaces.",
        ),
    ] = None,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Samples per second.")] = 100.0,
    seed: Annotated[int, typer.Option(help="Of sensor noise and road; same seed, same bytes.")] = 1,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Drive the nonlinear engine over a cycle and record a log with its true error.

    Example: lpvobs simulate --config configs/diesel.toml --cycle nedc --out nedc.parquet

    With a leak: add --effects configs/effects/leak_intake.toml
    """
    from lpvobs.api.simulate import SimulateOutput
    from lpvobs.api.simulate import simulate as drive

    config = chosen_config(config)
    with progress(f"simulating {cycle}") as report:
        log = drive(config, cycle, out, effects=effects, rate=rate, seed=seed, progress=report)
    time = log.channels["time"]
    duration = float(time[-1] - time[0])
    if as_json:
        driven = SimulateOutput(log=str(out), samples=time.size, duration=duration, channels=tuple(log.channels))
        print_json("simulate", driven)
    else:
        say(f"{out}: {time.size} samples, {duration:.0f} s")
