"""`ingest`: foreign recordings of one drive to a log that says what was done to it."""

import hashlib
import json
from collections.abc import Iterable
from typing import Any

import numpy as np

from lpvobs.api.files import File, some, writing
from lpvobs.ingest.foreign import ingest
from lpvobs.ingest.profiles import load_profile
from lpvobs.ingest.record import KEY
from lpvobs.io.logs.origins import own_origin
from lpvobs.io.logs.parquet import write_log


def ingest_log(
    sources: File | Iterable[File], profile: File, out: File, *, vehicle: str | None = None, date: str | None = None
) -> dict[str, Any]:
    """Make a log of a foreign recording.

    Raises UsageError if the profile cannot be used; DataError if the files cannot.

    Parameters
    ----------
    sources : path or several
        CSV, Parquet, MAT or MDF4 files of one drive, on one clock.
    profile : str or path
        `liu-ice`, `kit-obd`, or a TOML file.
    out : path
        The Parquet log to write.
    vehicle, date : str, optional
        Whose log it is and when it was driven, such as 2025-01-31, kept in the log for `track`.

    Returns
    -------
    dict
        What was done to every channel, each repair with its count, as the log keeps it.
    """
    paths, origin = some(sources, "recording"), own_origin(vehicle, date, "")
    with writing(out, [*paths, profile]) as target:
        rules, name, text = load_profile(str(profile))
        with np.errstate(
            over="ignore", invalid="ignore"
        ):  # numbers at the end of what floats can hold: what overflows is no value
            made = ingest(paths, rules)
        digest = hashlib.sha256(text.encode()).hexdigest()
        record = dict(made.record) | {"profile": {"name": name, "sha256": digest, "text": text}}
        write_log(target, made.channels, made.units, {KEY: json.dumps(record)} | origin)
    return record
