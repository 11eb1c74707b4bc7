"""`ingest`: foreign recordings of one drive to a log that says what was done to it; `profile`: what one seems to be."""

import json
from typing import Any

from lpvobs.api.files import File, Files, as_path, some, write_text, writing
from lpvobs.ingest import drafting, foreign, profiles, record
from lpvobs.io.logs import finding, parquet
from lpvobs.kinds import Output


def ingest_log(
    sources: Files, profile: File, out: File, *, vehicle: str | None = None, date: str | None = None
) -> dict[str, Any]:
    """Make a log of a foreign recording; return what was done to every channel, each repair with its count, as the log keeps it.

    Raises UsageError if the profile cannot be used; DataError if the files cannot.

    Parameters
    ----------
    sources : path or several
        CSV, Parquet, MAT or MDF4 files of one drive, on one clock.
    profile : str or path
        `liu-ice`, `kit-obd`, or a TOML file.
    vehicle, date : str, optional
        Whose log it is and when it was driven, such as 2025-01-31, kept in the log for `track`.
    """
    paths, origin = some(sources, "recording"), finding.own_origin(vehicle, date, "")
    with writing(out, [*paths, profile]) as target:
        rules, by = profiles.load_profile(str(profile))
        made = foreign.ingest(paths, rules, by)
        parquet.write_log(target, made.channels, made.units, {record.KEY: json.dumps(made.record)} | origin)
    return dict(made.record)


class ProfileOutput(Output):
    """A drafted profile."""

    source: str
    profile: str | None
    text: str


def draft_profile(source: File, out: File | None = None, names: File | None = None) -> str:
    """Return a profile for `ingest` (TOML) drafted from names, units and ranges of a recording; what is unsure is a comment.

    Raises DataError if the recording cannot be read; UsageError for a table without a channel, or with a name for two.

    Parameters
    ----------
    source : path
        CSV, Parquet, MAT or MDF4.
    names : path, optional
        Your own table of names, which comes first: a CSV or INCA `.lab` file with lines `NAME;CHANNEL`.
    """
    own = None if names is None else as_path(names)
    text = drafting.draft_profile(as_path(source), own)
    if out is not None:
        write_text(out, text, [source, names])
    return text
