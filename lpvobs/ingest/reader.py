"""What a process says that reads a foreign file for another one, see `lpvobs.io.safety.sandbox`.

On stdin stands a JSON list of the full names of the columns to read, or null for a list of what there is. On stdout comes a line of
JSON for each column, its samples behind it as an Arrow stream, and a last line with "notes", or with "error" where it failed.
"""

import json
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa

from lpvobs.ingest.recordings import Head, one_line
from lpvobs.io.safety.sandbox import limited

Columns = Mapping[str, tuple[Head, Callable[[], "pa.Table"]]]
"""By full name: what is known of a column, and what reads it as a table of "values", and "time" [s] if it has stamps of its own."""
Opener = Callable[[Path, dict[str, str]], AbstractContextManager[Columns]]
"""What opens a file; the mapping takes notes."""


def serve(opener: Opener) -> None:
    """Answer within limits, and leave without a destructor of the library."""
    path = limited()
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the library prints
        try:
            _answer(path, opener, out)
        except Exception as error:  # whatever a damaged byte leads to
            _tell(out, {"error": one_line(error) or type(error).__name__})
        out.flush()
        os._exit(0)


def _answer(path: Path, opener: Opener, out: BinaryIO) -> None:
    wanted, notes = json.load(sys.stdin), dict[str, str]()
    with opener(path, notes) as columns:
        if wanted is None:
            for full, (head, _) in columns.items():
                _tell(out, {"full": full, **asdict(head)})
        for full in wanted or ():
            table = columns[full][1]()
            _tell(out, {"full": full})
            with pa.ipc.new_stream(out, table.schema) as stream:
                stream.write_table(table)
    _tell(out, {"notes": notes})


def _tell(out: BinaryIO, content: dict[str, Any]) -> None:
    out.write(json.dumps(content).encode() + b"\n")


def native(values: Any) -> Any:
    """Return an array side by side in memory and in the machine's own byte order, as Arrow needs it."""
    return np.ascontiguousarray(values.astype(values.dtype.newbyteorder("="), copy=False))


def as_text(found: object) -> str:
    """Return bytes or a string as text that can be written as UTF-8, nothing for what is neither."""
    text = found.decode(errors="replace") if isinstance(found, bytes) else found if isinstance(found, str) else ""
    return text.encode(errors="replace").decode()
