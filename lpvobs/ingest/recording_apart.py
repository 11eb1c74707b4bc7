"""Recordings whose libraries are made for files that one trusts: MAT and MDF.

A damaged file may crash such a library, keep it busy for ever or let it fill the memory. So it runs in a process of its own, within
limits; `lpvobs.ingest.reader` says what the two tell each other.
"""

import json
import subprocess
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

from lpvobs.errors import DataError, UsageError
from lpvobs.ingest.profiles import SourceRules
from lpvobs.ingest.recordings import Column, ForeignRecording, Head, check_samples, opened
from lpvobs.io.arrow import pa
from lpvobs.io.safety.sandbox import call, environment

SECONDS, BYTES, PATIENCE = 6, 2 << 30, 10
"""What a library may take for a small file: computing and memory; on a busy machine it may stand still for ten times as long."""
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
    """A file that another process reads; `places` is where that process finds each column."""

    library: Library
    places: Mapping[str, Any]

    def read(self, names: Sequence[str]) -> Mapping[str, Column]:
        """Return columns as they are stored; those of MDF in physical values, with their own stamps, empty where marked invalid."""
        check_samples(self.path, [self.heads[name].size for name in names])
        columns = []
        with _asked(self.path, self.library, [self.places[name] for name in names], self.notes) as (lines, stream):
            for _ in lines:
                with pa.ipc.open_stream(stream) as samples:
                    table = samples.read_all()
                columns.append(Column(table["values"], table["time"].to_numpy() if table.num_columns > 1 else None))
        return dict(zip(names, columns, strict=True))


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
    with _asked(path, library, None, notes) as (lines, _):
        found = list(lines)
    heads = {line["full"]: Head(line["name"], line["unit"], line["size"]) for line in found}
    return ApartRecording(path, heads, library, {line["full"]: line["place"] for line in found}, notes=notes)


@contextmanager
def _asked(
    path: Path, library: Library, wanted: Sequence[Any] | None, notes: dict[str, str]
) -> Iterator[tuple[Iterator[dict[str, Any]], IO[bytes]]]:
    """Yield the lines that the reading process says of a file, and the stream in which samples follow them."""
    size = path.stat().st_size
    seconds = SECONDS + size // PER_SECOND
    arguments = (str(path.absolute()), str(seconds), str(BYTES + size))
    with tempfile.TemporaryDirectory() as folder:  # of the library's copies, which a killed process leaves behind
        process = subprocess.Popen(
            call(library.module, *arguments),
            env=environment(TMPDIR=folder),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        watch = threading.Timer(PATIENCE * seconds, process.kill)
        watch.start()
        with process:
            try:
                if process.stdin is None or process.stdout is None:
                    raise _unreadable(path, library, "no connection to the process that reads it")
                process.stdin.write(json.dumps(wanted).encode())
                process.stdin.close()
                yield _lines(path, library, process.stdout, notes), process.stdout
            except (OSError, ValueError, pa.ArrowException):  # it ended in the middle of what it had to say
                raise _unreadable(path, library, FAILED) from None
            finally:
                watch.cancel()
                process.kill()


def _lines(path: Path, library: Library, stream: IO[bytes], notes: dict[str, str]) -> Iterator[dict[str, Any]]:
    """Yield what is said of each column, up to the last line, whose notes are kept."""
    while line := stream.readline():
        content = json.loads(line)
        if "error" in content:
            raise _unreadable(path, library, content["error"])
        if "notes" in content:
            notes.update(content["notes"])
            return
        yield content
    raise _unreadable(path, library, FAILED)


def _unreadable(path: Path, library: Library, reason: str) -> DataError:
    return DataError(f"{path}: not a readable {library.kind} file ({reason}); {library.remedy}")
