"""`lpvobs simulate`."""

from pathlib import Path
from typing import Annotated

import typer

from lpvobs.cli.choices import CYCLES, offer
from lpvobs.cli.common import (
    ConfigOption,
    JsonOption,
    chosen_config,
    guarded,
    print_json,
    progress,
    refuse_overwriting,
    say,
)


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
    out: Annotated[Path, typer.Option(metavar="LOG.parquet", help="The log to write.")],
    effects: Annotated[
        Path | None,
        typer.Option(
            metavar="TOML",
            help="What is wrong with engine or sensors, and a drive on the road: an example of each in configs/effects; "
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
    from lpvobs.errors import UsageError
    from lpvobs.io.config import Effects, load_config, load_effects
    from lpvobs.io.logs import write_log
    from lpvobs.simulation.simulate import simulate as drive

    config = chosen_config(config)
    refuse_overwriting(out, [path for path in (config, effects, Path(cycle)) if path is not None])
    configuration, _ = load_config(config)
    if configuration.simulation is None:
        raise UsageError(f"{config}: has no [simulation] tables; simulate needs them, see configs/diesel.toml")
    wanted = load_effects(effects)[0] if effects else Effects()
    with progress(f"simulating {cycle}") as report:
        log = drive(
            configuration.diesel,
            configuration.simulation,
            cycle,
            rate,
            seed,
            wanted.surface,
            report,
            effects=wanted.injected,
            auxiliary=wanted.auxiliary,
        )
    write_log(out, log.channels, log.units)
    time = log.channels["time"]
    content = {
        "log": str(out),
        "samples": time.size,
        "duration": float(time[-1] - time[0]),
        "channels": list(log.channels),
    }
    if as_json:
        print_json("simulate", content)
    else:
        say(f"{out}: {time.size} samples, {content['duration']:.0f} s")
