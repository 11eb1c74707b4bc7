"""What a process says that reads a foreign file for another one, see `lpvobs.io.safety.sandbox`.

On stdin stands a JSON list of the places of the columns to read, or null for a list of what there is. On stdout comes a line of
JSON for each column, its samples behind it as an Arrow stream, and a last line with "notes", or with "error" where it failed.
"""

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa

from lpvobs.ingest.recordings import Head, one_line
from lpvobs.io.safety.sandbox import limited

Heads = Callable[[Path, dict[str, str]], Iterator[tuple[str, Head]]]
"""From a file, and a mapping that takes notes, to its columns with their full names."""
Tables = Callable[[Path, Sequence[Any], dict[str, str]], Iterator[pa.Table]]
"""From a file, the places of the wanted columns, and notes, to a table of "values", and "time" [s] if it has its own, for each."""


def serve(heads: Heads, tables: Tables) -> None:
    """Answer within limits, and leave without a destructor of the library."""
    path = limited()
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the library prints
        try:
            _answer(path, heads, tables, out)
        except Exception as error:  # whatever a damaged byte leads to
            _tell(out, {"error": one_line(error) or type(error).__name__})
        out.flush()
        os._exit(0)


def _answer(path: Path, heads: Heads, tables: Tables, out: BinaryIO) -> None:
    wanted, notes = json.load(sys.stdin), dict[str, str]()
    if wanted is None:
        for full, head in heads(path, notes):
            _tell(out, {"full": full, **asdict(head)})
    else:
        for place, table in zip(wanted, tables(path, wanted, notes), strict=True):
            _tell(out, {"place": place})
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
