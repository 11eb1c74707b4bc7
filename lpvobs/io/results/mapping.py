"""Records as groups of an HDF5 file: what a record says of its fields is how they are written, and what is refused on reading.

A field with an `Item` is a dataset. Its kind is that of the field: float, int, bool (as int8 with `no` and `yes`), text, an
array or a tuple of them, or a table by name, whose names stand on its first axis. A record with an `Item` is a group of that
name (`.`: its fields stand among the others), several records are groups `name_1`, `name_2` and so on, or rows where the item
has an axis, in a group of their own if it has a name, too. Fields without an item are attributes if they are plain; arrays and
records without one are left to the caller.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from types import UnionType
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

import h5py
import msgspec
import numpy as np
from numpy.typing import NDArray

from lpvobs.io.configuration.strict import is_mapping, record_in
from lpvobs.io.results.hdf import NO_YES, Attribute, Contents, Field, text, write_group
from lpvobs.records import Item

Record = TypeVar("Record")
Values = NDArray[Any]
Labels = Mapping[str, Sequence[Any] | Values]

AXES = msgspec.toml.decode(files("lpvobs.io.results").joinpath("axes.toml").read_bytes(), type=dict[str, Item])


@dataclass(frozen=True)
class Layout(Generic[Record]):
    """How a record stands in a group: its fields with items, and those that are attributes, as JSON if neither number nor text."""

    record: type[Record]
    items: Mapping[str, Item]
    attributes: tuple[str, ...] = ()

    def kind(self, key: str) -> Any:
        """Return the annotation of a field."""
        return _hints(self.record)[key]  # type: ignore[arg-type]  # a class is hashable

    def name(self, key: str) -> str:
        """Return what a field is called in its group."""
        return self.items[key].name or key

    def on(self, axes: Callable[[str, tuple[str, ...]], tuple[str, ...]]) -> "Layout[Record]":
        """Return the layout with other axes, which a function says from the name of a field and its own ones."""
        items = {key: replace(item, axes=axes(self.name(key), item.axes)) for key, item in self.items.items()}
        return replace(self, items=items)

    @property
    def datasets(self) -> list[str]:
        """The fields that are datasets."""
        return [key for key in self.items if record_in(self.kind(key)) is None]

    @property
    def inner(self) -> list[str]:
        """The fields that hold records."""
        return [key for key in self.items if record_in(self.kind(key)) is not None]


@cache
def layout_of(record: Any) -> Layout[Any]:
    """Return the layout that a record's annotations say."""
    hints = get_type_hints(record, include_extras=True)
    every = [(key, item) for key, hint in hints.items() for item in getattr(hint, "__metadata__", ())]
    said = {key: item for key, item in every if isinstance(item, Item)}
    plain = (
        key for key, kind in _hints(record).items() if record_in(kind) is None and get_origin(kind) is not np.ndarray
    )
    return Layout(record, said, tuple(key for key in plain if key not in said))


def fields(what: type[Record] | Layout[Record], record: object, labels: Labels | None = None) -> Contents:
    """Return what a group holds of a record, or of another one with the same fields; `labels` stand on axes."""
    layout, known = _layout(what), labels or {}
    found: Contents = {}
    for key in layout.inner:
        value, item, name = getattr(record, key), layout.items[key], layout.name(key)
        if item.axes:
            inside = rows(value, item.axes[0], known)
            found |= {name: inside} if item.name else inside
        elif name == ".":
            found |= fields(type(value), value, known)
        elif isinstance(value, tuple):
            found |= {f"{name}_{number}": fields(type(each), each, known) for number, each in enumerate(value, 1)}
        elif value is not None:
            found[name] = fields(type(value), value, known)
    found |= _fields(layout, {key: getattr(record, key) for key in layout.datasets}, known)
    return found | {key: _as_attribute(getattr(record, key)) for key in layout.attributes}


