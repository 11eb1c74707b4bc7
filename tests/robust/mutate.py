"""Seeded mutations of bytes, of Parquet tables, of HDF5 content and of TOML texts."""

import io
import random
import re

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lpvobs.io.safety.seal import LENGTH, sealed

NUMBERS = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    1e-300,
    1e300,
    -1e300,
    1e308,
    float("nan"),
    float("inf"),
    float("-inf"),
    5e-324,
    2.0**63,
)
UNITS = (
    "",
    " ",
    "Pa",
    "kPa",
    "K",
    "degC",
    "s",
    "ms",
    "%",
    "1",
    "rpm",
    "rad/s",
    "kg/s",
    "furlong",
    "°C",
    "(",
    "kg//s",
    "\x00",
    "m" * 500,
)
NAMES = (
    "",
    " ",
    "time",
    "n_e",
    "a/b",
    "../x",
    "\n",
    "\x1b[31m",
    "<script>",
    "ü",
    "x" * 300,
    "ref_W_c",
    "'",
    "__class__",
)
WORDS = (
    "nan", "inf", "-inf", "0", "-1", "1e400", "1e-400", "99999999999999999999", "true", "''", '""', "[]", "{}", "[[]]",
    "1979-05-27", '"\\u0000"', "[1, 'a']", "{ a = 1 }", "0x7fffffffffffffff", "-0.0", "1e308", '"observer"', "[nan]", "0.5",
)  # fmt: skip


