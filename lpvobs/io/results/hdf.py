"""HDF5 the way xarray, MATLAB and h5py read it unchanged: dimension scales, units, no booleans, no compounds."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from lpvobs.errors import DataError, UsageError
from lpvobs.io.safety import atomic, seal
from lpvobs.records import Item

Attribute = str | int | float | np.number[Any]
NO_YES = {0: "no", 1: "yes"}
DAMAGE = (LookupError, AttributeError, OSError, ValueError, TypeError, RuntimeError, MemoryError, UsageError)
"""What comes of a dataset that is not there, or not what it should be."""


@dataclass(frozen=True)
class Field:
    """A dataset to write: its values, and what they are, with the names of their axes in the same group."""

    values: Any
    item: Item


Contents = dict[str, "Field | Attribute | Contents"]
"""What a group holds by name: fields, attributes, and what groups in it hold."""


def write_group(parent: h5py.Group, name: str, contents: Contents) -> h5py.Group:
    """Write contents into a new group; a field that others name as an axis becomes their dimension scale."""
    return write_fields(parent.create_group(name), contents)


def write_fields(group: h5py.Group, contents: Contents) -> h5py.Group:
    """Write contents into an empty group or file, as `write_group` does."""
    fields = {key: field for key, field in contents.items() if isinstance(field, Field)}
    scales = {axis for field in fields.values() for axis in field.item.axes}
    for key, field in fields.items():
        packed = "gzip" if _mostly_empty(field.values) else None
        dataset = group.create_dataset(key, data=field.values, compression=packed)
        dataset.attrs["units"], dataset.attrs["long_name"] = field.item.unit, field.item.meaning
        if field.item.meanings:  # the CF attributes that say what small integers mean
            dataset.attrs["flag_values"] = np.array(list(field.item.meanings), dtype=np.int8)
            dataset.attrs["flag_meanings"] = " ".join(field.item.meanings.values())
        if key in scales:
            dataset.make_scale(key)
    for key, field in fields.items():
        for dimension, axis in enumerate(field.item.axes):
            group[key].dims[dimension].attach_scale(group[axis])
    group.attrs.update({key: value for key, value in contents.items() if not isinstance(value, Field | dict)})
    for key, value in contents.items():
        if isinstance(value, dict):
            write_group(group, key, value)
    return group


def _mostly_empty(values: Any) -> bool | np.bool_:
    """Return whether a large array is mostly about nodes that no drive informs, which compress to nothing."""
    held = np.asarray(values)
    return held.size > 10_000 and (held.dtype.kind != "f" or 2 * np.count_nonzero(np.nan_to_num(held)) < held.size)


def text(values: Sequence[str]) -> Any:
    """Return strings as an array that every reader understands: variable-length UTF-8."""
    return np.array(list(values), dtype=h5py.string_dtype())


@contextmanager
def creating(target: Path, kind: str = "") -> Iterator[h5py.File]:
    """Yield a new HDF5 file, of a kind that `reading` knows, that takes the target's place, sealed, if the block has no error."""
    with changing(None, target) as file:
        if kind:
            file.attrs["schema"] = f"lpvobs/{kind}/1"
        yield file


@contextmanager
def changing(source: Path | None, target: Path) -> Iterator[h5py.File]:
    """Yield a copy of an HDF5 file for changes; it takes the target's place, sealed, when the block ends without an error."""
    with atomic.replacing(target) as temporary:
        name, mode = (temporary.name, "w") if source is None else (source, "r+")
        with h5py.File(name, mode, driver="core", backing_store=False) as file:
            yield file
            file.flush()
            image = bytes(file.id.get_file_image())
        temporary.write_bytes(seal.sealed(image))


def is_hdf5(path: Path) -> bool:
    """Return whether a file begins as HDF5 does; raises DataError if it may not be read."""
    try:
        return bool(h5py.is_hdf5(path))
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else error
        raise DataError(f"{path}: cannot be read ({reason}); check your permission to read this file") from None


@contextmanager
def reading(path: Path, kind: str, remedy: str) -> Iterator[h5py.File]:
    """Yield an open HDF5 file whose root attribute `schema` is `lpvobs/<kind>/1`.

    Raises DataError if it is absent, not HDF5, damaged, of another kind, or garbles a dataset that is read inside the block.
    """
    if not path.is_file():
        raise DataError(f"{path}: no such file; {remedy}")
    if not is_hdf5(path):
        raise DataError(f"{path}: not a readable HDF5 file; {remedy}")
    seal.expect_sound(path, remedy)
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise DataError(f"{path}: not a readable HDF5 file; {remedy}") from None
    with file:
        seal.expect_self_contained(file, f"{path}", remedy)
        try:
            schema = str(file.attrs.get("schema", ""))
            if schema != f"lpvobs/{kind}/1":
                its = f"{schema.split('/')[1]} file" if schema.count("/") == 2 else "file that lpvobs did not write"
                own, its = (f"an {each}" if each.startswith("engine") else f"a {each}" for each in (kind, its))
                raise DataError(f"{path}: not {own} file but {its}; {remedy}")
            yield file
        except DAMAGE as error:
            raise DataError(f"{path}: damaged {kind} file ({error}); {remedy}") from None
