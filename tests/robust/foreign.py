"""Good foreign recordings in memory, the profile of each, and their mutations: CSV, MAT of both kinds, MDF."""

import datetime
import io
import random
import re
import struct
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from robust import mutate
from robust.defects import UNITS, moving
from scipy.io import savemat

ROWS = 60
NAMES = ("n_e", "u_delta", "p_im", "T_im", "W_maf")
HEADER = 128
BLOCK = 24
"""[bytes] of the head of a block of MDF 4: its name, its length and how many links follow."""
HEAD = """
schema = 1
[source]
format = "{kind}"
{layout}
{time}
[raster]
rate = 20.0
"""
CHANNEL = """
[channels.{name}]
source = "{source}"
unit = "{unit}"
source_unit = "{unit}"
rule = "{rule}"
optional = {optional}
low = -1e9
"""
CELLS = (
    "", " ", '"', '"1"', "-", "nan", "inf", "-inf", "1e400", "1e-400", "0x10", "1_000", "1,5", "1.5.2", "1;5", "9" * 400, "t",
    "24:00:00", "23:59:59", "2024-02-30", "2024-01-01T00:00:00Z", "\x00", "\r", "\n", "=1+1", "1e9", "-1e300", "Ü", "１",
    "true", "\ufeff",
)  # fmt: skip
WORDS = (
    0,
    1,
    2,
    3,
    5,
    6,
    9,
    14,
    15,
    16,
    18,
    100,
    0x7F,
    0xFF,
    0x800,
    0x10000,
    0x40001,
    2**28,
    2**31 - 1,
    2**31,
    2**32 - 1,
)
FORMULAS = (
    "X*2",
    "X1^2",
    "9**9**9**9*X",
    "__import__('os').system('touch run')",
    "X.__class__",
    "sqrt(-X)",
    "1/(X-X)",
    "",
    "(" * 999,
)


@dataclass(frozen=True)
class Seed:
    """A good file, and the profile that reads it."""

    suffix: str
    content: bytes
    profile: str


def _profile(
    kind: str, layout: str = "", time: str = '[time]\nsource = "time"\nunit = "s"\nbackward = "drop"', inside: str = ""
) -> str:
    rules = ("linear", "hold", "mean", "", "linear")
    tables = [
        CHANNEL.format(
            name=name,
            source=inside + name,
            unit=UNITS[name],
            rule=rule,
            optional="true" if name == "W_maf" else "false",
        )
        for name, rule in zip(NAMES, rules, strict=True)
    ]
    return HEAD.format(kind=kind, layout=layout, time=time) + "".join(tables)


def _columns() -> dict[str, np.ndarray]:
    drive = moving()
    return {name: np.round(drive[name][: 10 * ROWS : 10], 6) for name in ("time", *NAMES)}


def csv_seeds() -> list[Seed]:
    """Return a plain table, one as Germany writes it, one by the time of day, and one with every field in quotation marks."""
    columns = _columns()
    rows = [[f"{value:.6g}" for value in row] for row in zip(*columns.values(), strict=True)]
    units = [UNITS[name].replace("K", "°C") for name in columns]
    full = [f"{name} [{unit}]" for name, unit in zip(columns, units, strict=True)]
    plain = "\n".join([",".join(full), *map(",".join, rows)]) + "\n"
    german = "\r\n".join(
        ["recorded by hand", ";".join(columns), ";".join(units), *(";".join(row).replace(".", ",") for row in rows)]
    )
    clocks = [f"23:59:{30 + k // 10:02d}.{k % 10}" if k < 300 else "" for k in range(ROWS)]
    clock = "\n".join(["\t".join(columns), *("\t".join([at, *row[1:]]) for at, row in zip(clocks, rows, strict=True))])
    quoted = "\n".join(['"' + '","'.join(row) + '"' for row in (list(columns), *rows)])
    of_day = '[time]\nsource = "time"\nunit = "clock"\nfrom_zero = true\nbackward = "drop"'
    return [
        Seed(".csv", plain.encode(), _profile("csv")),
        Seed(
            ".csv",
            german.encode("latin-1"),
            _profile("csv", 'delimiter = ";"\ndecimal = ","\nheader_row = 2\nunit_row = 3'),
        ),
        Seed(".csv", clock.encode(), _profile("csv", 'delimiter = "\\t"', of_day)),
        Seed(".csv", quoted.encode(), _profile("csv")),
    ]


def mat_seeds() -> list[Seed]:
    """Return vectors and structures in files of version 5, not compressed."""
    columns = _columns()
    nested = {"time": columns["time"], "drive": {name: columns[name] for name in NAMES} | {"unit": "V"}}
    documents = ((columns | {"note": "a drive", "kind": np.arange(9, dtype=np.int16)}, ""), (nested, "drive."))
    seeds = []
    for document, inside in documents:
        stream = io.BytesIO()
        savemat(stream, document)
        content = b"MATLAB 5.0 MAT-file".ljust(124) + stream.getvalue()[124:]  # without the date
        seeds.append(Seed(".mat", content, _profile("mat", inside=inside)))
    return seeds


