"""`ingest`: foreign recordings of one drive to a log that says what was done to it."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lpvobs.ingest.foreign import ingest
from lpvobs.ingest.profiles import load_profile
from lpvobs.io.logs.ingest_record import KEY
from lpvobs.io.logs.reading import write_log


def ingest_log(sources: Sequence[Path], profile: str, out: Path) -> dict[str, Any]:
    """Write the log in foreign files, and return what was done to make it.

    Parameters
    ----------
    sources : sequence of Path
        Files of one drive, on one clock.
    profile : str
        Name of a shipped profile, or path of a TOML file.
    out : Path

    Raises
    ------
    UsageError
        If the profile cannot be used.
    DataError
        If the files cannot.
    """
    rules, name, text = load_profile(profile)
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # numbers at the end of what floats can hold: what overflows is no value
        made = ingest(sources, rules)
    digest = hashlib.sha256(text.encode()).hexdigest()
    record = dict(made.record) | {"profile": {"name": name, "sha256": digest, "text": text}}
    write_log(out, made.channels, made.units, {KEY: json.dumps(record)})
    return record
