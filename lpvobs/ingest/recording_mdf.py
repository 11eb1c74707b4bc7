"""MDF recordings of measurement systems: many groups of channels, each with a time base of its own.

Their library is large, partly C, and made for files that one trusts. It runs in a process of its own, within limits.
"""

import json
import subprocess
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

from lpvobs.errors import DataError, UsageError
from lpvobs.ingest.profiles import SourceRules
from lpvobs.ingest.recordings import Column, Head, check_samples
from lpvobs.io.safety.apart import call, environment

MAGIC = (b"MDF     ", b"UnFinMF ")
SECONDS, BYTES, PATIENCE = 6, 2 << 30, 10
"""What the library may take for a small file: computing and memory; on a busy machine it may stand still for ten times as long."""
PER_SECOND = 4 << 20
"""[bytes] of a file for which it may compute a second longer."""
FAILED = "its library fails on it, or takes too long"

Place = tuple[int, int]
"""Group, and index in it, of a channel."""


@dataclass(frozen=True)
class MdfRecording:
    """An MDF file; `places` is group and index of each channel."""

    path: Path
    heads: Mapping[str, Head]
    places: Mapping[str, Place]
    notes: dict[str, str] = field(default_factory=dict)

    def read(self, names: Sequence[str]) -> Mapping[str, Column]:
        """Return channels in physical values with their own stamps; samples marked invalid are empty."""
        import pyarrow as pa

        check_samples(self.path, [self.heads[name].size for name in names])
        found: dict[Place, Column] = {}
        with _asked(self.path, [self.places[name] for name in names], self.notes) as (lines, stream):
            for line in lines:
                with pa.ipc.open_stream(stream) as samples:
                    table = samples.read_all()
                found[_place(line)] = Column(table["values"], table["time"].to_numpy())
        return {name: found[self.places[name]] for name in names}


def open_mdf(path: Path, rules: SourceRules) -> MdfRecording:
    """Return an MDF file with its channels; a name that several groups have is called group:name."""
    notes: dict[str, str] = {}
    with _asked(path, None, notes) as (lines, _):
        found = list(lines)
    often = Counter(line["name"] for line in found)
    heads, places = {}, {}
    for line in found:
        name, place = line["name"], _place(line)
        full = name if often[name] == 1 else f"{place[0]}:{name}"
        heads[full], places[full] = Head(name, line["unit"], line["size"]), place
    return MdfRecording(path, heads, places, notes)


def _place(line: Mapping[str, Any]) -> Place:
    group, index = line["place"]
    return group, index


@contextmanager
def _asked(
    path: Path, wanted: Sequence[Place] | None, notes: dict[str, str]
) -> Iterator[tuple[Iterator[dict[str, Any]], IO[bytes]]]:
    """Yield the lines that the reading process says of a file, and the stream in which samples follow them."""
    import pyarrow as pa

    if find_spec("asammdf") is None:
        raise UsageError(f"{path}: MDF needs the library asammdf, which is not installed; pip install 'lpvobs[mdf]'")
    _check_kind(path)
    size = path.stat().st_size
    seconds = SECONDS + size // PER_SECOND
    arguments = (str(path.absolute()), str(seconds), str(BYTES + size))
    with tempfile.TemporaryDirectory() as folder:  # of the library's copies, which a killed process leaves behind
        process = subprocess.Popen(
            call("lpvobs.ingest.mdf_reader", *arguments),
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
                    raise _unreadable(path, "no pipe to its reader")
                process.stdin.write(json.dumps(wanted).encode())
                process.stdin.close()
                yield _lines(path, process.stdout, notes), process.stdout
            except (OSError, ValueError, pa.ArrowException):  # it ended in the middle of what it had to say
                raise _unreadable(path, FAILED) from None
            finally:
                watch.cancel()
                process.kill()


def _lines(path: Path, stream: IO[bytes], notes: dict[str, str]) -> Iterator[dict[str, Any]]:
    """Yield what is said of each channel, up to the last line, whose notes are kept."""
    while line := stream.readline():
        content = json.loads(line)
        if "error" in content:
            raise _unreadable(path, content["error"])
        if "notes" in content:
            notes.update(content["notes"])
            return
        yield content
    raise _unreadable(path, FAILED)


def _unreadable(path: Path, reason: str) -> DataError:
    return DataError(f"{path}: not a readable MDF file ({reason}); record or export it again")


def _check_kind(path: Path) -> None:
    """Refuse what the library would unpack, or take for its own copy of an archive and delete."""
    with path.open("rb") as stream:
        magic = stream.read(8)
    if magic not in MAGIC:
        raise DataError(
            f"{path}: does not begin like an MDF file; unpack it, or leave format out of the profile's [source]"
        )
    if path.suffix.lower() in (".zip", ".mf4z", ".gzip", ".gz", ".bz2"):
        raise DataError(f"{path}: is an MDF file under an archive's name; rename it to .mf4")
