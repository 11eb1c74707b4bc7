"""Where logs come from, and what is in them: `lpvobs simulate`, `lpvobs ingest`, `lpvobs profile`, `lpvobs inspect`."""

from pathlib import Path
from typing import TYPE_CHECKING

import lpvobs
from lpvobs.cli.common import chosen_config, folder_config, leave, print_json, progress, say, table, visible
from lpvobs.cli.options import CONFIG, CYCLES, DATE, JSON, LOGS, OWN_ENGINE, PROFILES, VEHICLE, argument, needed, option
from lpvobs.errors import UsageError

if TYPE_CHECKING:
    from lpvobs.api.inspect import InspectedLog


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
    engine: Path | None = OWN_ENGINE,
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
    """Simulate the nonlinear engine model over a drive cycle and write a log. The log includes the true sensor error.

    Example: lpvobs simulate --config configs/diesel.toml --cycle nedc --out nedc.parquet

    With a leak: add --effects configs/effects/leak_intake.toml

    A bench table: lpvobs simulate --config configs/diesel.toml --bench 100 --out bench.csv
    """
    from lpvobs.api.simulate import SimulateOutput

    config = chosen_config(config)
    if bench is not None:
        of_cycle = {"--cycle": cycle, "--effects": effects, "--rate": rate, "--vehicle": vehicle, "--date": date}
        if given := [name for name, value in of_cycle.items() if value is not None]:
            raise UsageError(f"--bench: simulates stationary points, not a cycle; drop {' and '.join(given)}")
        with progress(f"simulating {bench} points") as report:
            points = lpvobs.simulate_bench(config, bench, out, seed=seed, engine=engine, progress=report)
        channels, samples, duration, told = tuple(points.channels), bench, points.duration, f"{bench} stationary points"
    elif cycle is None:
        raise UsageError("neither --cycle nor --bench is given; name a cycle, or the number of stationary points")
    else:
        with progress(f"simulating {cycle}") as report:
            speed = 100.0 if rate is None else rate
            log = lpvobs.simulate(
                config, cycle, out, effects=effects, engine=engine, rate=speed, seed=seed, vehicle=vehicle, date=date,
                progress=report,
            )  # fmt: skip
        time = log.channels["time"]
        channels, samples, duration = tuple(log.channels), time.size, float(time[-1] - time[0])
        told = f"{samples} samples, {duration:.0f} s"
    if as_json:
        print_json("simulate", SimulateOutput(log=str(out), samples=samples, duration=duration, channels=channels))
    else:
        say(f"{out}: {told}")


def ingest(
    sources: list[Path] = argument(
        "SOURCE...",
        "Files of one drive: CSV, Parquet, MAT or MDF4. The time stamps of all files must come from the same clock.",
    ),
    profile: str = needed(
        "NAME|TOML",
        "The profile of the recording: liu-ice, kit-obd, or a file drafted by `lpvobs profile`.",
        offers=PROFILES,
    ),
    out: Path = needed("LOG.parquet", "The log to write."),
    vehicle: str | None = VEHICLE,
    date: str | None = DATE,
    as_json: bool = JSON,
) -> None:
    """Convert a recording of another tool (CSV, Parquet, MAT, MDF4) into a log.

    A profile states the recording's channel names, units, time and raster. The command counts and prints every repair.

    Example: lpvobs ingest wltp_NF.csv --profile liu-ice --out wltp_NF.parquet
    """
    from lpvobs.report.tables import ingest_notes, ingest_rows

    record = lpvobs.ingest_log(sources, profile, out, vehicle=vehicle, date=date)
    if as_json:
        print_json("ingest", {"log": str(out), **record})
        return
    print("\n".join([*ingest_notes(record), table(*ingest_rows(record))]))
    say(f"{out}: {record['raster']['samples']} samples; `lpvobs inspect` prints this table again")


