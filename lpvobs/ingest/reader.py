"""The process that reads a MAT or MDF file for another one, see `lpvobs.io.safety.sandbox`.

On stdin stands JSON: the format, and a list of the full names of the columns to read, or null for a list of what there is. On
stdout comes a line of JSON for each column, its samples behind it as an Arrow stream, and a last line with "notes", or with "error"
where it failed. SciPy reads MAT files of version 5 (-v6, -v7), h5py those of 7.3, which are HDF5, and asammdf MDF files.
"""

import json
import logging
import os
import re
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np
import pyarrow as pa

from lpvobs.ingest.recordings import Head, one_line
from lpvobs.io.safety.sandbox import limited

UNIT_FIELDS = ("unit", "units", "Unit", "Units")
TIMES = ("time", "t")
LONGEST_UNIT = 40
Field = tuple[str, str, Any, object]
"""A field: its structure's dotted name, its own, its value (text or an array of numbers), and a unit that is said of it alone."""
DEEPEST = 8  # conversions inside conversions
_FORMULA = re.compile(
    r"(?:[\s+\-*/(),]|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|X1?(?!\w)"
    r"|(?:a?(?:sin|cos|tan)h?|arc(?:sin|cos|tan)|sqrt|exp|log|log10|abs)(?=\s*\())*"
)
"""Arithmetic. The library hands formulas to evaluators that run Python, and takes one that fails for no conversion at all."""
Columns = Mapping[str, tuple[Head, Callable[[], "pa.Table"]]]
"""By full name: what is known of a column, and what reads it as a table of "values", and "time" [s] if it has stamps of its own."""


def serve() -> None:
    """Answer within limits, and leave without a destructor of the library."""
    path = limited()
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the library prints
        try:
            _answer(path, out)
        except Exception as error:  # whatever a damaged byte leads to
            _tell(out, {"error": one_line(error) or type(error).__name__})
        out.flush()
        os._exit(0)


def _answer(path: Path, out: BinaryIO) -> None:
    (kind, wanted), notes = json.load(sys.stdin), dict[str, str]()
    with {"MAT": mat, "MDF": mdf}[kind](path, notes) as columns:
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


@contextmanager
def mat(path: Path, notes: dict[str, str]) -> Iterator[Columns]:
    """Yield the vectors of real numbers in a MAT file by their dotted names; the mapping takes notes.

    A structure's text field `unit` is the unit of the vectors beside it, those that are called time or t excepted.
    """
    with path.open("rb") as stream:
        first = stream.read(128)
        if b"MATLAB 7.3" not in first and first[:4] != b"\x89HDF":
            yield _vectors(_fields(_document(stream), ""))
            return
    import h5py

    with h5py.File(path, "r") as file:
        yield _vectors(_hdf_fields(file, notes))


def _vectors(fields: Iterable[Field]) -> Columns:
    fields = list(fields)
    texts = {(structure, name): value for structure, name, value, _ in fields if isinstance(value, str)}
    numbers = [field for field in fields if not isinstance(field[2], str)]
    _expect_once(structure + name for structure, name, *_ in numbers)
    found = {}
    for structure, name, values, own in numbers:
        beside = (texts[structure, key] for key in UNIT_FIELDS if (structure, key) in texts)
        unit = "" if name in TIMES else as_text(next(beside, own))
        found[structure + name] = (Head(structure + name, unit, values.size), partial(_table, values))
    return found


def _table(values: Any) -> pa.Table:
    return pa.table({"values": native(values[()].ravel())})


def _expect_once(names: Iterable[str]) -> None:
    twice = next((name for name, often in Counter(names).items() if often > 1), None)
    if twice is not None:
        raise ValueError(f"variable '{twice}' appears twice")


def _document(stream: IO[bytes]) -> Mapping[str, Any]:
    """Return the variables of a file of version 5; structures are dicts, arrays of them lists of dicts."""
    from scipy.io import loadmat, whosmat

    with warnings.catch_warnings():
        warnings.filterwarnings("error", "Unreadable variable")
        _expect_once(name for name, _, _ in whosmat(stream))
        return {name: value for name, value in loadmat(stream, simplify_cells=True).items() if name[:2] != "__"}


