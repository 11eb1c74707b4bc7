"""Reading and writing logs: one drive, one Parquet file, units in the fields' metadata, SI inside."""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.channels import Channel
from lpvobs.errors import DataError
from lpvobs.io.logs.parquet import metadata_of, refuse_huge, schema_of, state_of, unreadable
from lpvobs.io.logs.plausibility import refuse_implausible, refuse_odd_rate, spoiled
from lpvobs.io.logs.units import convert
from lpvobs.io.safety.atomic import replacing
from lpvobs.records import Array, Defects, Finding, Log

if TYPE_CHECKING:
    import pyarrow as pa

REFERENCES = {"ref_W_c": "kg/s", "ref_delta_W_c": "kg/s"}

NO_ROWS = "{path}: the log has no rows; expected at least two samples; record or export it again"

MOST_BACKWARD = 0.1
"""Share of the samples that may be dropped for their time; more is not a repair."""


@dataclass(frozen=True)
class LogPolicies:
    """What to do with defects; the configuration's `[policies]`.

    Attributes
    ----------
    gap_limit : float
        [s]; a longer step between samples splits the log into segments.
    backward_time : str
        `refuse` the log, or `drop` the samples whose time is not later than every earlier one.
    """

    gap_limit: float = 1.0
    backward_time: str = "refuse"

    def __post_init__(self) -> None:
        if not self.gap_limit > 0:
            raise ValueError("gap_limit must be positive")
        if self.backward_time not in ("refuse", "drop"):
            raise ValueError("backward_time must be 'refuse' or 'drop'")


@dataclass(frozen=True)
class References:
    """The truth behind a simulated log, at the samples of the log it belongs to.

    Attributes
    ----------
    W_c : ndarray, shape (N,)
        [kg/s], true flow.
    delta_W_c : ndarray, shape (N,)
        [kg/s], the sensor's error surface at the true operating point.
    """

    W_c: Array
    delta_W_c: Array


def read_log(path: Path, channels: Mapping[str, Channel], policies: LogPolicies, auxiliary: bool = False) -> Log:
    """Return the log in a Parquet file, in SI units, with defects treated as the policies say.

    Parameters
    ----------
    path : Path
    channels : mapping of str to Channel
        What the engine's air path needs.
    policies : LogPolicies
    auxiliary : bool
        Read the other numeric channels, too. References are never among them.

    Raises
    ------
    DataError
        If the file is not a log: unreadable, empty, a channel or its unit missing or wrong, time not increasing.
    """
    wanted = {"time": "s"} | {name: channel.unit for name, channel in channels.items()}
    before = state_of(path)
    metadata = metadata_of(path)
    schema = expect_channels(path, wanted)
    extra = _numeric(schema, wanted) if auxiliary else []
    refuse_huge(path, metadata.num_rows, len(wanted) + len(extra))
    table = _read(path, [*wanted, *extra])
    values = {name: column_of(path, table, name, unit) for name, unit in wanted.items()}
    time = values.pop("time")
    if time.size == 0:
        raise DataError(NO_ROWS.format(path=path))
    refuse_implausible(path, values, channels)
    usable = usable_rows(path, time, values, channels, policies)
    rows = usable.rows
    if rows.size < 2:
        raise too_few(path, rows.size, time.size, usable.dropped, usable.findings)
    time = time[rows]
    digest = file_digest(path)
    refuse_changed(path, before)
    return Log(
        name=path.stem,
        sha256=digest,
        time=time,
        channels={name: column[rows] for name, column in values.items()},
        auxiliary={name: _as_floats(table, name)[rows] for name in extra},
        segments=_segments(time, policies.gap_limit),
        rows=rows,
        defects=Defects(
            samples_read=usable.read,
            dropped={name: count for name, count in usable.dropped.items() if count},
            dropped_rows=usable.dropped_rows,
            gaps=int(np.count_nonzero(np.diff(time) > policies.gap_limit)),
            repeated=usable.repeated,
            findings=usable.findings,
        ),
    )


@dataclass(frozen=True)
class UsableRows:
    """What is left of the rows of a log or of a stretch of it, and what was taken away.

    Attributes
    ----------
    rows : ndarray of int, shape (n,)
    read, dropped_rows, repeated, dropped, findings
        As in `lpvobs.records.Defects`; dropped names every channel.
    """

    rows: NDArray[np.int64]
    read: int
    dropped: Mapping[str, int]
    dropped_rows: int
    repeated: int
    findings: tuple[Finding, ...]


def usable_rows(
    path: Path,
    time: Array,
    values: Mapping[str, Array],
    channels: Mapping[str, Channel],
    policies: LogPolicies,
    latest: float = -math.inf,
) -> UsableRows:
    """Return the rows that are finite, possible, later than each other and than `latest`, and neither stuck nor spiked.

    Raises
    ------
    DataError
        For time that runs backward, where the policies do not drop it, and for an odd rate.
    """
    keep, dropped = _usable(time, values, channels)
    rows, repeated = _increasing(path, time, np.flatnonzero(keep), policies, latest)
    refuse_odd_rate(path, time[rows], policies.gap_limit)
    findings = []
    for finding, samples in list(spoiled(time[rows], {name: values[name][rows] for name in values}, channels)):
        findings.append(finding)
        dropped[finding.channel] += samples.size
        keep[rows[samples]] = False
    lost = int(keep.size - np.count_nonzero(keep))
    return UsableRows(rows[keep[rows]], time.size, dropped, lost, repeated, tuple(findings))


