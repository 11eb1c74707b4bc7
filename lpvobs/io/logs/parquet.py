"""Parquet logs: their own description, checked before memory is allocated; reading channels in SI; writing a log.

A log may also lie in an object store or another place that fsspec knows: `s3://bucket/V1/jan.parquet`, `abfs://`, `gs://`,
`memory://`. Such a log is known by its size and its Parquet footer, which holds the names, units, statistics and compressed sizes
of all columns: whoever works on it reads nothing else but the columns that the engine needs. Where the footer has no statistics,
all bytes count, as they do for files on a disk.
"""

import hashlib
import io
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import IO, TYPE_CHECKING, Any, TypeVar

import numpy as np

from lpvobs.errors import DataError, UsageError
from lpvobs.io.arrow import pa, pc, pq
from lpvobs.io.logs.units import convert
from lpvobs.io.safety.atomic import file_digest, replacing
from lpvobs.records import Array

if TYPE_CHECKING:
    import fsspec

Answer = TypeVar("Answer")
PROTOCOL = re.compile(r"[a-z][a-z0-9+.-]+:")
MOST_COLUMNS = 10_000
MOST_READINGS = 50_000_000
"""Rows times channels that are held in memory at once; a small file can claim any number of rows."""
REFERENCES = {"ref_W_c": "kg/s", "ref_delta_W_c": "kg/s"}  # what only a simulated log knows
MOST_FOOTER = 64 * 2**20
"""[bytes] of a Parquet file's own description; a log of a hundred channels and a thousand hours has less."""
TAIL = 1 << 16
"""[bytes] read from the end at once; the footer of a log of ten channels and an hour has a fifth of it."""


class RemotePath(type(Path())):  # type: ignore[misc] # the class that `Path` makes here
    """A path whose first part is a protocol; whoever reads logs uses it as one on a disk."""

    def __str__(self) -> str:
        return f"{self.parts[0]}//" + "/".join(self.parts[1:])

    def _ask(self, question: Callable[["fsspec.AbstractFileSystem", str], Answer]) -> Answer:
        """Return what the store says; raises UsageError where a library is missing, DataError where the store says nothing."""
        try:
            import fsspec

            return question(*fsspec.core.url_to_fs(str(self)))
        except ImportError as error:
            raise UsageError(
                f"{self}: {error}; install lpvobs[cluster] and the fsspec library for {self.parts[0]}// (s3fs, gcsfs, adlfs)"
            ) from None
        except FileNotFoundError:
            raise
        except Exception as error:  # every store has errors of its own
            raise DataError(f"{self}: cannot be reached ({error or error!r}); check address and credentials") from None

    def is_file(self, **_: Any) -> bool:
        """Return whether there is such an object."""
        return self._ask(lambda store, name: bool(store.isfile(name)))

    def is_dir(self, **_: Any) -> bool:
        """Return whether names of objects begin so."""
        return self._ask(lambda store, name: bool(store.isdir(name)))

    def exists(self, **_: Any) -> bool:
        """Return whether there is anything."""
        return self._ask(lambda store, name: bool(store.exists(name)))

    def stat(self, **_: Any) -> Any:
        """Return the size, and what changes when somebody writes."""
        size, key = self._ask(lambda store, name: (int(store.size(name)), str(store.ukey(name))))
        version = int(hashlib.sha256(key.encode()).hexdigest()[:12], 16)
        return SimpleNamespace(st_size=size, st_ino=version, st_mtime_ns=0, st_dev=-1)

    def resolve(self, strict: bool = False) -> "RemotePath":
        """Return the path itself: a store has no links."""
        return self

    def open(self, mode: str = "rb", *_: Any, **__: Any) -> IO[Any]:
        """Return the object as a file from which only what is asked for is read."""
        return self._ask(lambda store, name: store.open(name, mode, cache_type="none"))

    def matching(self) -> list["RemotePath"]:
        """Return the objects whose names fit the path, a pattern, in alphabetical order."""
        found = self._ask(lambda store, name: [store.unstrip_protocol(each) for each in sorted(store.glob(name))])
        return [RemotePath(each) for each in found]

    def rglob(self, pattern: str, **_: Any) -> Iterator["RemotePath"]:
        """Yield what matches at any depth."""
        yield from (self / "**" / pattern).matching()