def rows(records: Sequence[object], row: str, labels: Labels | None = None) -> Contents:
    """Return the datasets of several records of one kind, one after the other along an axis; nothing for none."""
    if not records:
        return {}
    layout = _rowwise(type(records[0]), row)
    columns = {key: [getattr(each, key) for each in records] for key in layout.datasets}
    return _fields(layout, columns, labels or {})


def write(
    parent: h5py.Group, name: str, record: object, labels: Labels | None = None, beside: Contents | None = None
) -> h5py.Group:
    """Write a record, the records in it, and what stands beside them, into a new group."""
    return write_group(parent, name, fields(type(record), record, labels) | (beside or {}))


def read(group: h5py.Group, what: type[Record] | Layout[Record], **given: Any) -> Record:
    """Return the record that a group holds, with the fields that are not stored in it as given."""
    return _layout(what).record(**values(group, what, given), **given)


def read_if_there(group: h5py.Group | None, what: type[Record] | Layout[Record]) -> Record | None:
    """Return the record that a group holds, None where there is no group: the `get` of its parent."""
    return None if group is None else read(group, what)


def values(group: h5py.Group, what: type[Any] | Layout[Any], given: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the fields of a record that a group holds, but those given; `hdf.reading` makes a DataError of what this raises."""
    layout, known = _layout(what), given or {}
    found = {key: _value(group, layout, key) for key in layout.datasets if key not in known}
    found |= {key: _attribute(group.attrs[key], layout.kind(key), key) for key in layout.attributes if key not in known}
    return found | {key: _inner(group, layout, key) for key in layout.inner if key not in known}


def read_rows(group: h5py.Group | None, record: type[Record], row: str) -> tuple[Record, ...]:
    """Return the records along an axis; none where there is no group, or it has no such axis."""
    if group is None or row not in group:
        return ()
    layout = _rowwise(record, row)
    columns = [[_as_field(x, layout.kind(key)) for x in _loaded(group, layout, key, row)] for key in layout.datasets]
    return tuple(record(**dict(zip(layout.datasets, line, strict=True))) for line in zip(*columns, strict=True))


def numbered(group: h5py.Group, name: str) -> list[h5py.Group]:
    """Return the groups `name_1`, `name_2` and so on that a group holds, in this order."""
    folder, _, stem = name.rpartition("/")
    beside = group.get(folder, ()) if folder else group
    return [group[f"{name}_{i + 1}"] for i in range(sum(key.startswith(f"{stem}_") for key in beside))]


def _inner(group: h5py.Group, layout: Layout[Any], key: str) -> Any:
    item, kind, name = layout.items[key], layout.kind(key), layout.name(key)
    record: Any = record_in(kind)
    if item.axes:
        return read_rows(group.get(item.name) if item.name else group, record, item.axes[0])
    if get_origin(kind) is tuple:
        return tuple(read(each, record) for each in numbered(group, name))
    return None if get_origin(kind) is UnionType and name not in group else read(group[name], record)


def _layout(what: type[Record] | Layout[Record]) -> Layout[Record]:
    return what if isinstance(what, Layout) else layout_of(what)  # type: ignore[arg-type]


def _rowwise(record: Any, row: str) -> Layout[Any]:
    """Return the layout of a record with an axis before those of each item, that of the axis itself excepted."""
    layout = layout_of(record)
    return layout.on(lambda name, axes: axes if name == row else (row, *axes))


@cache
def _hints(record: Any) -> dict[str, Any]:
    return get_type_hints(record)


def element_of(kind: Any) -> type:
    """Return the type of single values: float of `float | None`, of `tuple[float, ...]`, of an array or a table of floats."""
    parts = [part for part in get_args(kind) if part is not type(None)]
    if not parts:
        return kind  # type: ignore[no-any-return]
    return element_of(parts[-1] if get_origin(kind) is np.ndarray or is_mapping(kind) else parts[0])


def _meanings(item: Item, element: type) -> Mapping[int, str]:
    return item.meanings or (NO_YES if element in (bool, np.bool_) else {})


def _fields(layout: Layout[Any], columns: Mapping[str, Any], labels: Labels) -> Contents:
    found: dict[str, Field] = {}
    known = dict(labels)
    for key, value in columns.items():
        item, element, stored = layout.items[key], element_of(layout.kind(key)), value
        if is_mapping(layout.kind(key)):
            if not value:
                continue
            names = known.setdefault(item.axes[0], list(value))
            stored = [value[name] for name in names]
        meanings = _meanings(item, element)
        dtype = item.stored or (np.int8 if meanings else np.dtype(element))
        shown = text(stored) if element is str else np.asarray(stored, dtype)
        found[layout.name(key)] = Field(shown, replace(item, meanings=meanings))
    axes: Contents = {}
    for each in found.values():
        for axis, size in zip(each.item.axes, each.values.shape, strict=False):
            same = axis.removeprefix("other_")
            if same in found and axis not in found:
                axes[axis] = found[same]
            elif same in AXES and axis not in found:
                marks = known.get(same, np.arange(size, dtype=np.int8 if AXES[same].meanings else np.int32))
                shown = text(list(marks)) if isinstance(next(iter(marks), 0), str) else np.asarray(marks)
                axes[axis] = Field(shown, AXES[same])
    return {**axes, **found}


def _value(group: h5py.Group, layout: Layout[Any], key: str) -> Any:
    kind = layout.kind(key)
    if not is_mapping(kind):
        return _as_field(_loaded(group, layout, key), kind)
    names, one = layout.items[key].axes[0], get_args(kind)[1]
    if names not in group:
        return {}
    found = zip(group[names].asstr()[()], _loaded(group, layout, key), strict=True)
    return {str(name): _as_field(value, one) for name, value in found}


def _loaded(group: h5py.Group, layout: Layout[Any], key: str, row: str = "") -> Values:
    """Return a dataset as it is stored; raises for another kind, shape or value than the declaration has."""
    item, kind, name = layout.items[key], layout.kind(key), layout.name(key)
    dataset, element = group[name], element_of(kind)
    found = np.asarray(dataset.asstr()[()] if element is str else dataset[()])
    is_axis = not item.axes and (name == row or get_origin(kind) not in (None, UnionType))
    shape = (dataset.size,) if is_axis else tuple(group[axis].size for axis in item.axes)
    if found.shape != shape:
        raise ValueError(f"'{name}' has the shape {found.shape}, expected {shape}")
    if element is str:
        return found
    meanings = _meanings(item, element)
    if found.dtype.kind not in "fiu":
        raise ValueError(f"'{name}' holds {found.dtype}, expected numbers")
    if not item.gaps and not np.isfinite(found).all():
        raise ValueError(f"'{name}' has values that are not finite")
    if meanings and not np.isin(found, list(meanings)).all():
        raise ValueError(f"'{name}' has values other than {', '.join(map(str, meanings))}")
    if np.dtype(element).kind in "iu" and (found != np.round(found)).any():
        raise ValueError(f"'{name}' has fractions, expected whole numbers")
    return found


def _as_field(found: Values, kind: Any) -> Any:
    """Return what a dataset holds as the record has it."""
    element = element_of(kind)
    if get_origin(kind) is np.ndarray:
        return found.astype(element, copy=False)
    if get_origin(kind) is tuple:
        sizes = get_args(kind)
        if sizes[-1] is not Ellipsis and len(sizes) != found.size:
            raise ValueError(f"a dataset has {found.size} values, expected {len(sizes)}")
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
    plain = found.item() if isinstance(found, np.generic) else found
    if kind is bool and plain in (0, 1):
        return bool(plain)
    try:
        as_json = isinstance(plain, str) and kind is not str
        return msgspec.json.decode(plain, type=kind) if as_json else msgspec.convert(plain, kind)
    except msgspec.MsgspecError as error:
        raise ValueError(f"attribute '{name}': {error}") from None
