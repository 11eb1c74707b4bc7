"""What a Parquet file says of itself, looked at before memory is taken for what it holds."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from lpvobs.errors import DataError

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

MOST_FOOTER = 64 * 2**20
"""[bytes] of a Parquet file's own description; a log of a hundred channels and a thousand hours has less."""
MOST_COLUMNS = 10_000
MOST_READINGS = 50_000_000
"""Rows times channels that are held in memory at once; a small file can claim any number of rows."""


def state_of(path: Path) -> tuple[int, ...]:
    """Return what changes when somebody writes to a file."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return (found.st_ino, found.st_size, found.st_mtime_ns)


def metadata_of(path: Path) -> "pq.FileMetaData":
    """Return what a Parquet file says of itself, if that is not too much to be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not path.is_file():
        raise DataError(f"{path}: no such log; name a Parquet file")
    try:
        _refuse_long_footer(path)
        return pq.read_metadata(path)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise unreadable(path, error) from None


def _refuse_long_footer(path: Path) -> None:
    """Raise for a description of more columns and row groups than a log has, before it is parsed."""
    with path.open("rb") as stream:
        stream.seek(-min(8, path.stat().st_size), os.SEEK_END)
        length = int.from_bytes(stream.read(4), "little")
    if MOST_FOOTER < length < path.stat().st_size:
        raise DataError(
            f"{path}: describes itself in {length} bytes, expected at most {MOST_FOOTER}; "
            f"export fewer channels, or larger row groups"
        )


def schema_of(path: Path, metadata: "pq.FileMetaData") -> "pa.Schema":
    """Return the columns with their units; raises DataError where there are too many, or a name is not UTF-8."""
    import pyarrow as pa

    if metadata.num_columns > MOST_COLUMNS:
        raise DataError(
            f"{path}: has {metadata.num_columns} columns, expected at most {MOST_COLUMNS}; export only the channels of the engine"
        )
    try:
        schema = metadata.schema.to_arrow_schema()
        schema.names  # noqa: B018 names that are not UTF-8 show here
        return schema
    except (pa.ArrowException, OSError, ValueError) as error:
        raise unreadable(path, error) from None


def refuse_huge(path: Path, rows: int, columns: int) -> None:
    """Raise DataError for more rows than fit into memory, whatever the size of the file."""
    if rows * columns > MOST_READINGS:
        raise DataError(
            f"{path}: {rows} rows of {columns} channels do not fit into memory, expected at most {MOST_READINGS // columns} rows; "
            f"split the log, or thin it out"
        )


def unreadable(path: Path, error: Exception) -> DataError:
    """Return the refusal of a file that pyarrow cannot read, with its reason."""
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    return DataError(f"{path}: not a readable Parquet log ({reason}); record or export it again")
