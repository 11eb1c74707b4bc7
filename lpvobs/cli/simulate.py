"""`lpvobs simulate`."""

from pathlib import Path
from typing import Annotated

import typer

from lpvobs.cli.common import chosen_config, guarded, print_json, progress, say
from lpvobs.cli.options import CYCLES, ConfigOption, JsonOption, file_option, offer
from lpvobs.errors import UsageError


@guarded
def simulate(
    out: Annotated[Path, file_option("FILE", "The log or table to write.")],
    cycle: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|CSV",
            autocompletion=offer(CYCLES),
            help="etc (surrogate), etc_part1, ftp75, ftp75_cold, nedc, whtc, wltc, or your own table.",
        ),
    ] = None,
    bench: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="No cycle but a table of N stationary points with a reference meter; FILE.csv: CSV, else Parquet.",
        ),
    ] = None,
    effects: Annotated[
        Path | None,
        file_option(
            "TOML",
            "What is wrong with engine or sensors, and a drive on the road: an example of each in configs/effects; "
            "another error surface: configs/surfaces.",
        ),
    ] = None,
    engine: Annotated[
        Path | None,
        file_option("ENGINE.h5", "An engine made by calibrate from the same configuration: its constants are driven."),
    ] = None,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Samples per second.", show_default="100")] = None,
    seed: Annotated[int, typer.Option(help="Of sensor noise, road, points; same seed, same bytes.")] = 1,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Drive the nonlinear engine over a cycle and record a log with its true error.

    Example: lpvobs simulate --config configs/diesel.toml --cycle nedc --out nedc.parquet

    With a leak: add --effects configs/effects/leak_intake.toml

    A bench table: lpvobs simulate --config configs/diesel.toml --bench 100 --out bench.csv
    """
    config = chosen_config(config)
    if bench is not None:
        _bench(
            config, bench, out, seed, engine, [name for name, given in _others(cycle, effects, rate) if given], as_json
        )
        return
    if cycle is None:
        raise UsageError("neither --cycle nor --bench; name a cycle, or how many stationary points")
    from lpvobs.api.simulate import SimulateOutput
    from lpvobs.api.simulate import simulate as drive

    with progress(f"simulating {cycle}") as report:
        speed = 100.0 if rate is None else rate
        log = drive(config, cycle, out, effects=effects, engine=engine, rate=speed, seed=seed, progress=report)
    time = log.channels["time"]
    duration = float(time[-1] - time[0])
    if as_json:
        driven = SimulateOutput(log=str(out), samples=time.size, duration=duration, channels=tuple(log.channels))
        print_json("simulate", driven)
    else:
        say(f"{out}: {time.size} samples, {duration:.0f} s")


def _others(cycle: str | None, effects: Path | None, rate: float | None) -> list[tuple[str, bool]]:
    """Return the options that belong to a cycle, and whether each was given."""
    return [("--cycle", cycle is not None), ("--effects", effects is not None), ("--rate", rate is not None)]


def _bench(
    config: Path, points: int, out: Path, seed: int, engine: Path | None, refused: list[str], as_json: bool
) -> None:
    """Write a bench table and say so; options of a cycle are refused."""
    from lpvobs.api.simulate import SimulateOutput
    from lpvobs.api.simulate_bench import simulate_bench

    if refused:
        raise UsageError(
            f"--bench goes without {' and '.join(refused)}: what belongs to a cycle has no place at rest; leave it out"
        )
    with progress(f"simulating {points} points") as report:
        table = simulate_bench(config, points, out, seed=seed, engine=engine, progress=report)
    if as_json:
        print_json(
            "simulate",
            SimulateOutput(log=str(out), samples=points, duration=table.duration, channels=tuple(table.channels)),
        )
    else:
        say(f"{out}: {points} stationary points")
