"""MDF recordings of measurement systems: many groups of channels, each with a time base of its own."""

import logging
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lpvobs.errors import DataError, UsageError
from lpvobs.io.profiles import SourceRules
from lpvobs.io.recordings import Column, Head, check_size

MAGIC = (b"MDF     ", b"UnFinMF ")


@dataclass(frozen=True)
class MdfRecording:
    """An MDF file; `places` is group and index of each channel."""

    path: Path
    heads: Mapping[str, Head]
    places: Mapping[str, tuple[int, int]]
    notes: dict[str, str] = field(default_factory=dict)

    def read(self, names: Sequence[str]) -> Mapping[str, Column]:
        """Return channels in physical values with their own stamps; samples marked invalid are empty."""
        check_size(self.path, 16.0 * sum(self.heads[name].size for name in names))
        with _opened(self.path, self.notes) as file:
            return {name: self._column(file, name) for name in names}

    def _column(self, file: Any, name: str) -> Column:
        import pyarrow as pa

        group, index = self.places[name]
        signal = file.get(group=group, index=index, ignore_invalidation_bits=True)
        samples = np.asarray(signal.samples)
        if samples.ndim != 1 or samples.dtype.kind not in "iufbSU":
            raise DataError(
                f"{self.path}: channel '{name}' holds {samples.dtype} of {samples.ndim} axes, expected a number per stamp"
            )
        if samples.dtype.kind in "SU":  # a conversion to text; ingest says so with an example
            return Column(pa.array([_text(item) for item in samples]), np.asarray(signal.timestamps, dtype=float))
        mask = np.asarray(signal.invalidation_bits, dtype=bool) if signal.invalidation_bits is not None else None
        if mask is not None and mask.any():
            self.notes[f"invalid in {name}"] = f"{np.count_nonzero(mask)} samples that the file marks so"
        native = np.ascontiguousarray(samples.astype(samples.dtype.newbyteorder("="), copy=False))
        return Column(pa.array(native, mask=mask), np.asarray(signal.timestamps, dtype=float))


def open_mdf(path: Path, rules: SourceRules) -> MdfRecording:
    """Return an MDF file with its channels; a name that several groups have is called group:name."""
    notes: dict[str, str] = {}
    with _opened(path, notes) as file:
        found = [
            (number, index, channel.name, _unit(channel), int(group.channel_group.cycles_nr))
            for number, group in enumerate(file.groups)
            for index, channel in enumerate(group.channels)
            if index != file.masters_db.get(number)
        ]
    often = Counter(name for _, _, name, _, _ in found)
    heads, places = {}, {}
    for group, index, name, unit, size in found:
        full = name if often[name] == 1 else f"{group}:{name}"
        heads[full], places[full] = Head(name, unit, size), (group, index)
    return MdfRecording(path, heads, places, notes)


class _Said(logging.Handler):
    """Gathers what the library would print on stderr."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the message in one line."""
        self.lines.append(" ".join(record.getMessage().split())[:200])


@contextmanager
def _listening() -> Iterator[list[str]]:
    """Yield the list that the library's messages go to while the block runs."""
    logger, said = logging.getLogger("asammdf"), _Said()
    handlers, propagate = logger.handlers, logger.propagate
    logger.handlers, logger.propagate = [said], False
    try:
        yield said.lines
    finally:
        logger.handlers, logger.propagate = handlers, propagate


@contextmanager
def _opened(path: Path, notes: dict[str, str]) -> Iterator[Any]:
    """Yield an open MDF file; what its library raises becomes an error of the data, what it says a note."""
    try:
        from asammdf import MDF
    except ImportError:
        raise UsageError(
            f"{path}: MDF needs the library asammdf, which is not installed; pip install 'lpvobs[mdf]'"
        ) from None
    _check_kind(path)
    file = None
    with _listening() as said:
        try:
            file = MDF(path, process_bus_logging=False)
            yield file
        except DataError:
            raise
        except Exception as error:  # the library raises whatever a damaged byte leads to
            _abandon(error)
            reason = " ".join(str(error).split())[:200]
            raise DataError(f"{path}: not a readable MDF file ({reason}); record or export it again") from None
        finally:
            if file is not None:
                file.close()
    if said:
        notes["asammdf says"] = said[0]


def _check_kind(path: Path) -> None:
    """Refuse what the library would unpack, or take for its own copy of an archive and delete."""
    with path.open("rb") as stream:
        magic = stream.read(8)
    if magic not in MAGIC:
        raise DataError(
            f"{path}: does not begin like an MDF file; unpack it, or leave format out of the profile's [source]"
        )
    if path.suffix.lower() in (".zip", ".mf4z", ".gzip", ".gz", ".bz2"):
        raise DataError(f"{path}: is an MDF file under an archive's name; rename it to .mf4")


def _abandon(error: Exception) -> None:
    """Close what the library left half open, whose destructor would otherwise complain on stderr."""
    trace = error.__traceback__
    while trace is not None:
        owner: Any = trace.tb_frame.f_locals.get("self")
        if hasattr(owner, "_closed"):
            with suppress(
                Exception
            ):  # it lacks what it did not come to set; the second call, from the destructor, does nothing
                owner.close()
        trace = trace.tb_next


def _unit(channel: Any) -> str:
    """Return the unit of a channel; MDF 3 keeps it with the conversion."""
    found = getattr(channel, "unit", "") or getattr(channel.conversion, "unit", "") or ""
    return _text(found).strip(" \0")


def _text(item: Any) -> str:
    return item.decode(errors="replace") if isinstance(item, bytes) else str(item)
