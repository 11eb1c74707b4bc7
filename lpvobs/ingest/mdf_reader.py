"""Reads MDF files with asammdf, see `lpvobs.ingest.reader`."""

import logging
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lpvobs.ingest.reader import Columns, as_text, native, serve
from lpvobs.ingest.recordings import Head, one_line

MOST_MESSAGES = 10_000
DEEPEST = 8  # conversions inside conversions
_FORMULA = re.compile(
    r"(?:[\s+\-*/(),]|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|X1?(?!\w)"
    r"|(?:a?(?:sin|cos|tan)h?|arc(?:sin|cos|tan)|sqrt|exp|log|log10|abs)(?=\s*\())*"
)
"""Arithmetic. The library hands formulas to evaluators that run Python, and takes one that fails for no conversion at all."""


@contextmanager
def opened(path: Path, notes: dict[str, str]) -> Iterator[Columns]:
    """Yield every channel that is not a time base; a name that several groups have is called group:name.

    The first of what the library complains of meanwhile becomes a note.
    """
    from asammdf import MDF

    said = BufferingHandler(MOST_MESSAGES)
    said.setLevel(logging.WARNING)
    logging.getLogger("asammdf").handlers = [said]
    file = MDF(path, process_bus_logging=False)
    channels = [
        (number, index, channel, int(group.channel_group.cycles_nr))
        for number, group in enumerate(file.groups)
        for index, channel in enumerate(group.channels)
        if index != file.masters_db.get(number)
    ]
    often = Counter(str(channel.name) for _, _, channel, _ in channels)
    found = {}
    for number, index, channel, size in channels:
        name = str(channel.name)
        head = Head(name, _unit(channel), size)
        found[name if often[name] == 1 else f"{number}:{name}"] = (head, partial(_table, file, number, index, notes))
    yield found
    if said.buffer:
        notes["asammdf says"] = one_line(said.buffer[0].getMessage())


def _table(file: Any, group: int, index: int, notes: dict[str, str]) -> pa.Table:
    """Return one channel in physical values with its own stamps; samples marked invalid are empty."""
    channels = file.groups[group].channels
    name = str(channels[index].name)
    for place in {index, file.masters_db.get(group, index)}:
        _look_through(channels[place].conversion, str(channels[place].name), 0)
    signal = file.get(group=group, index=index, ignore_invalidation_bits=True)
    samples = np.asarray(signal.samples)
    if samples.ndim != 1 or samples.dtype.kind not in "iufbSU" or samples.dtype == np.longdouble:
        raise ValueError(
            f"channel '{name}' holds {samples.dtype} with {samples.ndim} dimensions, expected one number per time stamp"
        )
    if samples.dtype.kind in "SU":  # a conversion to text; ingest says so with an example
        values = pa.array([as_text(item) for item in samples], pa.string())
    else:
        mask = np.asarray(signal.invalidation_bits, dtype=bool) if signal.invalidation_bits is not None else None
        if mask is not None and mask.any():
            notes[f"invalid in {name}"] = f"{np.count_nonzero(mask)} samples that the file marks as invalid"
        values = pa.array(native(samples), mask=mask)
    stamps = np.ascontiguousarray(np.asarray(signal.timestamps, dtype=float))
    if stamps.shape != samples.shape:
        raise ValueError(
            f"channel '{name}' has {samples.size} samples and {stamps.size} time stamps, expected as many as samples"
        )
    return pa.table({"values": values, "time": pa.array(stamps)})


def _look_through(conversion: Any, name: str, depth: int) -> None:
    """Refuse a conversion with a formula that is no arithmetic, also inside of other conversions."""
    if conversion is None:
        return
    if depth > DEEPEST:
        raise ValueError(f"channel '{name}' has conversions inside conversions, more than {DEEPEST} levels deep")
    formula = getattr(conversion, "formula", "") or ""
    if formula:
        expect_arithmetic(formula.rstrip("\0"), name)
    for inner in (getattr(conversion, "referenced_blocks", None) or {}).values():
        if not isinstance(inner, (bytes, str)):
            _look_through(inner, name, depth + 1)


def expect_arithmetic(formula: str, name: str) -> None:
    """Raise ValueError for a formula of a channel that is more than arithmetic of X, or that cannot be computed."""
    from numexpr import evaluate

    if not _FORMULA.fullmatch(formula):
        raise ValueError(
            f"channel '{name}' has the conversion formula '{one_line(formula)}', expected only arithmetic with X"
        )
    numbers = np.array([1.0, 2.0])
    try:
        evaluate(formula.replace("X1", "X"), {"X": numbers})
    except Exception:
        raise ValueError(
            f"channel '{name}' has the conversion formula '{one_line(formula)}', which cannot be computed"
        ) from None


def _unit(channel: Any) -> str:
    """Return the unit of a channel; MDF 3 keeps it with the conversion."""
    found = getattr(channel, "unit", "") or getattr(channel.conversion, "unit", "") or ""
    return as_text(found).strip(" \0")


if __name__ == "__main__":
    serve(opened)
