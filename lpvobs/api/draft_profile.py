"""`profile`: what a recording seems to be, as a profile for `ingest`."""

from dataclasses import dataclass

from lpvobs.api.files import File, as_path, writing
from lpvobs.ingest.drafting import draft_profile as draft
from lpvobs.io.safety.atomic import replacing


@dataclass(frozen=True, kw_only=True)
class ProfileOutput:
    """A drafted profile."""

    source: str
    profile: str | None
    text: str


def draft_profile(source: File, out: File | None = None, names: File | None = None) -> str:
    """Return the text of a profile for `ingest`, drafted from names, units and ranges of a recording.

    Raises DataError if the recording cannot be read; UsageError for a table without a channel, or with a name for two.

    Parameters
    ----------
    source : path
        CSV, Parquet, MAT or MDF4.
    out : path, optional
        The TOML file to write it to.
    names : path, optional
        Your own table of names, which comes first: a CSV or INCA `.lab` file with lines `NAME;CHANNEL`.

    Returns
    -------
    str
        TOML; what is unsure is a comment in it. Read it before using it.
    """
    own = None if names is None else as_path(names)
    if out is None:
        return draft(as_path(source), own)
    with writing(out, [source, names]) as target:
        text = draft(as_path(source), own)
        with replacing(target) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return text
