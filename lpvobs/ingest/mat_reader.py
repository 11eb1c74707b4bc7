"""Reads MAT files, see `lpvobs.ingest.reader`: SciPy those of version 5 (-v6, -v7), h5py those of 7.3, which are HDF5.

Of what a file holds, the vectors of real numbers count. A structure's text field `unit` is the unit of the vectors beside it, those
that are called time or t excepted.
"""

import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Any

import pyarrow as pa

from lpvobs.ingest import reader
from lpvobs.ingest.recordings import Head

UNIT_FIELDS = ("unit", "units", "Unit", "Units")
TIMES = ("time", "t")
LONGEST_UNIT = 40
Field = tuple[str, str, Any, object]
"""A field: its structure's dotted name, its own, its value (text or an array of numbers), and a unit that is said of it alone."""


@contextmanager
def opened(path: Path, notes: dict[str, str]) -> Iterator[reader.Columns]:
    """Yield the vectors of a file by their dotted names."""
    with path.open("rb") as stream:
        first = stream.read(128)
        if b"MATLAB 7.3" not in first and first[:4] != b"\x89HDF":
            yield _vectors(_fields(_document(stream), ""))
            return
    import h5py

    with h5py.File(path, "r") as file:
        yield _vectors(_hdf_fields(file, notes))


def _vectors(fields: Iterable[Field]) -> reader.Columns:
    fields = list(fields)
    texts = {(structure, name): value for structure, name, value, _ in fields if isinstance(value, str)}
    numbers = [field for field in fields if not isinstance(field[2], str)]
    _expect_once(structure + name for structure, name, *_ in numbers)
    found = {}
    for structure, name, values, own in numbers:
        beside = (texts[structure, key] for key in UNIT_FIELDS if (structure, key) in texts)
        unit = "" if name in TIMES else reader.as_text(next(beside, own))
        found[structure + name] = (Head(structure + name, unit, values.size), partial(_table, values))
    return found


def _table(values: Any) -> pa.Table:
    return pa.table({"values": reader.native(values[()].ravel())})


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
        if reader.as_text(item.attrs.get("MATLAB_class")) == "char":
            if name in UNIT_FIELDS and item.dtype.kind == "u" and 0 < item.size <= LONGEST_UNIT:
                text = item[()].ravel().astype("<u2").tobytes().decode("utf-16-le", errors="replace")
                found.append((prefix, name, text, ""))
        elif item.dtype.kind in "iufb" and item.dtype.itemsize <= 8 and item.size == max(item.shape, default=0) > 1:
            found.append((prefix, name, item, item.attrs.get("units", item.attrs.get("unit"))))

    file.visititems(look)  # goes along hard links alone
    if odd:
        notes["names"] = f"{len(odd)} objects were left out, because their names are not text"
    return found


if __name__ == "__main__":
    reader.serve(opened)
