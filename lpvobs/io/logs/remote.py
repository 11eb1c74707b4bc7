"""Logs in object stores and other places that fsspec knows: `s3://bucket/V1/jan.parquet`, `abfs://`, `gs://`, `memory://`.

Such a log is known by its size and its Parquet footer, which holds the names, units, statistics and compressed sizes of all
columns: whoever works on it reads nothing else but the columns that the engine needs. Where the footer has no statistics, all
bytes count, as they do for files on a disk.
"""

import hashlib
import io
import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import IO, TYPE_CHECKING, Any, TypeVar

from lpvobs.errors import DataError, UsageError
from lpvobs.io.arrow import pq
from lpvobs.io.safety.atomic import file_digest

if TYPE_CHECKING:
    import fsspec

Answer = TypeVar("Answer")
PROTOCOL = re.compile(r"[a-z][a-z0-9+.-]+:")
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

    def end(self, least: int) -> bytes:
        """Return the last bytes, at least so many if there are."""
        size, key = self._ask(lambda store, name: (int(store.size(name)), str(store.ukey(name))))
        return _end(self, max(size - least, 0), size, key)

    def matching(self) -> list["RemotePath"]:
        """Return the objects whose names fit the path, a pattern, in alphabetical order."""
        found = self._ask(lambda store, name: [store.unstrip_protocol(each) for each in sorted(store.glob(name))])
        return [RemotePath(each) for each in found]

    def rglob(self, pattern: str, **_: Any) -> Iterator["RemotePath"]:
        """Yield what matches at any depth."""
        yield from (self / "**" / pattern).matching()


@lru_cache(maxsize=16)  # several look at the footer of a log, one after the other
def _end(path: RemotePath, begin: int, size: int, key: str) -> bytes:
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
    if isinstance(path, RemotePath):
        return path.end(least)
    with path.open("rb") as stream:
        stream.seek(max(path.stat().st_size - least, 0))
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