def mutate_bytes(content: bytes, rng: random.Random, *, same_length: bool = False) -> bytes:
    """Return the bytes with one to four small or large injuries, half of them near the end, where Parquet describes itself.

    Of the same length, a sealed file stays one whose seal is found, and is wrong.
    """
    found = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        if not found:
            break
        size = len(found)
        at = rng.randrange(max(0, size - 4096), size) if rng.random() < 0.5 else rng.randrange(size)
        kind = rng.randrange(4 if same_length else 7)
        if kind == 0:
            found[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            found[at] = rng.choice((0, 1, 127, 128, 255))
        elif kind == 2:
            found[at : at + 8] = rng.choice(
                (b"\xff" * 8, b"\x00" * 8, b"\xff\xff\xff\x7f\x00\x00\x00\x00", rng.randbytes(8))
            )
        elif kind == 3:
            other, length = rng.randrange(size), rng.choice((4, 16, 256))
            piece = found[other : min(other + length, size - at + other)]
            found[at : at + len(piece)] = piece
        elif kind == 4:
            found[at:at] = rng.randbytes(rng.choice((1, 4, 64)))
        elif kind == 5:
            del found[at:]
        else:
            del found[at : at + rng.choice((1, 2, 8, 64, 1024))]
    return bytes(found)


def mutate_table(table: pa.Table, rng: random.Random) -> bytes:
    """Return a Parquet file of a table with some columns spoiled in content, type, unit, name or number."""
    pairs = [(field.name, table[field.name].combine_chunks(), dict(field.metadata or {})) for field in table.schema]
    for _ in range(rng.randint(1, 3)):
        if not pairs:
            break
        place = rng.randrange(len(pairs))
        name, values, metadata = pairs[place]
        kind = rng.randrange(8)
        if kind == 0:
            del pairs[place]
        elif kind == 1:
            pairs.append(pairs[place])
        elif kind == 2:
            pairs[place] = (name, values, {b"unit": rng.choice(UNITS).encode()})
        elif kind == 3:
            pairs[place] = (rng.choice(NAMES), values, metadata)
        elif kind == 4:
            pairs[place] = (name, _spoiled(values, rng), metadata)
        elif kind == 5:
            pairs[place] = (name, _recast(values, rng), metadata)
        elif kind == 6:
            pairs[place] = (name, values, {b"unit": rng.randbytes(rng.randint(0, 8))})
        else:
            rows = rng.choice((0, 1, 2, 3, len(values) // 2))
            pairs = [(n, v.slice(0, rows), m) for n, v, m in pairs]
    fields = [pa.field(name, values.type, metadata=metadata) for name, values, metadata in pairs]
    stream = io.BytesIO()
    pq.write_table(pa.table([values for _, values, _ in pairs], schema=pa.schema(fields)), stream)
    return stream.getvalue()


def _spoiled(values: pa.Array, rng: random.Random) -> pa.Array:
    try:
        numbers = np.array(values.to_numpy(zero_copy_only=False), dtype=float)
    except (ValueError, TypeError, pa.ArrowException):
        return values
    kind = rng.randrange(6)
    if numbers.size == 0:
        return pa.array(numbers)
    if kind == 0:
        numbers[rng.randrange(numbers.size) :] = rng.choice(NUMBERS)
    elif kind == 1:
        numbers[:: rng.randint(1, 7)] = rng.choice(NUMBERS)
    elif kind == 2:
        with np.errstate(all="ignore"):
            numbers *= rng.choice(NUMBERS)
    elif kind == 3:
        numbers = numbers[::-1].copy()
    elif kind == 4:
        numbers[:] = numbers[0]
    else:
        return pa.array([None if rng.random() < 0.5 else value for value in numbers], type=pa.float64())
    return pa.array(numbers)


def _recast(values: pa.Array, rng: random.Random) -> pa.Array:
    kinds = (
        pa.float16(), pa.float32(), pa.int8(), pa.int64(), pa.uint64(), pa.bool_(), pa.string(), pa.large_string(), pa.binary(),
        pa.timestamp("ns", tz="UTC"), pa.date32(), pa.time64("ns"), pa.duration("us"), pa.decimal128(38, 10), pa.null(),
    )  # fmt: skip
    kind = rng.choice(kinds)
    try:
        if rng.random() < 0.2:
            return values.dictionary_encode()
        if rng.random() < 0.1:
            return pa.array([[1.0]] * len(values))
        whole = values.cast(pa.int64(), safe=False) if pa.types.is_temporal(kind) else values
        return pa.nulls(len(values)) if pa.types.is_null(kind) else whole.cast(kind, safe=False)
    except (pa.ArrowException, ValueError, TypeError):
        return values


def mutate_hdf(content: bytes, rng: random.Random, head: bytes = b"") -> bytes:
    """Return an HDF5 file whose groups, datasets or attributes were changed with the means of HDF5 itself.

    It is sealed, unless it begins with the head of another program, a MAT file's.
    """
    with h5py.File(io.BytesIO(content if head else content[:-LENGTH]), "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        for _ in range(rng.randint(1, 3)):
            _spoil_object(file, rng.choice(names), rng)
        file.flush()
        image = file.id.get_file_image() if file.driver == "core" else None
        stream = io.BytesIO()
        if image is None:
            with h5py.File(stream, "w", userblock_size=512 if head else 0) as copy:
                for key in file:
                    file.copy(key, copy)
                for key, value in file.attrs.items():
                    copy.attrs[key] = value
            image = stream.getvalue()
    return head + bytes(image)[len(head) :] if head else sealed(bytes(image))


def _spoil_object(file: h5py.File, name: str, rng: random.Random) -> None:
    if name not in file:
        return
    item = file[name]
    kind = rng.randrange(6)
    if kind == 0:
        del file[name]
    elif kind == 1 and item.attrs:
        del item.attrs[rng.choice(list(item.attrs))]
    elif kind == 2 and item.attrs:
        item.attrs[rng.choice(list(item.attrs))] = rng.choice(
            ("", "x", 7, float("nan"), np.arange(3), b"\xff\xfe", "[", "a" * 1000)
        )
    elif kind == 3 and isinstance(item, h5py.Dataset) and item.dtype.kind == "f":
        values = np.array(item[()])
        if values.size:
            values.flat[rng.randrange(values.size)] = rng.choice(NUMBERS)
            item[()] = values
    elif kind == 4:
        del file[name]
        odd = (
            np.zeros(0),
            np.zeros((2, 3, 4)),
            np.float64(3.0),
            "text",
            np.arange(5),
            np.array([b"a", b"b"]),
            np.array(1 + 2j),
        )
        file[name] = rng.choice(odd)
    elif kind == 5 and isinstance(item, h5py.Dataset) and item.dtype.kind in "fi":
        values = np.array(item[()])
        del file[name]
        with np.errstate(invalid="ignore", over="ignore"):  # what does not fit is damage, too
            file[name] = rng.choice(
                (values.astype("f4"), values.astype("i2"), values.T, values.ravel(), values[..., None])
            )


_ASSIGNMENT = re.compile(r"(?m)^(\s*[\w.]+\s*=\s*)(.+?)(\s*(?:#.*)?)$")


def mutate_toml(text: str, rng: random.Random) -> bytes:
    """Return a TOML text with some values, keys, lines or bytes changed."""
    for _ in range(rng.randint(1, 3)):
        kind = rng.randrange(6)
        lines = text.splitlines()
        at = rng.randrange(len(lines)) if lines else 0
        if kind == 0:
            return mutate_bytes(text.encode(), rng)
        if kind == 1 and lines:
            del lines[at]
        elif kind == 2 and lines:
            lines.insert(rng.randrange(len(lines)), lines[at])
        elif kind == 3 and lines:
            lines[at] = lines[at].replace("=", rng.choice(("==", "", ".x =", "'='")), 1)
        else:
            found = list(_ASSIGNMENT.finditer(text))
            if found:
                match = rng.choice(found)
                text = text[: match.start(2)] + rng.choice(WORDS) + text[match.end(2) :]
            continue
        text = "\n".join(lines) + "\n"
    return text.encode("utf-8", errors="replace")
