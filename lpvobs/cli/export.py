"""`lpvobs export`."""

from pathlib import Path
from typing import Annotated

import typer

from lpvobs.cli.common import guarded, print_json, say, table
from lpvobs.cli.options import FORMATS, JsonOption, file_argument, file_option, offer


@guarded
def export(
    result: Annotated[Path, file_argument("RESULT.h5", "A result of estimate.")],
    file_format: Annotated[
        str, typer.Option("--format", metavar="FORMAT", autocompletion=offer(FORMATS), help="dcm, csv or netcdf.")
    ],
    out: Annotated[Path, file_option("FILE", "The file to write.")],
    source: Annotated[
        str,
        typer.Option("--values", metavar="GROUP", help="map or extrapolation; by default the latter if there is one."),
    ] = "",
    only_estimated: Annotated[
        bool, typer.Option("--only-estimated", help="No extrapolated node: old values there, or nothing.")
    ] = False,
    old: Annotated[
        Path | None, file_option("OLD.dcm", "The map as it was: its axes, units and kind stay, changes are listed.")
    ] = None,
    name: Annotated[str, typer.Option(metavar="LABEL", help="Label of the map, also in the old file.")] = "delta_W_c",
    kind: Annotated[str, typer.Option(metavar="KIND", help="KENNFELD (default) or GRUPPENKENNFELD.")] = "",
    digits: Annotated[int, typer.Option(metavar="N", help="Significant digits in dcm and csv.")] = 7,
    as_json: JsonOption = False,
) -> None:
    """Write the map for calibration tools, and list what it changes against an old DCM.

    Example: lpvobs export nedc.h5 --format dcm --out maf.dcm --only-estimated --old ecu.dcm --name delta_W_c
    """
    from lpvobs.api.export import ExportOutput
    from lpvobs.api.export import export as export_map
    from lpvobs.report.tables import change_rows, origin_counts

    done = export_map(
        result,
        out,
        file_format,
        values=source,
        only_estimated=only_estimated,
        old=old,
        name=name,
        kind=kind,
        digits=digits,
    )
    counts = origin_counts(done.surface)
    if as_json:
        written = ExportOutput(
            out=str(out),
            format=file_format,
            values=done.surface.source,
            digits=digits,
            nodes=counts,
            changes=done.changes,
        )
        print_json("export", written)
        return
    if done.changes:
        print(table(*change_rows(done.surface, done.changes)))
    if done.changes is not None:
        say(f"{len(done.changes)} of {done.surface.origin.size} nodes differ from {old}")
    say(f"{out}: {', '.join(f'{count} {origin}' for origin, count in counts.items())}")