@lru_cache(maxsize=16)  # several look at the footer of a log, one after the other
def _end(path: RemotePath, begin: int, size: int, _version: int) -> bytes:
    return path._ask(lambda store, name: bytes(store.cat_file(name, start=begin, end=size)))


def log_path(path: Path) -> Path:
    """Return a path that can be read: a remote one where its first part is a protocol."""
    return RemotePath(*path.parts) if len(path.parts) > 1 and PROTOCOL.fullmatch(path.parts[0]) else path


def footer_of(path: Path) -> bytes:
    """Return a Parquet footer with its length and magic number, and what stands before it; DataError for one that is too long."""
    end = _last(path, TAIL)
    length, size = int.from_bytes(end[-8:-4], "little"), path.stat().st_size
    if MOST_FOOTER < length < size:
        raise DataError(
            f"{path}: the metadata of the file have {length} bytes, expected at most {MOST_FOOTER}; "
            f"export fewer channels or larger row groups"
        )
    return end if length + 8 <= len(end) else _last(path, length + 8)


def _last(path: Path, least: int) -> bytes:
    found = path.stat()
    begin = max(found.st_size - least, 0)
    if isinstance(path, RemotePath):
        return _end(path, begin, found.st_size, found.st_ino)
    with path.open("rb") as stream:
        stream.seek(begin)
        return stream.read()


def log_digest(path: Path) -> str:
    """Return what a log is known by: the SHA-256 of its bytes on a disk, of size and footer in a store."""
    if not isinstance(path, RemotePath):
        return file_digest(path)
    footer = footer_of(path)
    metadata, size = pq.read_metadata(io.BytesIO(footer)), path.stat().st_size
    groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    if not all(group.column(i).is_stats_set for group in groups for i in range(metadata.num_columns)):
        return file_digest(path)
    length = int.from_bytes(footer[-8:-4], "little") + 8
    return hashlib.sha256(b"%d %b" % (size, footer[-length:])).hexdigest()


def parquet_file(path: Path) -> "pq.ParquetFile":
    """Return an open log, of which whole columns are read at a time from a store, and a piece of them from a disk."""
    if isinstance(path, RemotePath):
        return pq.ParquetFile(path.open(), metadata=pq.read_metadata(io.BytesIO(footer_of(path))), pre_buffer=False)
    return pq.ParquetFile(path, buffer_size=1 << 20, pre_buffer=False)


def metadata_of(path: Path) -> "pq.FileMetaData":
    """Return what a Parquet file says of itself, if that is not too much to be read."""
    if not path.is_file():
        raise DataError(f"{path}: no such log; name a Parquet file")
    with _readable(path):
        return pq.read_metadata(io.BytesIO(footer_of(path)))


def schema_of(path: Path) -> "pa.Schema":
    """Return the columns with their units; raises DataError for no log, too many columns, or a name that is not UTF-8."""
    metadata = metadata_of(path)
    if metadata.num_columns > MOST_COLUMNS:
        raise DataError(
            f"{path}: has {metadata.num_columns} columns, expected at most {MOST_COLUMNS}; export only the channels of the engine"
        )
    with _readable(path):
        schema = metadata.schema.to_arrow_schema()
        schema.names  # noqa: B018 names that are not UTF-8 show here
        return schema


