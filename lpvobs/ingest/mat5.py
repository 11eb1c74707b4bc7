"""MAT files of version 5 (MATLAB's save -v6 and -v7): numbers, text and structures of them.

SciPy reads these files, too, but its reader ends the whole program when a damaged file sends it to memory that is not its own.
This one never leaves the bytes that it was given: whatever a file holds, the worst is a ValueError. What logs do not consist of
(matrices, cells, sparse and complex numbers, objects) comes back as None.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

HEADER, TAG = 128, 8
DEEPEST = 8
MOST_VARIABLES = 100_000
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_STRUCT, _CHAR = 2, 4
_NUMERIC = range(6, 16)
_COMPLEX = 0x0800


@dataclass(frozen=True)
class Element:
    """One data element: its type, its bytes, and where the next begins."""

    kind: int
    data: memoryview
    end: int


def unpacked_size(path: Path) -> int:
    """Return how many bytes the variables of a file take when unpacked, by their tags alone.

    Raises
    ------
    ValueError
        If the file ends inside a variable.
    """
    total, count, place, size = 0, 0, HEADER, path.stat().st_size
    with path.open("rb") as stream:
        order = _order(stream.read(HEADER))
        while place + TAG <= size:
            stream.seek(place)
            kind, length = struct.unpack(order + "II", stream.read(TAG))
            if kind == _COMPRESSED:
                first = zlib.decompressobj().decompress(stream.read(min(length, 256)), TAG)
                total += struct.unpack(order + "II", first)[1] if len(first) == TAG else 0
            total += length
            place += TAG + length
            count += 1
            if count > MOST_VARIABLES:
                raise ValueError(f"more than {MOST_VARIABLES} variables")
    if place != size:
        raise ValueError("the file ends inside a variable; it was cut off")
    return total


def read_mat5(path: Path) -> dict[str, Any]:
    """Return the variables of a file by name: vectors of numbers, strings, dicts for structures, lists of dicts for arrays of them.

    Raises
    ------
    ValueError
        If the file is damaged.
    """
    content = memoryview(path.read_bytes())
    order = _order(bytes(content[:HEADER]))
    found = {}
    try:
        for element in _elements(content[HEADER:], order, padded=False):
            inner = element
            if element.kind == _COMPRESSED:
                inner = next(_elements(_inflated(element.data, order), order))
            if inner.kind == _MATRIX:
                name, value = _matrix(inner.data, order, 0)
                if name in found:
                    raise ValueError(f"variable '{name}' is there twice")
                found[name] = value
    except (struct.error, zlib.error, StopIteration, IndexError, UnicodeDecodeError) as error:
        raise ValueError(f"damaged variable: {error}") from None
    return found


def _order(header: bytes) -> str:
    """Return the byte order of a file."""
    mark = header[126:128]
    if mark not in (b"IM", b"MI"):
        raise ValueError("no MATLAB 5 header")
    return "<" if mark == b"IM" else ">"


def _inflated(data: memoryview, order: str) -> memoryview:
    """Return a compressed element, no more than its first tag says; its checksum is verified."""
    stream = zlib.decompressobj()
    head = stream.decompress(data, TAG)
    size = struct.unpack(order + "II", head)[1]
    rest = stream.decompress(stream.unconsumed_tail, size + 1)
    if len(rest) != size or not stream.eof:
        raise ValueError("a compressed variable has another size than it says")
    return memoryview(head + rest)


def _elements(data: memoryview, order: str, padded: bool = True) -> Iterator[Element]:
    """Yield the elements in a run of bytes, every one checked to lie inside."""
    place = 0
    while place + TAG <= len(data):
        element = _element(data, place, order, padded)
        yield element
        place = element.end


def _element(data: memoryview, place: int, order: str, padded: bool) -> Element:
    kind, size = struct.unpack_from(order + "II", data, place)
    if kind >> 16:  # the short form: type, size and data in eight bytes
        kind, size, start, end = kind & 0xFFFF, kind >> 16, place + 4, place + TAG
        if size > 4:
            raise ValueError("a short element of more than four bytes")
    else:
        start = place + TAG
        end = start + (size + (-size % TAG) if padded else size)
    if start + size > len(data):
        raise ValueError("an element reaches beyond its variable")
    return Element(kind, data[start : start + size], end)


def _matrix(data: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Return name and value of a variable or a structure's field."""
    parts = _elements(data, order)
    flags = struct.unpack_from(order + "I", next(parts).data)[0]
    shape = np.frombuffer(_expected(next(parts), (5,)).data, order + "i4").tolist()
    name = bytes(_expected(next(parts), (1, 2)).data).decode("latin-1")
    kind = flags & 0xFF
    if kind in _NUMERIC and not flags & _COMPLEX:
        values = _numbers(next(parts, None), order)
        return name, values if values.size == math.prod(shape) == max(shape) else None
    if kind == _CHAR:
        return name, _text(next(parts, None), order)
    if kind == _STRUCT and depth < DEEPEST:
        return name, _structures(parts, math.prod(shape), order, depth)
    return name, None


def _expected(element: Element, kinds: tuple[int, ...]) -> Element:
    if element.kind not in kinds:
        raise ValueError(f"an element of type {element.kind} where {kinds[0]} belongs")
    return element


def _numbers(element: Element | None, order: str) -> Any:
    if element is None:
        return np.empty(0)
    dtype = np.dtype(order + _NUMBERS[_expected(element, tuple(_NUMBERS)).kind])
    return np.frombuffer(element.data[: len(element.data) // dtype.itemsize * dtype.itemsize], dtype)


def _text(element: Element | None, order: str) -> str:
    if element is None:
        return ""
    encoding = _TEXTS[_expected(element, tuple(_TEXTS)).kind]
    suffix = ("-le" if order == "<" else "-be") if encoding in ("utf-16", "utf-32") else ""
    return bytes(element.data).decode(encoding + suffix, errors="replace")


def _structures(parts: Iterator[Element], count: int, order: str, depth: int) -> Any:
    """Return one structure as a dict, an array of them as a list."""
    width = struct.unpack_from(order + "i", next(parts).data)[0]
    packed = bytes(next(parts).data)
    if width < 1:
        raise ValueError("structure fields without a name")
    names = [packed[start : start + width].split(b"\0")[0].decode("latin-1") for start in range(0, len(packed), width)]
    values = [_matrix(_expected(part, (_MATRIX,)).data, order, depth + 1)[1] if part.data else None for part in parts]
    if not names or len(values) != count * len(names):
        raise ValueError("a structure has another number of fields than it says")
    found = [
        dict(zip(names, values[start : start + len(names)], strict=True)) for start in range(0, len(values), len(names))
    ]
    return found[0] if count == 1 else found
