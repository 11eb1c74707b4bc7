"""The channels of a Parquet log as arrays: there once, with a unit, in SI."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lpvobs.errors import DataError
from lpvobs.io.logs.parquet import metadata_of, schema_of
from lpvobs.io.logs.units import convert
from lpvobs.records import Array

if TYPE_CHECKING:
    import pyarrow as pa

REFERENCES = {"ref_W_c": "kg/s", "ref_delta_W_c": "kg/s"}
"""What only a simulated log knows."""


def expect_channels(path: Path, units: Mapping[str, str]) -> "pa.Schema":
    """Return the schema of a log; raises DataError unless each channel is there once and says its unit."""
    schema = _schema(path)
    for name, unit in units.items():
        _expect(path, schema, name, unit)
    return schema


def has_references(path: Path) -> bool:
    """Return whether a log knows the truth; raises DataError for a truth without unit."""
    schema = _schema(path)
    if not set(schema.names) >= set(REFERENCES):
        return False
    for name, unit in REFERENCES.items():
        _expect(path, schema, name, unit)
    return True


def channel_units(path: Path) -> dict[str, str]:
    """Return the unit of every channel in a file, empty where it has none."""
    return {field.name: _unit(field) for field in _schema(path)}


def _schema(path: Path) -> "pa.Schema":
    """Return the schema of a Parquet file, or say why it is not a log."""
    return schema_of(path, metadata_of(path))


def _expect(path: Path, schema: "pa.Schema", name: str, wanted: str) -> None:
    """Raise unless a channel is there once and says its unit."""
    found = schema.get_all_field_indices(name)
    if len(found) != 1:
        state = "missing" if not found else f"there {len(found)} times"
        present = " ".join(", ".join(schema.names[:20]).split()) or "none"
        raise DataError(f"{path}: channel '{name}' is {state}; expected once, in {wanted}; present: {present}")
    if not _unit(schema.field(found[0])):
        raise DataError(
            f"{path}: channel '{name}' has no unit; expected '{wanted}' or one that converts to it "
            f"in the field's metadata under the key 'unit'"
        )


def _unit(field: "pa.Field") -> str:
    return str((field.metadata or {}).get(b"unit", b"").decode(errors="replace")).strip()


def column_of(path: Path, table: "pa.Table", name: str, wanted: str) -> Array:
    """Return one channel as floats in the wanted unit, NaN where the file has null."""
    import pyarrow as pa

    field = table.schema.field(name)
    try:
        if not _is_numeric(field.type):
            raise pa.ArrowTypeError(str(field.type))
        values = as_floats(table, name)
    except pa.ArrowException:
        raise DataError(
            f"{path}: channel '{name}' holds {field.type}, expected numbers in {wanted}; export it as numbers"
        ) from None
    try:
        return np.asarray(convert(values, _unit(field), wanted), dtype=float)
    except ValueError as error:
        raise DataError(f"{path}: channel '{name}' has the {error}; give it a unit of the same kind") from None


def further_channels(schema: "pa.Schema", needed: Mapping[str, str]) -> list[str]:
    """Return the numeric channels that the air path does not need; references stay out."""

    def wanted(field: "pa.Field") -> bool:
        return _is_numeric(field.type) and field.name not in needed and not field.name.startswith("ref_")

    return [field.name for field in schema if wanted(field) and len(schema.get_all_field_indices(field.name)) == 1]


def _is_numeric(kind: "pa.DataType") -> bool:
    """Return whether a column of this type holds numbers; text that looks like numbers does not."""
    import pyarrow as pa

    if pa.types.is_dictionary(kind):
        return _is_numeric(kind.value_type)
    tests = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_boolean)
    return any(test(kind) for test in tests)


def as_floats(table: "pa.Table", name: str) -> Array:
    """Return a column as floats, NaN for null.

    Chunk by chunk through DLPack: pyarrow's own conversion imports pandas, which takes longer than reading the log.
    """
    import pyarrow as pa

    column = table.column(name)
    if column.type != pa.float64():
        column = column.cast(pa.float64(), safe=False)  # large whole numbers are rounded
    if column.null_count:
        import pyarrow.compute as pc  # takes a while to load, and few logs need it

        column = pc.fill_null(column, float("nan"))
    return np.concatenate([np.empty(0), *(np.from_dlpack(chunk) for chunk in column.chunks)])