def profile(
    source: Path = argument("SOURCE", "The recording: a CSV, Parquet, MAT or MDF4 file."),
    out: Path | None = option("TOML", "The profile file to write. Without this option, the profile is printed."),
    names: Path | None = option(
        "FILE",
        "A table of your own channel names, which has priority: CSV or INCA .lab with lines of the form label;channel.",
    ),
    as_json: bool = JSON,
) -> None:
    """Draft the profile that ingest needs from the channels of a recording.

    It goes by their names, units and value ranges. In the profile, doubtful channels are commented out.

    Example: lpvobs profile drive.mf4 --out mine.toml
    """
    from lpvobs.api.ingest_log import ProfileOutput

    text = lpvobs.draft_profile(source, out, names)
    if out is not None:
        say(
            f"{out}: check this profile, uncomment the lines that are right, then run: lpvobs ingest {source} --profile "
            f"{out} --out LOG.parquet"
        )
    if as_json:
        profile = None if out is None else str(out)
        print_json("profile", ProfileOutput(source=str(source), profile=profile, text=text))
    elif out is None:
        print(text, end="")


def inspect(
    logs: list[Path] = LOGS,
    config: Path | None = option(
        "TOML",
        "The configuration: engine and treatment of defects. By default lpvobs.toml in this folder or a folder above, else the "
        "first engine whose channels the log has.",
    ),
    as_json: bool = JSON,
) -> None:
    """Show the channels, units, value ranges and defects of logs. It also shows sample rate and gaps, and how defects were treated.

    For a result or an engine, inspect prints the same as `report`. Example: lpvobs inspect nedc.parquet
    """
    if logs[0].suffix == ".h5":
        from lpvobs.cli.results import report

        return report(logs[0], logs[1:], None, None, None, None, list_metrics=False, as_json=as_json)
    from lpvobs.api.inspect import inspect_logs

    found = inspect_logs(logs, config or folder_config())
    if as_json:
        print_json("inspect", found)
    else:
        print("\n\n".join(map(_text, found.logs)))
    return leave(found.refused)


def _text(found: "InspectedLog") -> str:
    from msgspec import UNSET

    from lpvobs.api.inspect import meanings

    head = (
        f"{found.log}: {found.samples} of {found.samples_read} samples used, {found.duration:.1f} s at "
        f"{found.rate:.4g} Hz, {found.gaps} gaps, {found.repeated} samples with repeated or backward time"
    )
    rows = []
    for name, item in found.channels.items():
        values = [f"{value:.6g}" for value in (item.min, item.median, item.max)]
        often = "-" if item.refresh != item.refresh else f"{item.refresh:.4g}"
        rows.append([name, item.unit, item.use, *values, often, str(item.dropped)])
    parts = [visible(head), table(["channel", "unit", "use", "min", "median", "max", "changes [Hz]", "dropped"], rows)]
    if found.defects:
        begins = ["" if item.first is UNSET else f"{item.first:.6g} s" for item in found.defects]
        rows = [[x.defect, x.channel, str(x.count), at, x.policy] for x, at in zip(found.defects, begins, strict=True)]
        parts.append(table(["defect", "channel", "count", "first", "policy"], rows))
    if found.serves:
        parts.append(f"this log has all required channels of the engines: {', '.join(found.serves)}")
    for name, more in found.further.items():
        parts.append(f"engine '{name}': would also use, if the log had them: {meanings(name, more)}")
    if found.informs:
        rows = []
        for each in found.informs:
            which = "as logged" if each.channel is None else f"with {each.channel} ({each.supposed})"
            error = "-" if each.standard_error is None else f"{1e3 * each.standard_error:.3g}"
            rows.append([which, str(each.nodes), error])
        parts.append(table(["channels", "map nodes", "standard error [g/s]"], rows))
    for name, more in found.lacking.items():
        parts.append(f"engine '{name}': required channels missing in this log: {meanings(name, more)}")
    if found.ingest is not None:
        from lpvobs.report.tables import ingest_notes, ingest_rows

        parts += [*ingest_notes(found.ingest), table(*ingest_rows(found.ingest))]
    return "\n".join(parts)
