"""MAT files of version 5, and of version 7.3, which is HDF5; structures become dotted names."""

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpvobs.errors import DataError
from lpvobs.ingest.mat5 import HEADER, read_mat5, unpacked_size
from lpvobs.ingest.profiles import SourceRules
from lpvobs.ingest.recordings import Column, Head, check_samples, check_size
from lpvobs.io.safety.seal import expect_readable

UNIT_FIELDS = ("unit", "units", "Unit", "Units")
TIMES = ("time", "t")
UNPACKING = 3.0
"""Times the unpacked size that unpacking takes: pieces, put together, with their head."""
LONGEST_UNIT = 40
HDF_FAILURES = (OSError, KeyError, ValueError, RuntimeError, TypeError)


@dataclass(frozen=True)
class MatRecording:
    """A MAT file; `vectors` holds the numbers of version 5, `places` the paths of those of 7.3, which are read when wanted."""

    path: Path
    heads: Mapping[str, Head]
    vectors: Mapping[str, Any]
    places: Mapping[str, str] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)

    def read(self, names: Sequence[str]) -> Mapping[str, Column]:
        """Return vectors as they are stored."""
        import pyarrow as pa

        check_samples(self.path, [self.heads[name].size for name in names])
        vectors = self.vectors or self._read_hdf(names)
        return {name: Column(pa.array(_native(vectors[name]))) for name in names}

    def _read_hdf(self, names: Sequence[str]) -> Mapping[str, Any]:
        import h5py

        try:
            with h5py.File(self.path, "r") as file:
                return {name: file[self.places[name]][()] for name in names}
        except HDF_FAILURES as error:
            raise _unreadable(self.path, error) from None


def open_mat(path: Path, rules: SourceRules) -> MatRecording:
    """Return a MAT file with the names, units and lengths of its numeric vectors.

    A structure's text field `unit` is the unit of the vectors beside it, those that are called time or t excepted.
    """
    with path.open("rb") as stream:
        first = stream.read(HEADER)
    if b"MATLAB 7.3" in first or first[:4] == b"\x89HDF":
        return _open_hdf(path)
    return _open_v5(path)


def _open_v5(path: Path) -> MatRecording:
    try:
        check_size(path, UNPACKING * unpacked_size(path))
        flat = list(_flat(read_mat5(path), ""))
        vectors = {name: (unit, values) for name, unit, values in flat}
        if len(vectors) < len(flat):
            raise ValueError("two variables have the same name once their structures are named before it")
    except (OSError, ValueError, struct.error, zlib.error) as error:
        raise _unreadable(path, error) from None
    heads = {name: Head(name, unit, values.size) for name, (unit, values) in vectors.items()}
    return MatRecording(path, heads, {name: values for name, (_, values) in vectors.items()})


def _flat(document: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str, Any]]:
    """Yield dotted name, unit and values of every numeric vector in nested structures."""
    unit = next((document[key] for key in UNIT_FIELDS if isinstance(document.get(key), str)), "")
    for key, value in document.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            for number, item in enumerate(value, 1):
                yield from _flat(item, f"{prefix}{key}({number}).")
        elif isinstance(value, np.ndarray) and value.size > 1:
            yield f"{prefix}{key}", "" if key in TIMES else unit[:LONGEST_UNIT], value


def _open_hdf(path: Path) -> MatRecording:
    import h5py

    heads: dict[str, Head] = {}
    places: dict[str, str] = {}
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
        if _class(item) == "char":
            if own in UNIT_FIELDS and item.dtype.kind == "u" and 0 < item.size <= LONGEST_UNIT:
                units.setdefault(folder, "".join(map(_letter, item[()].ravel())))
        elif item.dtype.kind in "iufb" and item.dtype.itemsize <= 8 and item.size == max(item.shape, default=0) > 1:
            dotted = name.replace("/", ".")
            if dotted in heads:
                raise ValueError(f"two variables are called '{dotted}'")
            heads[dotted], places[dotted] = Head(dotted, "" if own in TIMES else _own_unit(item), item.size), name

    expect_readable(path, "export it again")
    try:
        with h5py.File(path, "r") as file:
            file.visititems(look)  # goes along hard links alone
    except HDF_FAILURES as error:
        raise _unreadable(path, error) from None
    for dotted, name in places.items():
        folder, _, own = name.rpartition("/")
        if folder in units and own not in TIMES:
            heads[dotted] = replace(heads[dotted], unit=units[folder])
    notes = {"names": f"{len(odd)} objects whose names are no text, left out"} if odd else {}
    return MatRecording(path, heads, {}, places, notes)


def _class(item: Any) -> str:
    return _word(item.attrs.get("MATLAB_class", b""))


def _own_unit(item: Any) -> str:
    """Return the unit in a dataset's own attribute."""
    return _word(item.attrs.get("units", item.attrs.get("unit", "")))


def _word(found: object) -> str:
    """Return an attribute as text, nothing for one that is something else."""
    text = found.decode(errors="replace") if isinstance(found, bytes) else found if isinstance(found, str) else ""
    return text.encode(errors="replace").decode()


def _letter(code: int) -> str:
    """Return a character of MATLAB's text, which is UTF-16."""
    return chr(code) if code < 0xD800 or 0xE000 <= code < 0x10000 else "\ufffd"


def _native(values: Any) -> Any:
    """Return a vector in the machine's own byte order."""
    flat = np.ravel(values)
    return np.ascontiguousarray(flat.astype(flat.dtype.newbyteorder("="), copy=False))


def _unreadable(path: Path, error: Exception) -> DataError:
    return DataError(
        f"{path}: not a readable MAT file ({' '.join(str(error).split())[:200]}); save it again, -v7 or -v7.3"
    )
