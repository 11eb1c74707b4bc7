"""Logs as the engine's air path needs them: SI inside, with defects treated as the policies say.

A log of any length is read in slabs of half a million rows, so that memory does not grow with it; `read_log` takes it whole. In
a long one time, gaps and repeated samples are followed from slab to slab; the rules that look at a whole log, such as the plausible
median of a channel, look at each slab, which is hours of driving: one that they refuse is left out and counted, and the log is
refused when that is most of it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.channels import Channel
from lpvobs.errors import DataError
from lpvobs.io.arrow import pa
from lpvobs.io.logs import parquet
from lpvobs.io.logs.policies import LogPolicies, refuse_implausible, together, usable_rows
from lpvobs.io.safety.atomic import state_of
from lpvobs.records import Array, Defects, Log, Piece, gathered

SLAB = 1 << 19  # rows that are held in memory at a time


class LogFile:
    """A Parquet log as a recording, with the channels that the engine's air path needs; see `lpvobs.records.Recording`.

    Raises DataError here, if the file is no log with these channels and units; from `pieces`, if what it holds cannot be used.
    `threads` is whether to decode columns side by side; not where other processes have the other cores.
    """

    def __init__(self, path: Path, channels: Mapping[str, Channel], policies: LogPolicies, threads: bool = True):
        self.path, self.name, self.policies, self.threads = path, path.stem, policies, threads
        self._state, self.schema = state_of(path), parquet.schema_of(path)
        there = self.schema.names
        self.absent = [name for name, item in channels.items() if item.one_of is not None and name not in there]
        for name in self.absent:
            if not channels[name].may_lack(there):
                wanted = " or ".join(f"'{item}'" for item in (name, *(channels[name].one_of or ())))
                raise DataError(f"{path}: the log has no channel {wanted}; record at least one of these channels, too")
        self.channels = {name: item for name, item in policies.limited(channels).items() if name not in self.absent}
        self.units = {"time": "s"} | {name: channel.unit for name, channel in self.channels.items()}
        parquet.expect(path, self.schema, self.units)
        # which rows of each slab were used, eight in a byte, and what was found; complete once the pieces have been read
        self.kept: tuple[NDArray[np.uint8], ...] = ()
        self.defects = Defects(0)

    @cached_property
    def sha256(self) -> str:
        """Digest of the file's bytes."""
        return parquet.log_digest(self.path)

    def pieces(self) -> Iterator[Piece]:
        """Yield the usable samples, put right where the policies know the sensors."""
        return iter(self.policies.right(piece for _, _, piece in self.slabs((), SLAB)))

    def slabs(self, further: Sequence[str], most: int) -> Iterator[tuple["pa.Table", NDArray[np.int64], Piece]]:
        """Yield tables of at most so many rows, with further channels as they are, their usable rows, and what these hold."""
        self.kept, self.defects = (), Defects(0)
        samples, latest, refusals = 0, -np.inf, list[DataError]()
        for table in parquet.tables_of(self.path, [*self.units, *further], most, self.threads):
            values = {name: parquet.column_of(self.path, table, name, unit) for name, unit in self.units.items()}
            time = values.pop("time")
            try:
                refuse_implausible(self.path, values, self.channels)
            except DataError as refusal:
                rows, lost = np.empty(0, dtype=np.int64), Defects(time.size, dropped_rows=time.size)
                refusals.append(refusal)
            else:
                rows, lost = usable_rows(self.path, time, values, self.channels, self.policies, latest)
            self.defects = together(self.defects, lost)
            mask = np.zeros(time.size, dtype=bool)
            mask[rows] = True
            self.kept += (np.packbits(mask),)
            if rows.size:
                time = time[rows]
                begins = np.diff(time, prepend=latest) > self.policies.gap_limit
                gaps = int(np.count_nonzero(begins)) - (not np.isfinite(latest))
                self.defects = together(self.defects, Defects(0, gaps=gaps))
                samples, latest = samples + time.size, float(time[-1])
                channels = {name: column[rows] for name, column in values.items()}
                channels |= dict.fromkeys(self.absent, np.full(time.size, np.nan))
                yield table, rows, Piece(time, channels, begins)
        self._refuse_poor(samples, refusals)
        _ = self.sha256  # before the last look at the file, so that it is that of the bytes that were read
        if state_of(self.path) != self._state:
            raise DataError(
                f"{self.path}: the file changed while it was read, expected a finished file; wait until the recording has ended"
            )

    def _refuse_poor(self, samples: int, refusals: Sequence[DataError]) -> None:
        found = self.defects
        if not found.samples_read:
            raise DataError(f"{self.path}: the log has no rows, expected at least two rows; record or export it again")
        if 2 * len(refusals) > len(self.kept):
            raise refusals[0]
        if samples < 2:
            worst = max(found.dropped, key=found.dropped.__getitem__, default="time")
            kinds = sorted({finding.kind for finding in found.findings if finding.channel == worst})
            why = f" ({', '.join(kinds)})" if kinds else ""
            raise DataError(
                f"{self.path}: {samples} of {found.samples_read} samples are usable, expected at least two; "
                f"channel '{worst}' makes more samples unusable than any other channel{why}; see `lpvobs inspect`"
            )


