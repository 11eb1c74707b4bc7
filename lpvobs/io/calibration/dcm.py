"""DCM files (KONSERVIERUNG_FORMAT 2.0): the text in which application systems exchange maps.

X runs along a line of values, Y from line to line. A map is a KENNFELD with axes of its own, or a GRUPPENKENNFELD whose axes are
shared objects (STUETZSTELLENVERTEILUNG) that comment lines `*SSTX` and `*SSTY` name.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from lpvobs.errors import DataError
from lpvobs.io.logs.units import convert
from lpvobs.io.templates import filled
from lpvobs.records import Array

KINDS = ("KENNFELD", "GRUPPENKENNFELD")
READ_KINDS = (*KINDS, "FESTKENNFELD")
KEPT = ("DISPLAYNAME", "FUNKTION")
ENCODING = "latin-1"
"""Encoding of most DCM files. Read and written so, units and texts keep their bytes whatever those mean."""

LONGEST_LINE = 1 << 16
MOST_VALUES = 1 << 20
NAME = re.compile(r"[A-Za-z_][\w.\[\]]{0,254}")
TEXTS = {"EINHEIT_X": "unit_x", "EINHEIT_Y": "unit_y", "EINHEIT_W": "unit", "LANGNAME": "long_name"}
_QUOTED = re.compile(r'"([^"]*)"')


@dataclass(frozen=True)
class DcmMap:
    """One map of a DCM file."""

    name: str  # its label
    kind: str  # one of READ_KINDS
    x: Array  # (nx,) [unit_x]
    y: Array  # (ny,) [unit_y]
    values: Array  # (ny, nx) [unit]
    unit_x: str = ""
    unit_y: str = ""
    unit: str = ""
    long_name: str = ""
    x_name: str = ""  # label of the shared axis of a GRUPPENKENNFELD, else empty
    y_name: str = ""  # the same
    kept: tuple[str, ...] = ()  # further lines as they are, see KEPT

    def in_units(self, x: str, y: str, values: str) -> tuple["DcmMap", bool]:
        """Return the map in these units, and whether it was turned for them; raises ValueError where its own do not convert."""
        other = replace(self, x=self.y, y=self.x, values=self.values.T, unit_x=self.unit_y, unit_y=self.unit_x)
        for item, turned in ((self, False), (other, True)):
            with suppress(ValueError):
                nodes = convert(item.x, item.unit_x or "1", x), convert(item.y, item.unit_y or "1", y)
                return DcmMap(self.name, self.kind, *nodes, convert(item.values, item.unit or "1", values)), turned
        raise ValueError(f"the units X '{self.unit_x}', Y '{self.unit_y}', W '{self.unit}'")


def dcm_text(item: DcmMap, digits: int, comments: Sequence[str]) -> str:
    """Return a DCM file with one map, every number rounded to `digits` significant digits."""
    rounded = partial(_number, digits=digits)
    return filled("lpvobs.io.calibration", "map.dcm", {"rounded": rounded}, item=item, comments=comments)


def _number(value: float, digits: int) -> str:
    """Return a number with at most so many significant digits, and with a point, so that every reader takes it for a float.

    Examples
    --------
    >>> _number(0.0123456789, 4), _number(1500.0, 7), _number(-2e-9, 3)
    ('0.01235', '1500.0', '-2.0e-09')
    """
    word = f"{value:.{digits}g}"
    mantissa, letter, exponent = word.partition("e")
    return word if "." in mantissa else f"{mantissa}.0{letter}{exponent}"


def read_dcm_map(path: Path, name: str) -> DcmMap:
    """Return the map with this label in a DCM file; raises DataError if that is none, lacks the map, or the map is damaged."""
    seen: list[str] = []
    lines = _words(path)
    for number, words in lines:
        if words[0] in READ_KINDS and len(words) >= 4:
            if words[1] == name:
                return _parsed(path, number, words, lines)
            seen.append(words[1])
    import difflib

    there = ", ".join(difflib.get_close_matches(name, seen, n=3, cutoff=0.4) or seen[:8]) or "none"
    raise DataError(f"{path}: has no map '{name}'; maps in the file: {there}; name one with --name")


def _words(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and words of every line that says something, after the line that every DCM begins with."""
    begun = False
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise DataError(f"{path}: is not a regular file; name a DCM file")
        with path.open(encoding=ENCODING) as stream:
            for number, line in enumerate(iter(lambda: stream.readline(LONGEST_LINE), ""), 1):
                words = line.split()
                if not words or (words[0][0] in "!*." and not words[0].startswith("*SST")):
                    continue
                if not begun and words[0] != "KONSERVIERUNG_FORMAT":
                    raise DataError(
                        f"{path}: not a DCM file (line {number}); expected KONSERVIERUNG_FORMAT 2.0 as the first "
                        "keyword; name a DCM file"
                    )
                begun = True
                yield number, words
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}); name a DCM file") from None
    if not begun:
        raise DataError(f"{path}: is empty; name a DCM file")


def _parsed(path: Path, start: int, head: list[str], lines: Iterator[tuple[int, list[str]]]) -> DcmMap:
    texts: dict[str, str] = {}
    kept: list[str] = []
    along: list[float] = []
    nodes: list[float] = []
    rows: list[list[float]] = []
    place = start
    try:
        across, down = int(head[2]), int(head[3])
        if not (across > 1 and down > 1 and across * down <= MOST_VALUES):
            raise ValueError(f"a size of {across} by {down} nodes is not possible")
        for number, (keyword, *rest) in lines:
            place = number
            if keyword == "END":
                break
            if keyword in TEXTS:
                quoted = _QUOTED.search(" ".join(rest))
                texts[TEXTS[keyword]] = quoted.group(1) if quoted else ""
            elif keyword in KEPT:
                kept.append(" ".join((keyword, *rest)))
            elif keyword in ("*SSTX", "*SSTY"):
                texts[f"{keyword[-1].lower()}_name"] = rest[0]
            elif keyword == "ST/X":
                along += map(float, rest)
            elif keyword == "ST/Y":
                nodes += map(float, rest)
                rows.append([])
            elif keyword == "WERT":
                rows[-1] += map(float, rest)
            elif keyword.startswith("ST_TX"):
                raise ValueError("an axis has texts instead of numbers")
        else:
            raise ValueError("the keyword END is missing")
        x, y, values = np.array(along), np.array(nodes), np.array(rows)
        _expect_map(x, y, values, across, down)
    except (ValueError, IndexError) as error:
        raise DataError(f"{path}: map '{head[1]}' (line {place}) is damaged: {error}; export it again") from None
    return DcmMap(head[1], head[0], x, y, values, kept=tuple(kept), **texts)


def _expect_map(x: Array, y: Array, values: Array, across: int, down: int) -> None:
    if x.shape != (across,) or y.shape != (down,) or values.shape != (down, across):
        found = f"{x.size} by {y.size} nodes instead of {across} by {down}"
        raise ValueError(f"{found}, or a row with a wrong number of values")
    if not (np.isfinite(values).all() and (np.diff(x) > 0).all() and (np.diff(y) > 0).all()):
        raise ValueError("a value is not finite, or an axis does not increase")