def _fields(document: Mapping[str, Any], prefix: str) -> Iterator[Field]:
    """Yield the texts, and the vectors of real numbers, in nested structures."""
    for key, value in document.items():
        if isinstance(value, dict):
            yield from _fields(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            for number, item in enumerate(value, 1):
                if isinstance(item, dict):
                    yield from _fields(item, f"{prefix}{key}({number}).")
        elif isinstance(value, str):
            yield prefix, key, value[:LONGEST_UNIT], ""
        elif getattr(value, "ndim", 0) == 1 and value.size > 1 and value.dtype.kind in "iufb":
            yield prefix, key, value, ""


def _hdf_fields(file: Any, notes: dict[str, str]) -> list[Field]:
    """Return the same of a file of version 7.3."""
    import h5py

    found: list[Field] = []
    odd: list[str | bytes] = []

    def look(path: str | bytes, item: Any) -> None:
        if not isinstance(path, str) or not path.isprintable():
            odd.append(path)
            return
        if path.startswith("#") or not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
            return  # '#refs#' holds what cells point to; other files are not followed
        if item.shape is None or "MATLAB_empty" in item.attrs:
            return
        folder, _, name = path.rpartition("/")
        prefix = f"{folder}/".lstrip("/").replace("/", ".")
        if as_text(item.attrs.get("MATLAB_class")) == "char":
            if name in UNIT_FIELDS and item.dtype.kind == "u" and 0 < item.size <= LONGEST_UNIT:
                text = item[()].ravel().astype("<u2").tobytes().decode("utf-16-le", errors="replace")
                found.append((prefix, name, text, ""))
        elif item.dtype.kind in "iufb" and item.dtype.itemsize <= 8 and item.size == max(item.shape, default=0) > 1:
            found.append((prefix, name, item, item.attrs.get("units", item.attrs.get("unit"))))

    file.visititems(look)  # goes along hard links alone
    if odd:
        notes["names"] = f"{len(odd)} objects were left out, because their names are not text"
    return found


@contextmanager
def mdf(path: Path, notes: dict[str, str]) -> Iterator[Columns]:
    """Yield every channel of an MDF file that is not a time base; a name that several groups have is called group:name.

    The first of what the library complains of meanwhile becomes a note.
    """
    from asammdf import MDF

    said = BufferingHandler(capacity=10_000)
    said.setLevel(logging.WARNING)
    logging.getLogger("asammdf").handlers = [said]
    file = MDF(path, process_bus_logging=False)
    channels = [
        (number, index, channel, int(group.channel_group.cycles_nr))
        for number, group in enumerate(file.groups)
        for index, channel in enumerate(group.channels)
        if index != file.masters_db.get(number)
    ]
    often = Counter(str(channel.name) for _, _, channel, _ in channels)
    found = {}
    for number, index, channel, size in channels:
        name = str(channel.name)
        head = Head(name, _unit(channel), size)
        found[name if often[name] == 1 else f"{number}:{name}"] = (head, partial(_channel, file, number, index, notes))
    yield found
    if said.buffer:
        notes["asammdf says"] = one_line(said.buffer[0].getMessage())


def _channel(file: Any, group: int, index: int, notes: dict[str, str]) -> pa.Table:
    """Return one channel in physical values with its own stamps; samples marked invalid are empty."""
    channels = file.groups[group].channels
    name = str(channels[index].name)
    for place in {index, file.masters_db.get(group, index)}:
        _look_through(channels[place].conversion, str(channels[place].name), 0)
    signal = file.get(group=group, index=index, ignore_invalidation_bits=True)
    samples = np.asarray(signal.samples)
    if samples.ndim != 1 or samples.dtype.kind not in "iufbSU" or samples.dtype == np.longdouble:
        raise ValueError(
            f"channel '{name}' holds {samples.dtype} with {samples.ndim} dimensions, expected one number per time stamp"
        )
    if samples.dtype.kind in "SU":  # a conversion to text; ingest says so with an example
        values = pa.array([as_text(item) for item in samples], pa.string())
    else:
        mask = np.asarray(signal.invalidation_bits, dtype=bool) if signal.invalidation_bits is not None else None
        if mask is not None and mask.any():
            notes[f"invalid in {name}"] = f"{np.count_nonzero(mask)} samples that the file marks as invalid"
        values = pa.array(native(samples), mask=mask)
    stamps = np.ascontiguousarray(np.asarray(signal.timestamps, dtype=float))
    if stamps.shape != samples.shape:
        raise ValueError(
            f"channel '{name}' has {samples.size} samples and {stamps.size} time stamps, expected as many as samples"
        )
    return pa.table({"values": values, "time": pa.array(stamps)})


def _look_through(conversion: Any, name: str, depth: int) -> None:
    """Refuse a conversion with a formula that is no arithmetic, also inside of other conversions."""
    if conversion is None:
        return
    if depth > DEEPEST:
        raise ValueError(f"channel '{name}' has conversions inside conversions, more than {DEEPEST} levels deep")
    formula = getattr(conversion, "formula", "") or ""
    if formula:
        expect_arithmetic(formula.rstrip("\0"), name)
    for inner in (getattr(conversion, "referenced_blocks", None) or {}).values():
        if not isinstance(inner, (bytes, str)):
            _look_through(inner, name, depth + 1)


def expect_arithmetic(formula: str, name: str) -> None:
    """Raise ValueError for a formula of a channel that is more than arithmetic of X, or that cannot be computed."""
    from numexpr import evaluate

    if not _FORMULA.fullmatch(formula):
        raise ValueError(
            f"channel '{name}' has the conversion formula '{one_line(formula)}', expected only arithmetic with X"
        )
    numbers = np.array([1.0, 2.0])
    try:
        evaluate(formula.replace("X1", "X"), {"X": numbers})
    except Exception:
        raise ValueError(
            f"channel '{name}' has the conversion formula '{one_line(formula)}', which cannot be computed"
        ) from None


def _unit(channel: Any) -> str:
    """Return the unit of a channel; MDF 3 keeps it with the conversion."""
    found = getattr(channel, "unit", "") or getattr(channel.conversion, "unit", "") or ""
    return as_text(found).strip(" \0")


if __name__ == "__main__":
    serve()
