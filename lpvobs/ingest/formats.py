"""Which format a foreign file has, and what opens it."""

from collections.abc import Callable
from pathlib import Path

from lpvobs.errors import DataError
from lpvobs.ingest import profiles, recordings


def open_recording(path: Path, rules: profiles.SourceRules) -> recordings.ForeignRecording:
    """Return a foreign file, opened by its format: the profile's, or that of its first bytes; raises DataError if it cannot be."""
    found = sniff(path)
    recording = _opener(rules.format or found)(path, rules)
    if len(recording.heads) > recordings.MOST_COLUMNS:
        raise DataError(
            f"{path}: has {len(recording.heads)} columns, expected at most {recordings.MOST_COLUMNS}; export fewer channels"
        )
    return recording


def sniff(path: Path) -> str:
    """Return the format of a file by its first bytes; what no other format begins with is taken for CSV."""
    if not path.is_file():
        raise DataError(f"{path}: no such recording; name a CSV, Parquet, MAT or MDF4 file")
    with recordings.opened(path) as stream:
        first = stream.read(8)
    if first[:4] == b"PAR1":
        return "parquet"
    if first[:8] in (b"MDF     ", b"UnFinMF "):
        return "mdf"
    if first[:6] == b"MATLAB" or first[:8] == b"\x89HDF\r\n\x1a\n":
        return "mat"
    return "csv"


def _opener(kind: str) -> Callable[[Path, profiles.SourceRules], recordings.ForeignRecording]:
    """Return what opens a format; the libraries of the others are not loaded."""
    if kind == "parquet":
        from lpvobs.ingest.recording_table import open_parquet

        return open_parquet
    if kind == "csv":
        from lpvobs.ingest.recording_table import open_csv

        return open_csv
    from lpvobs.ingest.recording_apart import open_mat, open_mdf

    return open_mat if kind == "mat" else open_mdf
