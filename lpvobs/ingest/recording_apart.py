"""Recordings whose libraries are made for files that one trusts: MAT and MDF.

A damaged file may crash such a library, keep it busy for ever or let it fill the memory. So it runs in a process of its own, within
limits; `lpvobs.ingest.reader` says what the two tell each other.
"""

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lpvobs.errors import DataError, UsageError
from lpvobs.ingest.profiles import SourceRules
from lpvobs.ingest.recordings import Column, ForeignRecording, Head, check_samples, opened
from lpvobs.io.arrow import pa
from lpvobs.io.safety.sandbox import answer

SECONDS, BYTES = 6, 2 << 30  # what a library may take for a small file: computing and memory
PER_SECOND = 4 << 20  # [bytes] of a file for which it may compute a second longer
FAILED = "the library that reads it fails, or takes too long"
MDF_MAGIC = (b"MDF     ", b"UnFinMF ")
ARCHIVES = (".zip", ".mf4z", ".gzip", ".gz", ".bz2")


@dataclass(frozen=True)
class Library:
    """The name of a format, the module that reads it, and what to do with a file that it cannot read."""

    kind: str
    module: str
    remedy: str


MAT = Library("MAT", "lpvobs.ingest.mat_reader", "save it again in MATLAB with -v7 or -v7.3")
MDF = Library("MDF", "lpvobs.ingest.mdf_reader", "record or export it again")


@dataclass(frozen=True)
class ApartRecording(ForeignRecording):
    """A file that another process reads."""

    library: Library

    def read(self, names: Sequence[str]) -> Mapping[str, Column]:
        """Return columns as they are stored; those of MDF in physical values, with their own stamps, empty where marked invalid."""
        check_samples(self.path, [self.heads[name].size for name in names])
        tables = _asked(self.path, self.library, names, self.notes)
        return {
            name: Column(table["values"], table["time"].to_numpy() if table.num_columns > 1 else None)
            for name, table in zip(names, tables, strict=True)
        }


def open_mat(path: Path, rules: SourceRules) -> ApartRecording:
    """Return a MAT file with the names, units and lengths of its numeric vectors; structures become dotted names."""
    return _opened(path, MAT)


def open_mdf(path: Path, rules: SourceRules) -> ApartRecording:
    """Return an MDF file with its channels; a name that several groups have is called group:name."""
    if find_spec("asammdf") is None:
        raise UsageError(
            f"{path}: MDF needs the library asammdf, which is not installed; install it with: pip install 'lpvobs[mdf]'"
        )
    with opened(path) as stream:
        magic = stream.read(8)
    if magic not in MDF_MAGIC:  # the library would unpack it
        raise DataError(
            f"{path}: does not begin like an MDF file; unpack the file if it is packed, or delete format in the profile's [source]"
        )
    if path.suffix.lower() in ARCHIVES:  # the library would take it for its own copy of an archive, and delete it
        raise DataError(f"{path}: is an MDF file, but its name ends like that of an archive; rename it to .mf4")
    return _opened(path, MDF)


def _opened(path: Path, library: Library) -> ApartRecording:
    notes: dict[str, str] = {}
    heads = {column.pop("full"): Head(**column) for column in _asked(path, library, None, notes)}
    return ApartRecording(path, heads, library, notes=notes)


def _asked(path: Path, library: Library, wanted: Sequence[str] | None, notes: dict[str, str]) -> Iterator[Any]:
    """Yield what the reading process says of every column, or tables of the wanted ones; keep its notes."""
    size = path.stat().st_size
    said = io.BytesIO(answer(library.module, path, SECONDS + size // PER_SECOND, BYTES + size, json.dumps(wanted)))
    reason = FAILED
    try:
        for line in said:
            content = json.loads(line)
            if "notes" in content:
                notes.update(content["notes"])
                return
            if "error" in content:
                reason = content["error"]
                break
            yield content if wanted is None else pa.ipc.open_stream(said).read_all()
    except (ValueError, pa.ArrowException):  # it ended in the middle of what it had to say
        pass
    raise DataError(f"{path}: not a readable {library.kind} file ({reason}); {library.remedy}")
