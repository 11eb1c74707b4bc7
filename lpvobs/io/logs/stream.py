"""Logs of any length, read in slabs of half a million rows, so that memory does not grow with the log.

A log of one slab is what `read_log` makes of it. In a longer one time, gaps and repeated samples are followed from slab to slab;
the rules that look at a whole log, such as the plausible median of a channel, look at each slab, which is hours of driving: one
that they refuse is left out and counted, and the log is refused when that is most of it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.channels import Channel
from lpvobs.errors import DataError
from lpvobs.io.logs import reading as logs
from lpvobs.io.logs.parquet import state_of, unreadable
from lpvobs.io.logs.plausibility import refuse_implausible
from lpvobs.io.logs.reading import LogPolicies, UsableRows
from lpvobs.records import Array, Defects, Finding, Piece

if TYPE_CHECKING:
    import pyarrow as pa

SLAB = 1 << 19
"""Rows that are held in memory at a time."""
BATCH = 1 << 16
"""Rows that are decoded at a time."""


class LogFile:
    """A Parquet log as a recording; see `lpvobs.records.Recording`.

    Parameters
    ----------
    path : Path
    channels : mapping of str to Channel
        What the engine's air path needs.
    policies : LogPolicies
    threads : bool
        Whether to decode columns side by side; not where other processes have the other cores.

    Raises
    ------
    DataError
        Here, if the file is no log with these channels and units; from `pieces`, if what it holds cannot be used.
    """

    def __init__(self, path: Path, channels: Mapping[str, Channel], policies: LogPolicies, threads: bool = True):
        self.path, self.channels, self.policies, self.threads = path, channels, policies, threads
        self.units = {"time": "s"} | {name: channel.unit for name, channel in channels.items()}
        self._state = state_of(path)
        logs.expect_channels(path, self.units)
        self._kept: list[NDArray[np.uint8]] = []
        self._defects: Defects | None = None

    @property
    def name(self) -> str:
        """The stem of the file."""
        return self.path.stem

    @cached_property
    def sha256(self) -> str:
        """Digest of the file's bytes."""
        return logs.file_digest(self.path)

    @property
    def defects(self) -> Defects:
        """What was found and done; complete once the pieces have been read."""
        return self._defects or Defects(0)

    @property
    def kept(self) -> tuple[NDArray[np.uint8], ...]:
        """Which rows of each slab were used, eight in a byte; complete once the pieces have been read."""
        return tuple(self._kept)

    def pieces(self) -> Iterator[Piece]:
        """Yield the usable samples, one piece per slab that has any."""
        self._kept = []
        seen = _Seen()
        slabs = 0
        for table in slabs_of(self.path, list(self.units), self.threads):
            slabs += 1
            values = {name: logs.column_of(self.path, table, name, unit) for name, unit in self.units.items()}
            time = values.pop("time")
            rows = self._usable_rows(time, values, seen)
            mask = np.zeros(time.size, dtype=bool)
            mask[rows] = True
            self._kept.append(np.packbits(mask))
            self._defects = seen.defects()
            if rows.size:
                yield self._piece(time[rows], {name: column[rows] for name, column in values.items()}, seen)
        self._defects = seen.defects()
        self._refuse_poor(slabs, seen)
        logs.refuse_changed(self.path, self._state)

    def _usable_rows(self, time: Array, values: Mapping[str, Array], seen: "_Seen") -> NDArray[np.int64]:
        try:
            refuse_implausible(self.path, values, self.channels)
        except DataError as refusal:
            seen.leave_out(time.size, refusal)
            return np.empty(0, dtype=np.int64)
        usable = logs.usable_rows(self.path, time, values, self.channels, self.policies, seen.latest)
        seen.add(usable)
        return usable.rows

    def _piece(self, time: Array, channels: dict[str, Array], seen: "_Seen") -> Piece:
        begins = np.diff(time, prepend=seen.latest) > self.policies.gap_limit
        seen.gaps += int(np.count_nonzero(begins)) - (not np.isfinite(seen.latest))
        seen.samples += time.size
        seen.latest = float(time[-1])
        return Piece(time, channels, begins)

    def _refuse_poor(self, slabs: int, seen: "_Seen") -> None:
        if not seen.read:
            raise DataError(logs.NO_ROWS.format(path=self.path))
        if 2 * len(seen.refusals) > slabs:
            raise seen.refusals[0]
        if seen.samples < 2:
            raise logs.too_few(self.path, seen.samples, seen.read, seen.dropped, seen.findings)

    def references(self, kept: tuple[NDArray[np.uint8], ...], names: tuple[str, str]) -> Iterator[tuple[Array, ...]]:
        """Yield two channels and the sensor's true error at the rows kept, slab by slab; nothing where the file has none."""
        return references(self.path, {name: self.units[name] for name in names}, kept, self.threads)


