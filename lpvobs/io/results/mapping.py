"""Records as groups of an HDF5 file: one declaration says how a record is written, and what is refused when it is read back.

The kind of every value is that of the record's field: float, int, bool (as int8 with `no` and `yes`), text, an array of them, or a
tuple of them. The declaration adds what a reader of the file needs: name, unit, meaning, and axes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from types import UnionType
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

import h5py
import msgspec
import numpy as np
from numpy.typing import NDArray

from lpvobs.io.results.hdf import NO_YES, Attribute, Field, flags, text

Record = TypeVar("Record")
Values = NDArray[Any]
Labels = Mapping[str, Sequence[Any] | Values]
Contents = dict[str, Field | Attribute]


@dataclass(frozen=True)
class Item:
    """One dataset: unit, meaning, and the names of its axes in the same group, none for a single value or an axis.

    `of` is the record's field where it has another name; `meanings` are of small integers, and no other value is taken; `gaps` says
    that values may be NaN or infinite; `stored` is the type on the disk where it is not the field's, such as `f4` for drawings.
    """

    units: str
    long_name: str
    axes: tuple[str, ...] = ()
    of: str = ""
    meanings: Mapping[int, str] = field(default_factory=dict)
    gaps: bool = False
    stored: str = ""


ENDS = Item("1", "which end", meanings={0: "lower", 1: "upper"})


@dataclass(frozen=True)
class Layout(Generic[Record]):
    """How records of one kind stand in a group.

    Attributes
    ----------
    items : mapping of str to Item
        By name of the dataset.
    axes : mapping of str to Item or str
        Axes that are no field of the record, or their meaning: numbered from zero unless labels are given.
    attributes : tuple of str
        Fields that are attributes of the group; what is neither number nor text is written as JSON.
    row : str
        Axis along which several records stand, before the axes of each item; empty for a single record.
    """

    record: type[Record]
    items: Mapping[str, Item]
    axes: Mapping[str, Item | str] = field(default_factory=dict)
    attributes: tuple[str, ...] = ()
    row: str = ""

    def field_of(self, name: str) -> str:
        """Return the field behind a dataset."""
        return self.items[name].of or name

    def kind(self, field_name: str) -> Any:
        """Return the annotation of a field."""
        return _annotations(self.record)[field_name]  # type: ignore[arg-type]  # a class is hashable

    def axes_of(self, name: str) -> tuple[str, ...]:
        """Return the names of all axes of a dataset."""
        return (self.row, *self.items[name].axes) if self.row and name != self.row else self.items[name].axes


def fields(layout: Layout[Any], record: object, labels: Labels | None = None) -> Contents:
    """Return what a group holds of a record, or of another one with the same fields; `labels` stand on axes."""
    columns = {name: getattr(record, layout.field_of(name)) for name in layout.items}
    return _fields(layout, columns, labels or {}) | {
        key: _as_attribute(getattr(record, key)) for key in layout.attributes
    }


def rows(layout: Layout[Record], records: Sequence[Record], labels: Labels | None = None) -> Contents:
    """Return the datasets of several records, one after the other along the axis `row`; nothing for none."""
    columns = {name: [getattr(each, layout.field_of(name)) for each in records] for name in layout.items}
    return _fields(layout, columns, labels or {}) if records else {}


def values(group: h5py.Group, layout: Layout[Any]) -> dict[str, Any]:
    """Return the fields of a record that a group holds, by name.

    Raises KeyError, TypeError, ValueError for what is not there, or not as declared; `hdf.reading` makes a DataError of it.
    """
    names = {name: layout.field_of(name) for name in layout.items}
    found = {key: _as_field(_loaded(group, layout, name), layout.kind(key)) for name, key in names.items()}
    return found | {key: _attribute(group.attrs[key], layout.kind(key), key) for key in layout.attributes}


def read(group: h5py.Group, layout: Layout[Record], **given: Any) -> Record:
    """Return the record that a group holds, with the fields that are not stored in it as given."""
    return layout.record(**values(group, layout), **given)


def read_rows(group: h5py.Group, layout: Layout[Record]) -> tuple[Record, ...]:
    """Return the records along the axis `row`; none where the group has no such axis."""
    if layout.row not in group:
        return ()
    names = {layout.field_of(name): _loaded(group, layout, name) for name in layout.items}
    columns = [[_as_field(value, layout.kind(key)) for value in column] for key, column in names.items()]
    return tuple(layout.record(**dict(zip(names, row, strict=True))) for row in zip(*columns, strict=True))


def numbered(group: h5py.Group, name: str) -> list[h5py.Group]:
    """Return the groups `name_1`, `name_2` and so on that a group holds, in this order."""
    return [group[f"{name}_{i + 1}"] for i in range(sum(key.startswith(f"{name}_") for key in group))]


@cache
def _annotations(record: Any) -> dict[str, Any]:
    return get_type_hints(record)


def element_of(kind: Any) -> type:
    """Return the type of single values: float of `float | None`, of `tuple[float, ...]` and of an array of floats."""
    parts = [part for part in get_args(kind) if part is not type(None)]
    if not parts:
        return kind  # type: ignore[no-any-return]
    return element_of(parts[-1] if get_origin(kind) is np.ndarray else parts[0])


def _single(kind: Any) -> bool:
    return get_origin(kind) in (None, UnionType)


def _meanings(item: Item, element: type = int) -> Mapping[int, str]:
    return item.meanings or (NO_YES if element in (bool, np.bool_) else {})


def _fields(layout: Layout[Any], columns: Mapping[str, Any], labels: Labels) -> Contents:
    found: dict[str, Field] = {}
    for name, value in columns.items():
        item, element = layout.items[name], element_of(layout.kind(layout.field_of(name)))
        meanings = _meanings(item, element)
        dtype = item.stored or (np.int8 if meanings else np.dtype(element))
        stored = text(value) if element is str else np.asarray(value, dtype)
        found[name] = Field(stored, item.units, item.long_name, layout.axes_of(name), flags(meanings))
    axes: Contents = {}
    for name, meaning in layout.axes.items():
        item = meaning if isinstance(meaning, Item) else Item("1", meaning)
        size = next(each.values.shape[each.axes.index(name)] for each in found.values() if name in each.axes)
        marks = labels.get(name, np.arange(size, dtype=np.int8 if item.meanings else np.int32))
        shown = text(list(marks)) if isinstance(next(iter(marks), 0), str) else np.asarray(marks)
        axes[name] = Field(shown, item.units, item.long_name, (), flags(item.meanings))
    return axes | found


def _loaded(group: h5py.Group, layout: Layout[Any], name: str) -> Values:
    """Return a dataset as it is stored; raises for another kind, shape or value than the declaration has."""
    item, kind, axes = layout.items[name], layout.kind(layout.field_of(name)), layout.axes_of(name)
    dataset, element = group[name], element_of(kind)
    found = np.asarray(dataset.asstr()[()] if element is str else dataset[()])
    is_axis = not axes and (name == layout.row or not _single(kind))
    shape = (dataset.size,) if is_axis else tuple(group[axis].size for axis in axes)
    if found.shape != shape:
        raise ValueError(f"'{name}' has the shape {found.shape}, expected {shape}")
    if element is str:
        return found
    meanings = _meanings(item, element)
    if found.dtype.kind not in "fiu":
        raise ValueError(f"'{name}' holds {found.dtype}, expected numbers")
    if not item.gaps and not np.isfinite(found).all():
        raise ValueError(f"'{name}' holds what is not finite")
    if meanings and not np.isin(found, list(meanings)).all():
        raise ValueError(f"'{name}' holds other values than {', '.join(map(str, meanings))}")
    if np.dtype(element).kind in "iu" and (found != np.round(found)).any():
        raise ValueError(f"'{name}' holds fractions, expected whole numbers")
    return found


def _as_field(found: Values, kind: Any) -> Any:
    """Return what a dataset holds as the record has it."""
    element = element_of(kind)
    if get_origin(kind) is np.ndarray:
        return found.astype(element, copy=False)
    if get_origin(kind) is tuple:
        sizes = get_args(kind)
        if sizes[-1] is not Ellipsis and len(sizes) != found.size:
            raise ValueError(f"{found.size} values, expected {len(sizes)}")
        return tuple(map(element, found.tolist()))
    single = found.item() if isinstance(found, np.ndarray) else found
    if not isinstance(single, str) and np.isnan(single) and get_origin(kind) is UnionType:
        return None
    return element(single)


def _as_attribute(value: Any) -> Attribute:
    """Return what an attribute holds of a value: HDF5 has no booleans that every reader knows, and no tables."""
    if isinstance(value, bool):
        return np.int8(value)
    return value if isinstance(value, str | int | float | np.number) else msgspec.json.encode(value).decode()


def _attribute(found: Any, kind: Any, name: str) -> Any:
    """Return an attribute as the record has it."""
    plain = found.item() if isinstance(found, np.generic) else found
    if kind is bool and plain in (0, 1):
        return bool(plain)
    try:
        return msgspec.convert(plain, kind) if _single(kind) else msgspec.json.decode(plain, type=kind)
    except msgspec.MsgspecError as error:
        raise ValueError(f"attribute '{name}': {error}") from None
