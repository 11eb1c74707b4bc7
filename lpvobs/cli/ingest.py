"""`lpvobs ingest`."""

from pathlib import Path

from lpvobs.cli.common import guarded, print_json, say, table
from lpvobs.cli.options import DATE, JSON, PROFILES, VEHICLE, argument, needed


@guarded
def ingest(
    sources: list[Path] = argument("SOURCE...", "CSV, Parquet, MAT or MDF4 files of one drive, on one clock."),
    profile: str = needed(
        "NAME|TOML", "liu-ice, kit-obd, or your own; `lpvobs profile SOURCE` drafts one.", offers=PROFILES
    ),
    out: Path = needed("LOG.parquet", "The log to write."),
    vehicle: str | None = VEHICLE,
    date: str | None = DATE,
    as_json: bool = JSON,
) -> None:
    """Make a log of a foreign recording: names, units, stamps and raster by a profile, every repair counted.

    Example: lpvobs ingest wltp_NF.csv --profile liu-ice --out wltp_NF.parquet
    """
    from lpvobs.api.ingest_log import ingest_log
    from lpvobs.report.tables import ingest_notes, ingest_rows

    record = ingest_log(sources, profile, out, vehicle=vehicle, date=date)
    if as_json:
        print_json("ingest", {"log": str(out), **record})
        return
    print("\n".join([*ingest_notes(record), table(*ingest_rows(record))]))
    say(f"{out}: {record['raster']['samples']} samples; `lpvobs inspect` shows this again")
