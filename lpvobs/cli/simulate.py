"""`lpvobs simulate`."""

from pathlib import Path

from lpvobs.cli.common import chosen_config, guarded, print_json, progress, say
from lpvobs.cli.options import CONFIG, CYCLES, DATE, JSON, VEHICLE, needed, option
from lpvobs.errors import UsageError


@guarded
def simulate(
    out: Path = needed("FILE", "The log or table to write."),
    cycle: str | None = option(
        "NAME|CSV",
        "The drive cycle: etc (a surrogate), etc_part1, ftp75, ftp75_cold, nedc, whtc, wltc, or your own cycle as a CSV file.",
        offers=CYCLES,
    ),
    bench: int | None = option(
        "N",
        "Simulate N stationary bench points instead of a cycle. The table is CSV if FILE ends in .csv, else Parquet.",
    ),
    effects: Path | None = option(
        "TOML",
        "File with faults of engine and sensors, road conditions, or another map of the sensor error. Examples are in "
        "configs/effects and configs/surfaces.",
    ),
    engine: Path | None = option(
        "ENGINE.h5",
        "An engine made by calibrate with the same configuration as --config. The simulation uses its constants.",
    ),
    rate: float | None = option("HZ", "Samples per second.", show_default="100"),
    seed: int = option(
        "N",
        "Seed of the random noise, road and bench points. The same seed gives the same file, byte for byte.",
        default=1,
    ),
    vehicle: str | None = VEHICLE,
    date: str | None = DATE,
    config: Path | None = CONFIG,
    as_json: bool = JSON,
) -> None:
    """Simulate the nonlinear engine model over a drive cycle and write a log that includes the true sensor error.

    Example: lpvobs simulate --config configs/diesel.toml --cycle nedc --out nedc.parquet

    With a leak: add --effects configs/effects/leak_intake.toml

    A bench table: lpvobs simulate --config configs/diesel.toml --bench 100 --out bench.csv
    """
    from lpvobs.api.simulate import SimulateOutput, simulate_bench
    from lpvobs.api.simulate import simulate as drive

    config = chosen_config(config)
    if bench is not None:
        of_cycle = {"--cycle": cycle, "--effects": effects, "--rate": rate, "--vehicle": vehicle, "--date": date}
        if given := [name for name, value in of_cycle.items() if value is not None]:
            raise UsageError(f"--bench: simulates stationary points, not a cycle; drop {' and '.join(given)}")
        with progress(f"simulating {bench} points") as report:
            points = simulate_bench(config, bench, out, seed=seed, engine=engine, progress=report)
        channels, samples, duration, told = tuple(points.channels), bench, points.duration, f"{bench} stationary points"
    elif cycle is None:
        raise UsageError("neither --cycle nor --bench is given; name a cycle, or the number of stationary points")
    else:
        with progress(f"simulating {cycle}") as report:
            speed = 100.0 if rate is None else rate
            log = drive(
                config, cycle, out, effects=effects, engine=engine, rate=speed, seed=seed, vehicle=vehicle, date=date,
                progress=report,
            )  # fmt: skip
        time = log.channels["time"]
        channels, samples, duration = tuple(log.channels), time.size, float(time[-1] - time[0])
        told = f"{samples} samples, {duration:.0f} s"
    if as_json:
        made = SimulateOutput(log=str(out), samples=samples, duration=duration, channels=channels)
        print_json("simulate", made)
    else:
        say(f"{out}: {told}")
