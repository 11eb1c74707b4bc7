"""`lpvobs profile`."""

from pathlib import Path

from lpvobs.cli.common import guarded, print_json, say
from lpvobs.cli.options import JSON, argument, option


@guarded
def profile(
    source: Path = argument("SOURCE", "A CSV, Parquet, MAT or MDF4 recording."),
    out: Path | None = option("TOML", "The profile to write; else it is printed."),
    names: Path | None = option(
        "FILE", "Your own table of names, which comes first: CSV or INCA .lab, lines NAME;CHANNEL."
    ),
    as_json: bool = JSON,
) -> None:
    """Draft a profile for ingest from names, units and ranges; what is unsure is left as a comment.

    Example: lpvobs profile drive.mf4 --out mine.toml
    """
    from lpvobs.api.ingest_log import ProfileOutput, draft_profile

    text = draft_profile(source, out, names)
    if out is not None:
        say(f"{out}: read it, uncomment what is right, then lpvobs ingest {source} --profile {out} --out LOG.parquet")
    if as_json:
        profile = None if out is None else str(out)
        print_json("profile", ProfileOutput(source=str(source), profile=profile, text=text))
    elif out is None:
        print(text, end="")