def refuse_huge(path: Path, rows: int, columns: int) -> None:
    """Raise DataError for more rows than fit into memory, whatever the size of the file."""
    if rows * columns > MOST_READINGS:
        raise DataError(
            f"{path}: {rows} rows of {columns} channels do not fit into memory, expected at most {MOST_READINGS // columns} rows; "
            f"split the log or lower its sample rate"
        )


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise DataError for a file that pyarrow cannot read, with its reason."""
    try:
        yield
    except (pa.ArrowException, OSError, ValueError) as error:
        with suppress(OSError), path.open("rb") as stream:
            if stream.read(4) not in (b"PAR1", b"PARE", b""):
                remedy = "`lpvobs profile` and then `lpvobs ingest` make a log of a CSV, MAT or MDF recording"
                raise DataError(f"{path}: not a Parquet file, but logs are Parquet files; {remedy}") from None
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DataError(f"{path}: not a readable Parquet log ({reason}); record or export it again") from None


def tables_of(path: Path, columns: list[str], most: int, threads: bool = True) -> "Iterator[pa.Table]":
    """Yield the columns of a Parquet file as tables of at most so many rows, of equal length up to rounding."""
    with _readable(path), parquet_file(path) as file:
        rows = file.metadata.num_rows
        if rows <= most:
            yield file.read(columns=columns, use_threads=threads)
            return
        slab = -(-rows // -(-rows // most))  # as even as can be: no small one at the end to be judged by itself
        for batch in file.iter_batches(batch_size=slab, columns=columns, use_threads=threads):
            yield pa.Table.from_batches([batch])


def write_log(
    path: Path, channels: Mapping[str, Array], units: Mapping[str, str], metadata: Mapping[str, str] | None = None
) -> None:
    """Write channels of equal length to a Parquet log, their units in their fields' metadata, and further metadata of the file."""
    fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in channels]
    columns = [np.ascontiguousarray(column, dtype=float) for column in channels.values()]
    buffers = [(column.size, [None, pa.py_buffer(column)]) for column in columns]  # see `as_floats`
    arrays = [pa.Array.from_buffers(pa.float64(), *buffer) for buffer in buffers]
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=metadata))
    with replacing(path) as temporary:
        pq.write_table(table, temporary, compression="zstd", row_group_size=1 << 16)


def has_references(path: Path) -> bool:
    """Return whether a log knows the truth; raises DataError for a truth without unit."""
    schema = schema_of(path)
    there = set(schema.names) >= set(REFERENCES)
    expect(path, schema, REFERENCES if there else {})
    return there


def channel_units(path: Path) -> dict[str, str]:
    """Return the unit of every channel in a file, empty where it has none."""
    return {field.name: unit_of(field) for field in schema_of(path)}


def expect(path: Path, schema: "pa.Schema", units: Mapping[str, str]) -> None:
    """Raise unless every channel that is to convert to a unit is there once and says its own."""
    for name, wanted in units.items():
        found = schema.get_all_field_indices(name)
        if len(found) != 1:
            state = "missing" if not found else f"present {len(found)} times"
            present = " ".join(", ".join(schema.names[:20]).split()) or "none"
            raise DataError(
                f"{path}: channel '{name}' is {state}; expected once, in {wanted}; channels in the file: {present}"
            )
        if not unit_of(schema.field(found[0])):
            raise DataError(
                f"{path}: channel '{name}' has no unit; expected '{wanted}' or a unit that converts to it, "
                f"in the field's metadata under the key 'unit'"
            )


def unit_of(field: "pa.Field") -> str:
    """Return the unit of a channel, empty where it has none."""
    return str((field.metadata or {}).get(b"unit", b"").decode(errors="replace")).strip()


def column_of(path: Path, table: "pa.Table", name: str, wanted: str) -> Array:
    """Return one channel as floats in the wanted unit, NaN where the file has null."""
    field = table.schema.field(name)
    try:
        if not is_numeric(field.type):
            raise pa.ArrowTypeError(str(field.type))
        values = as_floats(table.column(name))
    except pa.ArrowException:
        raise DataError(
            f"{path}: channel '{name}' holds {field.type}, expected numbers in {wanted}; export it as numbers"
        ) from None
    try:
        return np.asarray(convert(values, unit_of(field), wanted), dtype=float)
    except ValueError as error:
        raise DataError(f"{path}: channel '{name}': {error}; give this channel a unit of the expected kind") from None


def is_numeric(kind: "pa.DataType") -> bool:
    """Return whether a column of this type holds numbers; text that looks like numbers does not."""
    value = kind.value_type if pa.types.is_dictionary(kind) else kind
    tests = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_boolean)
    return any(test(value) for test in tests)


def as_floats(column: "pa.Array | pa.ChunkedArray") -> Array:
    """Return a column as floats, NaN for null; by DLPack, for pyarrow's own way imports pandas, which takes longer than reading."""
    if column.type != pa.float64():
        column = column.cast(pa.float64(), safe=False)  # large whole numbers are rounded
    if column.null_count:
        column = pc.fill_null(column, float("nan"))
    chunks = getattr(column, "chunks", [column])
    return np.concatenate([np.empty(0), *(np.from_dlpack(chunk) for chunk in chunks if len(chunk))])