def hdf_seeds() -> list[Seed]:
    """Return a file of version 7.3 with structures, units and text."""
    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512) as file:
        for name, values in _columns().items():
            where = "time" if name == "time" else f"drive/{name}"
            file.create_dataset(where, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        file["drive/unit"] = np.array([[ord("V")]], np.uint16)
        file["drive/unit"].attrs["MATLAB_class"] = np.bytes_("char")
    content = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + stream.getvalue()[HEADER:]
    return [Seed(".mat", content, _profile("mat", inside="drive."))]


def mdf_seeds() -> list[Seed]:
    """Return files of MDF 3 and 4, one of the latter packed, with conversions of every kind."""
    from asammdf import MDF, Signal

    columns = _columns()
    seeds = []
    for version, packing in (("3.30", 0), ("4.10", 0), ("4.20", 2)):
        file = MDF(version=version)
        file.header.start_time = datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC)
        signals = [Signal(columns[name], columns["time"], unit=UNITS[name], name=name) for name in NAMES]
        raw = np.arange(ROWS, dtype=np.uint8)
        words = {"val_0": 0, "text_0": b"off", "val_1": 1, "text_1": b"on", "default": b"odd"}
        for name, conversion in (("linear", {"a": 2.0, "b": 1.0}), ("formula", {"formula": "X1*2"}), ("words", words)):
            signals.append(Signal(raw, columns["time"], unit="1", name=name, conversion=conversion))
        file.append(signals[:4])
        file.append(signals[4:])
        with tempfile.TemporaryDirectory() as folder:
            path = file.save(Path(folder) / ("seed.mdf" if version < "4" else "seed.mf4"), compression=packing)
            seeds.append(Seed(path.suffix, _undated(path.read_bytes()), _profile("mdf", time="")))
        file.close()
    return seeds


def _undated(content: bytes) -> bytes:
    """Return an MDF file without the time at which it was written."""
    found = bytearray(
        re.sub(rb"[A-Z]\w\w [A-Z]\w\w [ \d]\d [\d:]{8} \d{4}: updated", b"Wed Jan  1 00:00:00 2020: updated", content)
    )
    for block in re.finditer(rb"##FH", content):
        found[block.start() + 40 : block.start() + 48] = bytes(8)
    return bytes(found)


def mutate_csv(content: bytes, rng: random.Random) -> bytes:
    """Return a table with some cells, lines or bytes changed."""
    lines = content.split(b"\n")
    for _ in range(rng.randint(1, 4)):
        kind, at = rng.randrange(8), rng.randrange(len(lines))
        if kind == 0:
            return mutate.mutate_bytes(b"\n".join(lines), rng)
        if kind in (1, 2, 3):
            sign = max((b",", b";", b"\t"), key=lines[at].count)
            cells = lines[at].split(sign)
            cells[rng.randrange(len(cells))] = rng.choice(CELLS).encode(rng.choice(("utf-8", "utf-16-le")))
            lines[at] = sign.join(cells)
        elif kind == 4:
            lines[at:at] = [lines[rng.randrange(len(lines))]] * rng.choice((1, 1, 30))
        elif kind == 5:
            del lines[at : at + rng.choice((1, 2, 50))]
        elif kind == 6:
            lines[at] += rng.choice(
                (b",", b";;;", b'"', b"," * 70_000, b" " * 70_000, b"\x00", b"\xff", b"x" * 2_000_000)
            )
        else:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        lines = lines or [b""]
    return b"\n".join(lines)


def mutate_mat(content: bytes, rng: random.Random) -> bytes:
    """Return a file of version 5 with some words or bytes changed, half of the time with its variables packed."""
    if rng.random() < 0.3:
        return mutate.mutate_bytes(content, rng)
    found = bytearray(content)
    for _ in range(rng.randint(1, 3)):
        at = 4 * rng.randrange(HEADER // 4, len(found) // 4)
        found[at : at + 4] = struct.pack("<I", rng.choice(WORDS))
    return _packed(bytes(found), rng) if rng.random() < 0.5 else bytes(found)


def _packed(content: bytes, rng: random.Random) -> bytes:
    packed, place = [content[:HEADER]], HEADER
    while place + 8 <= len(content):
        size = 8 + struct.unpack_from("<I", content, place + 4)[0]
        piece = zlib.compress(content[place : place + size], rng.choice((1, 9)))
        packed.append(struct.pack("<II", 15, len(piece)) + piece)
        place += size
    return b"".join(packed)


def mutate_mdf(content: bytes, rng: random.Random) -> bytes:
    """Return a file with bytes changed, or with links and fields of the blocks of version 4 that lead elsewhere."""
    blocks = [at for at in range(64, len(content) - BLOCK, 8) if content[at : at + 2] == b"##"]
    if content[8:9] != b"4" or rng.random() < 0.3:
        return mutate.mutate_bytes(content, rng)
    found = bytearray(content)
    for _ in range(rng.randint(1, 3)):
        at = rng.choice(blocks)
        length, links = struct.unpack_from("<QQ", content, at + 8)
        kind = rng.randrange(4)
        if kind == 0 and links:
            where = at + BLOCK + 8 * rng.randrange(links)
            struct.pack_into("<Q", found, where, rng.choice((*blocks, 0, 8, len(content), 2**40, 2**63)))
        elif kind == 1:
            struct.pack_into("<Q", found, at + rng.choice((8, 16)), rng.choice((0, 24, 1000, 2**31, 2**40, 2**64 - 1)))
        elif kind == 2 and length > BLOCK:
            where = at + BLOCK + 4 * rng.randrange(max(1, (min(length, 4096) - BLOCK) // 4))
            found[where : where + 4] = struct.pack("<I", rng.choice(WORDS))
        else:
            found[at : at + 4] = content[(other := rng.choice(blocks)) : other + 4]
    formula = b"X1*2"
    if rng.random() < 0.2 and formula in found:
        found = bytearray(bytes(found).replace(formula, rng.choice(FORMULAS).encode()[:4].ljust(4, b"\x00")))
    return bytes(found[: len(content)])


def mutate_profile(text: str, rng: random.Random) -> bytes:
    """Return the profile as it is, or now and then one with some values or lines changed."""
    return mutate.mutate_toml(text, rng) if rng.random() < 0.1 else text.encode()