def read_log(
    path: Path, channels: Mapping[str, Channel], policies: LogPolicies, auxiliary: bool = False, seconds: float = np.inf
) -> Log:
    """Return the log in a Parquet file, in SI units, with defects treated as the policies say; raises DataError for no such log.

    The channels are what the engine's air path needs; `auxiliary` reads the other numeric ones, too, references never. Of a
    beginning of so many `seconds` they are left out where they do not fit into memory.
    """
    file, whole = LogFile(path, channels, policies), not np.isfinite(seconds)
    once = (field for field in file.schema if auxiliary and len(file.schema.get_all_field_indices(field.name)) == 1)
    numbers = {field.name: parquet.unit_of(field) for field in once if parquet.is_numeric(field.type)}
    extra = [name for name in numbers if name not in file.units and not name.startswith("ref_")]
    if whole:
        parquet.refuse_huge(path, parquet.metadata_of(path).num_rows, len(file.units) + len(extra))
    elif SLAB * (len(file.units) + len(extra)) > parquet.MOST_READINGS:
        extra = []
    pieces: list[Piece] = []
    read: list[tuple[NDArray[np.int64], list[Array]]] = []
    before = 0
    for table, rows, piece in file.slabs(extra, parquet.MOST_READINGS if whole else SLAB):
        n = int(np.searchsorted(piece.time, (pieces or [piece])[0].time[0] + seconds))
        pieces.append(piece.first(n))
        read.append((before + rows[:n], [parquet.as_floats(table.column(name))[rows[:n]] for name in extra]))
        before += table.num_rows
        if n < piece.time.size:
            break
    where, columns = zip(*read, strict=True)
    others = {name: np.concatenate(each) for name, *each in zip(extra, *columns, strict=True)}
    units = {name: numbers[name] for name in extra if numbers[name]}
    return replace(gathered(file, policies.right(pieces)), auxiliary=others, rows=np.concatenate(where), units=units)


def read_references(path: Path, rows: NDArray[np.int64]) -> dict[str, Array] | None:
    """Return the truth at a log's samples, true flow and the sensor's error surface there, or None where the file has none."""
    if not parquet.has_references(path):
        return None
    (table,) = parquet.tables_of(path, list(parquet.REFERENCES), parquet.MOST_READINGS)
    return {name: parquet.column_of(path, table, name, unit)[rows] for name, unit in parquet.REFERENCES.items()}


def references(
    path: Path, units: Mapping[str, str], kept: tuple[NDArray[np.uint8], ...]
) -> Iterator[tuple[Array, ...]]:
    """Yield channels in the units given and the sensor's true error at the rows kept, slab by slab."""
    wanted = {**units, "ref_delta_W_c": parquet.REFERENCES["ref_delta_W_c"]}
    for table, mask in zip(parquet.tables_of(path, list(wanted), SLAB), kept, strict=True):
        rows = np.flatnonzero(np.unpackbits(mask, count=table.num_rows))
        yield tuple(parquet.column_of(path, table, name, unit)[rows] for name, unit in wanted.items())
