"""Parquet files: what one says of itself, looked at before memory is taken for it; its rows; a log written."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from lpvobs.errors import DataError
from lpvobs.io.safety.atomic import replacing
from lpvobs.records import Array

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

MOST_FOOTER = 64 * 2**20
"""[bytes] of a Parquet file's own description; a log of a hundred channels and a thousand hours has less."""
MOST_COLUMNS = 10_000
MOST_READINGS = 50_000_000
"""Rows times channels that are held in memory at once; a small file can claim any number of rows."""
BATCH = 1 << 16
"""Rows that are decoded at a time."""


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


def tables_of(path: Path, columns: list[str], most: int, threads: bool = True) -> "Iterator[pa.Table]":
    """Yield the columns of a Parquet file as tables of at most so many rows, of equal length up to rounding."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, buffer_size=1 << 20, pre_buffer=False) as file:
            rows = file.metadata.num_rows
            if rows <= most:
                yield file.read(columns=columns, use_threads=threads)
                return
            slab = -(-rows // -(-rows // most))  # as even as can be: no small one at the end to be judged by itself
            held: list[pa.RecordBatch] = []
            count = 0
            for batch in file.iter_batches(batch_size=BATCH, columns=columns, use_threads=threads):
                held.append(batch)
                count += batch.num_rows
                while count >= slab:
                    table = pa.Table.from_batches(held)
                    yield table.slice(0, slab)
                    held = table.slice(slab).to_batches()
                    count -= slab
            if held:
                yield pa.Table.from_batches(held)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise unreadable(path, error) from None


def write_log(
    path: Path, channels: Mapping[str, Array], units: Mapping[str, str], metadata: Mapping[str, str] | None = None
) -> None:
    """Write channels of equal length to a Parquet log, the unit of each in its field's metadata.

    `metadata` is kept with the file, for example what `ingest` did to make it.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in channels]
    table = pa.table([pa.array(column) for column in channels.values()], schema=pa.schema(fields, metadata=metadata))
    with replacing(path) as temporary:
        pq.write_table(table, temporary, compression="zstd", row_group_size=1 << 16)
