"""`lpvobs inspect`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from lpvobs.cli.common import JsonOption, LogsArgument, folder_config, guarded, leave, print_json, table, visible


@guarded
def inspect(
    logs: LogsArgument,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            readable=False,
            metavar="TOML",
            help="Engine and policies; by default lpvobs.toml in this folder or above, else the engine that the log suits.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show channels, units, rate, gaps, ranges, the defects of logs, and what each policy did about them.

    Example: lpvobs inspect nedc.parquet
    """
    from lpvobs.api.inspect import inspect_logs

    found, refused = inspect_logs(logs, config or folder_config())
    if as_json:
        print_json("inspect", {"logs": [item.as_content() for item in found], "refused": refused})
    else:
        print("\n\n".join(_text(item.as_content()) for item in found))
    leave(refused)


def _text(content: dict[str, Any]) -> str:
    head = (
        f"{content['log']}: {content['samples']} of {content['samples_read']} samples used, {content['duration']:.1f} s at "
        f"{content['rate']:.4g} Hz, {content['gaps']} gaps, {content['repeated']} repeated or backward"
    )
    rows = [
        [
            name,
            item["unit"],
            item["use"],
            *(f"{item[key]:.6g}" for key in ("min", "median", "max")),
            "-" if item["refresh"] != item["refresh"] else f"{item['refresh']:.4g}",
            str(item["dropped"]),
        ]
        for name, item in content["channels"].items()
    ]
    parts = [visible(head), table(["channel", "unit", "use", "min", "median", "max", "changes [Hz]", "dropped"], rows)]
    found = [
        [
            item["defect"],
            item["channel"],
            str(item["count"]),
            f"{item['first']:.6g} s" if "first" in item else "",
            item["policy"],
        ]
        for item in content["defects"]
    ]
    if found:
        parts.append(table(["defect", "channel", "count", "first", "policy"], found))
    for engine, missing in content["lacking"].items():
        parts.append(f"no log for the engine '{engine}': lacks {', '.join(missing)}")
    if content["ingest"] is not None:
        parts.append(_ingest_text(content["ingest"]))
    return "\n".join(parts)


def _ingest_text(record: dict[str, Any]) -> str:
    from lpvobs.report.tables import ingest_notes, ingest_rows

    return "\n".join([*ingest_notes(record), table(*ingest_rows(record))])
