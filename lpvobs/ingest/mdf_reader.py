"""Reads an MDF file in a process of its own: `python -m lpvobs.ingest.mdf_reader FILE SECONDS BYTES`.

On stdin stands a JSON list of [group, index] of the channels to read, or null for a list of what there is. On stdout comes a line
of JSON for each channel, its samples behind it as an Arrow stream, and a last line with "notes", or with "error" where it failed.
"""

import json
import logging
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa

from lpvobs.io.safety.apart import limit

MOST_CHANNELS = 50_000
DEEPEST = 8
"""Conversions inside conversions."""
_FORMULA = re.compile(
    r"(?:[\s+\-*/(),]|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|X1?(?!\w)"
    r"|(?:a?(?:sin|cos|tan)h?|arc(?:sin|cos|tan)|sqrt|exp|log|log10|abs)(?=\s*\())*"
)
"""Arithmetic. The library hands formulas to evaluators that run Python, and takes one that fails for no conversion at all."""


class _Said(logging.Handler):
    """Gathers what the library would print on stderr."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep the message in one line."""
        self.lines.append(_line(record.getMessage()))


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


def answer(path: Path, wanted: Sequence[tuple[int, int]] | None, out: BinaryIO) -> None:
    """Write what is wanted of a file; raises whatever the library raises."""
    from asammdf import MDF

    notes: dict[str, str] = {}
    with _listening() as said:
        file = MDF(path, process_bus_logging=False)
        if wanted is None:
            for head in _heads(file):
                _tell(out, head)
        else:
            for group, index in wanted:
                _send(file, group, index, notes, out)
    if said:
        notes["asammdf says"] = said[0]
    _tell(out, {"notes": notes})


def _heads(file: Any) -> Iterator[dict[str, Any]]:
    """Yield place, name, unit and number of samples of every channel that is not a time base."""
    if sum(len(group.channels) for group in file.groups) > MOST_CHANNELS:
        raise ValueError(f"it has more than {MOST_CHANNELS} channels")
    for number, group in enumerate(file.groups):
        for index, channel in enumerate(group.channels):
            if index != file.masters_db.get(number):
                size = int(group.channel_group.cycles_nr)
                yield {"place": [number, index], "name": str(channel.name), "unit": _unit(channel), "size": size}


def _send(file: Any, group: int, index: int, notes: dict[str, str], out: BinaryIO) -> None:
    """Write one channel in physical values with its own stamps; samples marked invalid are empty."""
    channels = file.groups[group].channels
    name = str(channels[index].name)
    for place in {index, file.masters_db.get(group, index)}:
        _look_through(channels[place].conversion, str(channels[place].name), 0)
    signal = file.get(group=group, index=index, ignore_invalidation_bits=True)
    samples = np.asarray(signal.samples)
    if samples.ndim != 1 or samples.dtype.kind not in "iufbSU" or samples.dtype == np.longdouble:
        raise ValueError(f"channel '{name}' holds {samples.dtype} of {samples.ndim} axes, expected a number per stamp")
    if samples.dtype.kind in "SU":  # a conversion to text; ingest says so with an example
        values = pa.array([_text(item) for item in samples], pa.string())
    else:
        mask = np.asarray(signal.invalidation_bits, dtype=bool) if signal.invalidation_bits is not None else None
        if mask is not None and mask.any():
            notes[f"invalid in {name}"] = f"{np.count_nonzero(mask)} samples that the file marks so"
        native = np.ascontiguousarray(samples.astype(samples.dtype.newbyteorder("="), copy=False))
        values = pa.array(native, mask=mask)
    stamps = np.ascontiguousarray(np.asarray(signal.timestamps, dtype=float))
    if stamps.shape != samples.shape:
        raise ValueError(f"channel '{name}' has {samples.size} samples and {stamps.size} stamps, expected as many")
    _tell(out, {"place": [group, index]})
    table = pa.table({"values": values, "time": pa.array(stamps)})
    with pa.ipc.new_stream(out, table.schema) as stream:
        stream.write_table(table)


def _look_through(conversion: Any, name: str, depth: int) -> None:
    """Refuse a conversion with a formula that is no arithmetic, also inside of other conversions."""
    if conversion is None:
        return
    if depth > DEEPEST:
        raise ValueError(f"channel '{name}' has conversions inside conversions, {DEEPEST} deep and more")
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
        raise ValueError(f"channel '{name}' is converted by '{_line(formula)}', expected arithmetic of X")
    numbers = np.array([1.0, 2.0])
    try:
        evaluate(formula.replace("X1", "X"), {"X": numbers})
    except Exception:
        raise ValueError(f"channel '{name}' is converted by '{_line(formula)}', which cannot be computed") from None


def _unit(channel: Any) -> str:
    """Return the unit of a channel; MDF 3 keeps it with the conversion."""
    found = getattr(channel, "unit", "") or getattr(channel.conversion, "unit", "") or ""
    return _text(found).strip(" \0")


def _text(item: object) -> str:
    text = item.decode(errors="replace") if isinstance(item, bytes) else str(item)
    return text.encode(errors="replace").decode()


def _line(text: str) -> str:
    return " ".join(text.split())[:200]


def _tell(out: BinaryIO, content: dict[str, Any]) -> None:
    out.write(json.dumps(content).encode() + b"\n")


def main(path: str, seconds: str, most_bytes: str) -> None:
    """Read the file within limits, and leave without a destructor of the library."""
    limit(int(seconds), int(most_bytes))
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the library prints
        try:
            answer(Path(path), json.load(sys.stdin), out)
        except Exception as error:  # whatever a damaged byte leads to
            _tell(out, {"error": _line(str(error)) or type(error).__name__})
        out.flush()
        os._exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])