def has_references(path: Path) -> bool:
    """Return whether a log knows the truth."""
    return logs.has_references(path)


def references(
    path: Path, units: Mapping[str, str], kept: tuple[NDArray[np.uint8], ...], threads: bool = True
) -> Iterator[tuple[Array, ...]]:
    """Yield channels in the units given and the sensor's true error at the rows kept, slab by slab."""
    wanted = {**units, "ref_delta_W_c": logs.REFERENCES["ref_delta_W_c"]}
    for table, mask in zip(slabs_of(path, list(wanted), threads), kept, strict=True):
        rows = np.flatnonzero(np.unpackbits(mask, count=table.num_rows))
        yield tuple(logs.column_of(path, table, name, unit)[rows] for name, unit in wanted.items())


def slabs_of(path: Path, columns: list[str], threads: bool = True) -> "Iterator[pa.Table]":
    """Yield the columns of a Parquet file as tables of at most `SLAB` rows, of equal length up to rounding."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path, buffer_size=1 << 20, pre_buffer=False) as file:
            rows = file.metadata.num_rows
            if rows <= SLAB:
                yield file.read(columns=columns, use_threads=threads)
                return
            slab = -(-rows // -(-rows // SLAB))  # as even as can be: no small one at the end to be judged by itself
            held: list[pa.RecordBatch] = []
            count = 0
            for batch in file.iter_batches(batch_size=BATCH, columns=columns, use_threads=threads):
                held.append(batch)
                count += batch.num_rows
                while count >= slab:
                    table = pa.Table.from_batches(held)
                    yield table.slice(0, slab)
                    held = table.slice(slab).to_batches()
                    count -= slab
            if held:
                yield pa.Table.from_batches(held)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise unreadable(path, error) from None


class _Seen:
    """What has been found in the slabs so far."""

    def __init__(self) -> None:
        self.read, self.samples, self.dropped_rows, self.gaps, self.repeated = 0, 0, 0, 0, 0
        self.latest = float("-inf")
        self.dropped: dict[str, int] = {}
        self.found: dict[tuple[str, str], Finding] = {}
        self.refusals: list[DataError] = []

    def add(self, usable: UsableRows) -> None:
        """Add what a slab lost; findings of a kind and channel are counted together."""
        self.read += usable.read
        self.dropped_rows += usable.dropped_rows
        self.repeated += usable.repeated
        for name, lost in usable.dropped.items():
            self.dropped[name] = self.dropped.get(name, 0) + lost
        for item in usable.findings:
            known = self.found.get((item.kind, item.channel))
            self.found[item.kind, item.channel] = (
                item if known is None else replace(known, samples=known.samples + item.samples)
            )

    def leave_out(self, rows: int, refusal: DataError) -> None:
        """Add a slab that was refused."""
        self.read += rows
        self.dropped_rows += rows
        self.refusals.append(refusal)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is stuck, saturated or spiked."""
        return tuple(self.found.values())

    def defects(self) -> Defects:
        """Return it as the record that results keep."""
        dropped = {name: lost for name, lost in self.dropped.items() if lost}
        return Defects(self.read, dropped, self.dropped_rows, self.gaps, self.repeated, self.findings)