def refuse_changed(path: Path, before: tuple[int, ...]) -> None:
    """Raise DataError if somebody has written to a file since its state was `before`."""
    if state_of(path) != before:
        raise DataError(
            f"{path}: changed while it was read; expected a finished file; wait for the recorder and try again"
        )


def read_references(path: Path, rows: NDArray[np.int64]) -> References | None:
    """Return the truth beside a log's samples, or None where the file has none."""
    if not has_references(path):
        return None
    table = _read(path, list(REFERENCES))
    columns = [column_of(path, table, name, unit)[rows] for name, unit in REFERENCES.items()]
    return References(*columns)


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


def write_log(
    path: Path, channels: Mapping[str, Array], units: Mapping[str, str], metadata: Mapping[str, str] | None = None
) -> None:
    """Write channels of equal length to a Parquet log, the unit of each in its field's metadata.

    `metadata` is kept with the file, for example what `ingest` did to make it.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in channels]
    table = pa.table([pa.array(column) for column in channels.values()], schema=pa.schema(fields, metadata=metadata))
    with replacing(path) as temporary:
        pq.write_table(table, temporary, compression="zstd", row_group_size=1 << 16)


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def expect_channels(path: Path, units: Mapping[str, str]) -> "pa.Schema":
    """Return the schema of a log; raises DataError unless each channel is there once and says its unit."""
    schema = _schema(path)
    for name, unit in units.items():
        _expect(path, schema, name, unit)
    return schema


def too_few(
    path: Path, usable: int, read: int, dropped: Mapping[str, int], findings: Sequence[Finding] = ()
) -> DataError:
    """Return what is wrong with a log of which next to nothing is left."""
    worst = max(dropped, key=lambda name: dropped[name], default="time")
    kinds = sorted({finding.kind for finding in findings if finding.channel == worst})
    why = f" ({', '.join(kinds)})" if kinds else ""
    return DataError(
        f"{path}: {usable} of {read} samples are usable, expected at least two; "
        f"channel '{worst}' spoils the most{why}, see `lpvobs inspect`"
    )


def _schema(path: Path) -> "pa.Schema":
    """Return the schema of a Parquet file, or say why it is not a log."""
    return schema_of(path, metadata_of(path))


def _read(path: Path, columns: list[str]) -> "pa.Table":
    """Return the columns of a Parquet file whose schema could be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            return file.read(columns=columns)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise unreadable(path, error) from None


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
        values = _as_floats(table, name)
    except pa.ArrowException:
        raise DataError(
            f"{path}: channel '{name}' holds {field.type}, expected numbers in {wanted}; export it as numbers"
        ) from None
    try:
        return np.asarray(convert(values, _unit(field), wanted), dtype=float)
    except ValueError as error:
        raise DataError(f"{path}: channel '{name}' has the {error}; give it a unit of the same kind") from None


def _usable(
    time: Array, values: Mapping[str, Array], channels: Mapping[str, Channel]
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """Return which rows are finite and physically possible in every channel, and how often each channel is not."""
    keep = np.isfinite(time)
    dropped = {"time": int(np.count_nonzero(~keep))}
    for name, column in values.items():
        possible = (column >= channels[name].low) & (column <= channels[name].high)  # False for NaN
        dropped[name] = int(np.count_nonzero(~possible))
        keep &= possible
    return keep, dropped


def _increasing(
    path: Path, time: Array, rows: NDArray[np.int64], policies: LogPolicies, latest: float = float("-inf")
) -> tuple[NDArray[np.int64], int]:
    """Return the rows whose time is later than every earlier one and `latest`, and how many were removed for it."""
    kept = time[rows]
    if kept.size == 0:
        return rows, 0
    before = np.maximum.accumulate(np.concatenate(([latest], kept)))[:-1]
    later = kept > before
    wrong = int(np.count_nonzero(~later))
    if wrong and policies.backward_time == "refuse":
        first = int(np.flatnonzero(~later)[0])
        raise DataError(
            f"{path}: channel 'time' repeats or runs backward {wrong} times, first at {kept[first]:.6g} s after "
            f"{before[first]:.6g} s (row {rows[first]}); expected strictly increasing; "
            f'repair the log or set backward_time = "drop" in [policies]'
        )
    if wrong > MOST_BACKWARD * kept.size:
        raise DataError(
            f"{path}: channel 'time' repeats or runs backward at {wrong} of {kept.size} samples, expected at most "
            f"{100 * MOST_BACKWARD:.0f} %; one stamp far in the future does that: repair the log"
        )
    return rows[later], wrong


def _segments(time: Array, gap_limit: float) -> tuple[tuple[int, int], ...]:
    """Return the half-open ranges of samples between gaps."""
    cuts = (np.flatnonzero(np.diff(time) > gap_limit) + 1).tolist()
    return tuple(zip([0, *cuts], [*cuts, time.size], strict=True))


def _numeric(schema: "pa.Schema", needed: Mapping[str, str]) -> list[str]:
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


def _as_floats(table: "pa.Table", name: str) -> Array:
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
