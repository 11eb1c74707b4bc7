"""Reads MAT files, see `lpvobs.ingest.reader`: SciPy those of version 5 (-v6, -v7), h5py those of 7.3, which are HDF5.

Of what a file holds, the vectors of real numbers count. A structure's text field `unit` is the unit of the vectors beside it, those
that are called time or t excepted.
"""

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lpvobs.ingest import reader
from lpvobs.ingest.recordings import Head

UNIT_FIELDS = ("unit", "units", "Unit", "Units")
TIMES = ("time", "t")
LONGEST_UNIT = 40


def heads(path: Path, notes: dict[str, str]) -> Iterator[tuple[str, Head]]:
    """Yield the vectors of a file."""
    if _is_hdf(path):
        found = list(_hdf_heads(path, notes))
    else:
        vectors = _flat(_document(path), "")
        found = [Head(name, unit, values.size, name) for name, unit, values in vectors]
    _expect_once(head.name for head in found)
    yield from ((head.name, head) for head in found)


def tables(path: Path, wanted: Sequence[str], notes: dict[str, str]) -> Iterator[pa.Table]:
    """Yield the wanted vectors."""
    if _is_hdf(path):
        import h5py

        with h5py.File(path, "r") as file:
            for place in wanted:
                yield pa.table({"values": reader.native(file[place][()].ravel())})
    else:
        vectors = {name: values for name, _, values in _flat(_document(path), "")}
        for place in wanted:
            yield pa.table({"values": reader.native(vectors[place])})


def _is_hdf(path: Path) -> bool:
    with path.open("rb") as stream:
        first = stream.read(128)
    return b"MATLAB 7.3" in first or first[:4] == b"\x89HDF"


def _expect_once(names: Iterator[str]) -> None:
    twice = next((name for name, often in Counter(names).items() if often > 1), None)
    if twice is not None:
        raise ValueError(f"variable '{twice}' appears twice")


def _document(path: Path) -> Mapping[str, Any]:
    """Return the variables of a file of version 5; structures are dicts, arrays of them lists of dicts."""
    from scipy.io import loadmat, whosmat

    with path.open("rb") as stream, warnings.catch_warnings():
        warnings.filterwarnings("error", "Unreadable variable")
        _expect_once(name for name, _, _ in whosmat(stream))
        return {name: value for name, value in loadmat(stream, simplify_cells=True).items() if name[:2] != "__"}


def _flat(document: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str, Any]]:
    """Yield dotted name, unit and values of every vector of real numbers in nested structures."""
    unit = next((document[key] for key in UNIT_FIELDS if isinstance(document.get(key), str)), "")
    for key, value in document.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            for number, item in enumerate(value, 1):
                if isinstance(item, dict):
                    yield from _flat(item, f"{prefix}{key}({number}).")
        elif isinstance(value, np.ndarray) and value.ndim == 1 and value.size > 1 and value.dtype.kind in "iufb":
            yield f"{prefix}{key}", "" if key in TIMES else reader.as_text(unit[:LONGEST_UNIT]), value


def _hdf_heads(path: Path, notes: dict[str, str]) -> Iterator[Head]:
    import h5py

    found: list[Head] = []
    units: dict[str, str] = {}
    odd: list[str | bytes] = []

    def look(name: str | bytes, item: Any) -> None:
        if not isinstance(name, str) or not name.isprintable():
            odd.append(name)
            return
        if name.startswith("#") or not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
            return  # '#refs#' holds what cells point to; other files are not followed
        if item.shape is None or "MATLAB_empty" in item.attrs:
            return
        folder, _, own = name.rpartition("/")
        if reader.as_text(item.attrs.get("MATLAB_class")) == "char":
            if own in UNIT_FIELDS and item.dtype.kind == "u" and 0 < item.size <= LONGEST_UNIT:
                units.setdefault(folder, item[()].ravel().astype("<u2").tobytes().decode("utf-16-le", errors="replace"))
        elif item.dtype.kind in "iufb" and item.dtype.itemsize <= 8 and item.size == max(item.shape, default=0) > 1:
            unit = "" if own in TIMES else reader.as_text(item.attrs.get("units", item.attrs.get("unit")))
            dotted = name.replace("/", ".")
            found.append(Head(dotted, unit, item.size, name))

    with h5py.File(path, "r") as file:
        file.visititems(look)  # goes along hard links alone
    if odd:
        notes["names"] = f"{len(odd)} objects were left out, because their names are not text"
    for item in found:
        folder, _, own = item.place.rpartition("/")
        beside = units.get(folder) if own not in TIMES else None
        yield item if beside is None else replace(item, unit=beside)


if __name__ == "__main__":
    reader.serve(heads, tables)
