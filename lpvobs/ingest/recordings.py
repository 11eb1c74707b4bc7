"""What every foreign file looks like to `ingest`: columns with a name, a unit, and sometimes a time base of their own."""

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from lpvobs.errors import DataError
from lpvobs.io.arrow import pa, pc
from lpvobs.io.logs.parquet import as_floats, is_numeric
from lpvobs.records import Array

MOST_BYTES = 2 << 30  # what one source may take in memory; checked before it is read
PER_SAMPLE, PER_ROW = 32.0, 64.0
"""[bytes] of a sample on its way to the log (as recorded, as a float, repaired, with its stamp), and of a row meanwhile."""
MOST_COLUMNS = 50_000
LONGEST_EXAMPLE = 40

_NUMBER = r"^[+-]?(\d+\.?\d*([eE][+-]?\d+)?|\.\d+([eE][+-]?\d+)?|[nN][aA][nN]|[iI][nN][fF])$"
_NO_UNIT = re.compile(r"\d+|actual|measured|abs(olute)?|ist|soll|specified|filtered|raw|[gn]\d+")
"""What stands in brackets and is no unit: the index of an array, the state of a value, the label of a sensor."""
_WITH_UNIT = re.compile(r"(.*\S)\s*[\[(]([^\[\]()]*)[\])]\s*")


@dataclass(frozen=True)
class Head:
    """What is known of a column before it is read."""

    name: str  # without the unit
    unit: str  # as the file says it; empty where it does not
    size: int = -1  # samples; -1 where the file does not say before it is read


@dataclass(frozen=True)
class Column:
    """A column as it was recorded: numbers, or text where the file holds text."""

    data: "pa.Array | pa.ChunkedArray"
    time: Array | None = None  # (N,) [s], where the format keeps a time base with each channel


@dataclass(frozen=True)
class ForeignRecording:
    """An open foreign file: every column by the full name that tells it from all others, and what was mended to read it at all."""

    path: Path
    heads: Mapping[str, Head]
    read: Callable[[Sequence[str]], Mapping[str, Column]]  # the columns with these full names
    notes: dict[str, str] = field(default_factory=dict)


def find(recording: ForeignRecording, names: Iterable[str], what: str) -> str | None:
    """Return the full name of the first wanted column that is there, if any; raises DataError if a name fits more than one."""
    for name in names:
        if name in recording.heads:
            return name
        fitting = [full for full, head in recording.heads.items() if head.name == name]
        if len(fitting) > 1:
            raise DataError(
                f"{recording.path}: {what}: the name '{name}' fits {len(fitting)} columns: {', '.join(fitting[:6])}; "
                f"write the full name of one of them"
            )
        if fitting:
            return fitting[0]
    return None


def nearest(heads: Mapping[str, Head], names: Sequence[str]) -> str:
    """Return a hint at what the file has instead of the names wanted."""
    present = list(dict.fromkeys(head.name for head in heads.values()))
    near = [found for name in names for found in difflib.get_close_matches(name, present, n=2, cutoff=0.6)]
    if near:
        return f"nearest names: {', '.join(dict.fromkeys(near))}"
    more = f" and {len(present) - 12} more" if len(present) > 12 else ""
    return f"columns in the file: {', '.join(present[:12]) or 'none'}{more}"


def split_unit(header: str) -> tuple[str, str]:
    """Return name and unit of a header that may hold a unit in brackets at its end.

    Examples
    --------
    >>> split_unit("Engine RPM [RPM]"), split_unit("p_im (kPa)"), split_unit("time")
    (('Engine RPM', 'RPM'), ('p_im', 'kPa'), ('time', ''))
    """
    found = _WITH_UNIT.fullmatch(header)
    if not found or _NO_UNIT.fullmatch(found.group(2).strip().lower()):
        return header.strip(), ""
    return found.group(1), found.group(2).strip()


def one_line(error: object) -> str:
    """Return the beginning of a message without its line breaks."""
    return " ".join(str(error).split())[:200]


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """Yield a file to read from; raises DataError if it cannot be read."""
    try:
        with path.open("rb") as stream:
            yield stream
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); check your permission to read this file") from None


def check_samples(path: Path, sizes: Sequence[int], text: float = 0.0) -> None:
    """Refuse so many samples of each column, and so many bytes of text, if making a log of them would take too much memory."""
    check_size(f"{path}: reading it", PER_SAMPLE * sum(sizes) + PER_ROW * max(sizes, default=0) + text)


def check_size(
    what: str, needed: float, remedy: str = "cut the recording into parts, or export fewer channels"
) -> None:
    """Refuse what would take more memory than a source may."""
    if needed > MOST_BYTES:
        most = f"{MOST_BYTES / 2**30:.0f} GiB"
        raise DataError(f"{what} would take {needed / 2**30:.3g} GiB, expected at most {most}; {remedy}")


def as_numbers(data: "pa.Array | pa.ChunkedArray", decimal: str = ".") -> tuple[Array, dict[str, int | str]]:
    """Return a column as floats, NaN for what is no number; of text also how many entries are unreadable, and the first of them.

    Raises ValueError if it holds neither numbers nor text.
    """
    if pa.types.is_dictionary(data.type):
        data = data.cast(data.type.value_type)
    if is_numeric(data.type):
        return as_floats(data), {}
    if not (pa.types.is_string(data.type) or pa.types.is_large_string(data.type)):
        raise ValueError(f"holds {data.type}, expected numbers")
    data = pc.fill_null(pc.utf8_trim_whitespace(data), "")
    mended = pc.replace_substring(data, ",", ".") if decimal == "," else data
    good = pc.match_substring_regex(mended, _NUMBER)
    odd = data.filter(pc.and_(pc.invert(good), pc.not_equal(data, "")))
    repairs = {"unreadable": len(odd), "example": odd[0].as_py()[:LONGEST_EXAMPLE]} if len(odd) else {}
    return as_floats(pc.if_else(good, mended, "nan").cast(pa.float64())), repairs
