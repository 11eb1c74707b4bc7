"""How an unknown CSV file is laid out: delimiter, decimal sign, lines of names and units, and whether it was polled."""

import csv
import io
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from lpvobs.errors import DataError
from lpvobs.ingest.profiles import SourceRules
from lpvobs.ingest.recordings import opened
from lpvobs.records import Array

DELIMITERS = (";", "\t", ",", "|")
LOOKED_AT = 40
LINE = 1 << 16
_NUMBER = re.compile(r"[+-]?[\d.,]*\d[\d.,]*([eE][+-]?\d+)?")
_CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?")


def csv_layout(path: Path) -> tuple[SourceRules, list[str]]:
    """Return how a CSV file is laid out, and the reason of each guess; raises DataError if its first lines are no table."""
    lines = _first_lines(path)
    delimiter = max(DELIMITERS, key=lambda sign: _width(lines, sign)[1])
    width, _ = _width(lines, delimiter)
    if width < 2:
        raise DataError(
            f"{path}: the first lines are no table with , ; | or tab between columns; see [source] in a profile"
        )
    rows = [_fields(line, delimiter) for line in lines]
    header = next(number for number, row in enumerate(rows) if len(row) == width)
    body = [row for row in rows[header + 1 :] if any(row)]
    units = bool(body) and len(body[0]) == width and not any(map(_is_value, body[0])) and any(map(_is_value, body[-1]))
    decimal = "," if delimiter != "," and _commas(body) else "."
    rules = SourceRules(
        format="csv", delimiter=delimiter, decimal=decimal, header_row=header + 1, unit_row=header + 2 if units else 0
    )
    reasons = [f"{width} columns in {sum(len(row) == width for row in rows)} of the first {len(rows)} lines"]
    if units:
        reasons.append(f"line {header + 2} holds no number where the later ones do")
    if decimal == ",":
        reasons.append("numbers with a comma and none with a point")
    return rules, reasons


def _first_lines(path: Path) -> list[str]:
    with opened(path) as raw, io.TextIOWrapper(raw, encoding="utf-8", errors="replace") as stream:
        lines = [stream.readline(LINE) for _ in range(LOOKED_AT)]
    kept = [line.rstrip("\r\n").lstrip("\ufeff") for line in lines if line]
    if sum(bool(line.strip()) for line in kept) < 2 or any("\0" in line for line in kept):
        raise DataError(f"{path}: not a CSV table with names and numbers; expected text; name another file")
    return kept


def _fields(line: str, delimiter: str) -> list[str]:
    return [word.strip() for word in next(csv.reader([line], delimiter=delimiter), [])]


def _width(lines: list[str], delimiter: str) -> tuple[int, int]:
    """Return the usual number of columns with a delimiter, and how much speaks for it: columns times lines that agree."""
    counts = Counter(len(_fields(line, delimiter)) for line in lines)
    width, often = max(counts.items(), key=lambda item: (item[0] - 1) * item[1])
    return width, (width - 1) * often


def _is_value(word: str) -> bool:
    return bool(_NUMBER.fullmatch(word) or _CLOCK.fullmatch(word))


def _commas(rows: list[list[str]]) -> bool:
    """Return whether numbers are written with a comma."""
    numbers = [word for row in rows for word in row if _NUMBER.fullmatch(word)]
    return any("," in word for word in numbers) and not any("." in word for word in numbers)


def refreshed(values: Array, turn: int, turns: int) -> tuple[int, int]:
    """Return how often a column changes out of its turn, and how often in all; row r is the turn of column r modulo `turns`."""
    changed = np.flatnonzero((values[1:] != values[:-1]) & np.isfinite(values[:-1])) + 1
    return int(np.count_nonzero(changed % turns != turn)), changed.size


def polled(columns: Mapping[str, Array], turns: list[str]) -> float:
    """Return which share of all changes falls into the turn of its column.

    NaN where there are fewer than three columns or a hundred changes. By chance it would be one in the number of columns.
    Columns have the shape (N,); `turns` are all columns besides time, in the order of the file.
    """
    counts = [refreshed(values, turns.index(name), len(turns)) for name, values in columns.items()]
    late, every = (sum(count[end] for count in counts) for end in (0, 1))
    return 1.0 - late / every if len(turns) >= 3 and every >= 100 else float("nan")
