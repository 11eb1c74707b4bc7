"""`lpvobs ingest`."""

from pathlib import Path
from typing import Annotated

import typer

from lpvobs.cli.common import guarded, print_json, say, table
from lpvobs.cli.options import PROFILES, JsonOption, file_argument, file_option, offer


@guarded
def ingest(
    sources: Annotated[
        list[Path], file_argument("SOURCE...", "CSV, Parquet, MAT or MDF4 files of one drive, on one clock.")
    ],
    profile: Annotated[
        str,
        typer.Option(
            metavar="NAME|TOML",
            autocompletion=offer(PROFILES),
            help="liu-ice, kit-obd, or your own; `lpvobs profile SOURCE` drafts one.",
        ),
    ],
    out: Annotated[Path, file_option("LOG.parquet", "The log to write.")],
    as_json: JsonOption = False,
) -> None:
    """Make a log of a foreign recording: names, units, stamps and raster by a profile, every repair counted.

    Example: lpvobs ingest wltp_NF.csv --profile liu-ice --out wltp_NF.parquet
    """
    from lpvobs.api.ingest_log import ingest_log
    from lpvobs.report.tables import ingest_notes, ingest_rows

    record = ingest_log(sources, profile, out)
    if as_json:
        print_json("ingest", {"log": str(out), **record})
        return
    print("\n".join([*ingest_notes(record), table(*ingest_rows(record))]))
    say(f"{out}: {record['raster']['samples']} samples; `lpvobs inspect` shows this again")
