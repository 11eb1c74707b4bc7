"""MAT files of version 5, and of version 7.3, which is HDF5; structures become dotted names."""

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lpvobs.errors import DataError
from lpvobs.io.mat5 import HEADER, read_mat5, unpacked_size
from lpvobs.io.profiles import SourceRules
from lpvobs.io.recordings import Column, Head, check_size
from lpvobs.io.seal import expect_sound

UNIT_FIELDS = ("unit", "units", "Unit", "Units")
TIMES = ("time", "t")


@dataclass(frozen=True)
class MatRecording:
    """A MAT file; `vectors` holds the numbers of version 5, and is empty for 7.3, which is read column by column."""

    path: Path
    heads: Mapping[str, Head]
    vectors: Mapping[str, Any]
    notes: Mapping[str, str] = field(default_factory=dict)

    def read(self, names: Sequence[str]) -> Mapping[str, Column]:
        """Return vectors as they are stored."""
        import pyarrow as pa

        vectors = self.vectors or self._read_hdf(names)
        return {name: Column(pa.array(_native(vectors[name]))) for name in names}

    def _read_hdf(self, names: Sequence[str]) -> Mapping[str, Any]:
        import h5py

        check_size(self.path, 16.0 * sum(self.heads[name].size for name in names))
        try:
            with h5py.File(self.path, "r") as file:
                return {name: file[name.replace(".", "/")][()] for name in names}
        except (OSError, KeyError, ValueError, RuntimeError) as error:
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
        check_size(path, 2.0 * unpacked_size(path))
        document = read_mat5(path)
    except (OSError, ValueError, struct.error, zlib.error) as error:
        raise _unreadable(path, error) from None
    vectors = {name: (unit, values) for name, unit, values in _flat(document, "")}
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
            yield f"{prefix}{key}", "" if key in TIMES else unit, value


def _open_hdf(path: Path) -> MatRecording:
    import h5py

    heads: dict[str, Head] = {}

    def look(name: str, item: Any) -> None:
        if name.startswith("#") or not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
            return  # '#refs#' holds what cells point to; other files are not followed
        number = item.dtype.kind in "iufb" and "MATLAB_empty" not in item.attrs and _class(item) != "char"
        if number and item.size == max(item.shape, default=0) and item.size > 1:
            dotted = name.replace("/", ".")
            is_time = dotted.rsplit(".", 1)[-1] in TIMES
            heads[dotted] = Head(dotted, "" if is_time else _hdf_unit(item), item.size)

    expect_sound(path, "export it again")
    try:
        with h5py.File(path, "r") as file:
            file.visititems(look)
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise _unreadable(path, error) from None
    return MatRecording(path, heads, {})


def _class(item: Any) -> str:
    found = item.attrs.get("MATLAB_class", b"")
    return found.decode(errors="replace") if isinstance(found, bytes) else str(found)


def _hdf_unit(item: Any) -> str:
    """Return the unit of a dataset: the text beside it in its structure, or its own attribute."""
    for key in UNIT_FIELDS:
        beside = item.parent.get(key)
        if beside is not None and _class(beside) == "char" and 0 < beside.size <= 40:
            return "".join(map(chr, beside[()].ravel()))
    own = item.attrs.get("units", item.attrs.get("unit", ""))
    return own.decode(errors="replace") if isinstance(own, bytes) else str(own)


def _native(values: Any) -> Any:
    """Return a vector in the machine's own byte order."""
    flat = np.ravel(values)
    return np.ascontiguousarray(flat.astype(flat.dtype.newbyteorder("="), copy=False))


def _unreadable(path: Path, error: Exception) -> DataError:
    return DataError(
        f"{path}: not a readable MAT file ({' '.join(str(error).split())[:200]}); save it again, -v7 or -v7.3"
    )
