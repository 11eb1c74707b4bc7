"""The formats of foreign recordings, and how a file of each is opened: CSV, Parquet, MAT and MDF.

CSV and Parquet have units in brackets behind the names, in a line of their own, or in metadata. The libraries for MAT and MDF are
made for files that one trusts: a damaged one may crash them, keep them busy for ever or let them fill the memory. So they run in a
process of their own, within limits; `lpvobs.ingest.reader` says what the two tell each other.
"""

import codecs
import csv
import io
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lpvobs.errors import DataError, UsageError
from lpvobs.ingest import recordings
from lpvobs.ingest.profiles import SourceRules
from lpvobs.ingest.recordings import Column, ForeignRecording, Head
from lpvobs.io.arrow import pa, pq
from lpvobs.io.safety.sandbox import answer

LONGEST_LINE = 1 << 20
ANY_BYTE = "latin-1"
MOST_LISTED = 1_000_000  # lines with a wrong number of fields, after which no more are looked at
MOST_BROKEN = 0.01  # share of the lines that may have a wrong number of fields; more is another layout
SECONDS, BYTES = 6, 2 << 30  # what a library may take for a small file: computing and memory
PER_SECOND = 4 << 20  # [bytes] of a file for which it may compute a second longer
FIRST_BYTES = {
    b"PAR1": "parquet",
    b"MDF     ": "mdf",
    b"UnFinMF ": "mdf",
    b"MATLAB": "mat",
    b"\x89HDF\r\n\x1a\n": "mat",
}
ARCHIVES = (".zip", ".mf4z", ".gzip", ".gz", ".bz2")
REMEDIES = {"MAT": "save it again in MATLAB with -v7 or -v7.3", "MDF": "record or export it again"}
"""What to do with a file that the library cannot read."""


def _read_csv(
    path: Path,
    heads: Mapping[str, Head],
    rules: SourceRules,
    encoding: str,
    notes: dict[str, str],
    names: Sequence[str],
) -> Mapping[str, Column]:
    """Return columns as text, empty where the file has nothing; lines that were cut off are left out and noted."""
    from pyarrow import csv as arrow

    head = max(rules.header_row, rules.unit_row)
    lines, quotes, decodes = _survey(path, encoding)
    recordings.check_samples(path, [lines] * len(names), 2.0 * path.stat().st_size)
    decoding = encoding if decodes else ANY_BYTE
    notes.update(_read_as(encoding, decoding))
    broken: list[int] = []

    def skip(row: Any) -> str:
        broken.append(row.actual_columns)
        return "skip" if len(broken) < MOST_LISTED else "error"

    text = dict.fromkeys(names, pa.string())
    try:
        with path.open("rb") as stream:  # by name, Arrow opens no file whose name is not UTF-8
            table = arrow.read_csv(
                stream,
                arrow.ReadOptions(use_threads=False, skip_rows=head, column_names=list(heads), encoding=decoding),
                arrow.ParseOptions(delimiter=rules.delimiter, invalid_row_handler=skip),
                arrow.ConvertOptions(include_columns=names, column_types=text, strings_can_be_null=False),
            )
    except (pa.ArrowException, OSError, ValueError, LookupError) as error:
        raise DataError(
            f"{path}: not a readable CSV table ({recordings.one_line(error)}); check delimiter and encoding in the "
            "profile's [source]"
        ) from None
    rows = table.num_rows + len(broken)
    if broken and (rules.polled or (len(broken) > 1 and len(broken) > MOST_BROKEN * table.num_rows)):
        raise DataError(
            f"{path}: {len(broken)} of {rows} lines have a wrong number of fields (the first has "
            f"{broken[0]} fields), expected {len(heads)}; check the delimiter, or export the file again"
        )
    if broken:
        notes["broken_lines"] = f"{len(broken)} lines with a wrong number of fields were left out"
    if quotes:
        _refuse_open_quote(path, rows, head)
    return {name: Column(table.column(name)) for name in names}


def _survey(path: Path, encoding: str) -> tuple[int, bool, bool]:
    """Return about how many lines a file has, whether it has quotation marks, and whether it is UTF-8, where it should be."""
    lines, quotes, decodes, size = 1, False, True, path.stat().st_size
    decoder = codecs.getincrementaldecoder("utf-8")()
    with recordings.opened(path) as stream:
        while chunk := stream.read(LONGEST_LINE):
            lines += max(chunk.count(b"\n"), chunk.count(b"\r"))
            quotes = quotes or b'"' in chunk
            if decodes and encoding == "utf-8":
                try:
                    decoder.decode(chunk, final=stream.tell() == size)
                except UnicodeDecodeError:
                    decodes = False
    return lines, quotes, decodes


def _refuse_open_quote(path: Path, rows: int, before: int) -> None:
    """Refuse a file some of whose lines became part of a field, because a quotation mark before them is not closed."""
    lines, first = 0, 0
    with recordings.opened(path) as stream:
        for number, line in enumerate(stream, 1):
            if number > before and line.strip(b"\r\n"):
                lines += 1
                first = first or (number if line.count(b'"') % 2 else 0)
    if first and rows < lines:
        raise DataError(
            f"{path}: the quotation mark in line {first} is not closed, so {lines - rows} lines have no row of their own; "
            f"close the quotation mark, or export the file again"
        )


def open_csv(path: Path, rules: SourceRules) -> ForeignRecording:
    """Return a CSV file with the names and units of its header; nothing else of it has been read."""
    lines = _first_lines(path, max(rules.header_row, rules.unit_row))
    encoding, text = _decoded(path, lines, rules.encoding)
    names = _fields(path, text, rules.header_row, rules.delimiter)
    units = _fields(path, text, rules.unit_row, rules.delimiter) if rules.unit_row else [""] * len(names)
    if len(names) != len(units):
        raise DataError(
            f"{path}: the header has {len(names)} names but {len(units)} units; correct header_row or unit_row in the profile"
        )
    heads: dict[str, Head] = {}
    often = Counter(names)
    for number, (full, unit) in enumerate(zip(names, units, strict=True), 1):
        bare, inside = recordings.split_unit(full)
        key = full if full and often[full] == 1 else f"{full}#{number}"
        while key in heads:
            key += "#"
        heads[key] = Head(bare, unit.strip().strip("[]") or inside)
    notes = _read_as(rules.encoding, encoding)
    return ForeignRecording(path, heads, partial(_read_csv, path, heads, rules, encoding, notes), notes)


def _read_as(said: str, found: str) -> dict[str, str]:
    """Return what to note of a file in another encoding than its profile says."""
    return {} if said == found else {"encoding": f"the file is not {said}, so it was read as {found}"}


def _first_lines(path: Path, count: int) -> list[bytes]:
    with recordings.opened(path) as stream:
        lines = [stream.readline(LONGEST_LINE) for _ in range(count)]
    if not lines[-1].strip() or len(lines[-1]) == LONGEST_LINE or b"\0" in lines[-1]:
        raise DataError(
            f"{path}: line {count} is not the header of a CSV table; correct header_row and unit_row in [source] of the profile"
        )
    return lines


def _decoded(path: Path, lines: list[bytes], encoding: str) -> tuple[str, list[str]]:
    """Return the encoding that the header is in, and its lines; what is not UTF-8 is taken for Latin-1."""
    for candidate in ("utf-8", ANY_BYTE) if encoding == "utf-8" else (encoding,):
        try:
            return candidate, [line.decode(candidate).lstrip("\ufeff") for line in lines]
        except (ValueError, LookupError):  # also of codecs that are none of text
            continue
    raise DataError(f"{path}: the header is not encoded in {encoding}; name another encoding in the profile's [source]")


def _fields(path: Path, lines: list[str], row: int, delimiter: str) -> list[str]:
    try:
        return [name.strip() for name in next(csv.reader([lines[row - 1]], delimiter=delimiter, strict=True))]
    except (csv.Error, StopIteration) as error:
        raise DataError(f"{path}: line {row} is not a CSV header ({error}); check [source] in the profile") from None


def open_parquet(path: Path, rules: SourceRules) -> ForeignRecording:
    """Return a Parquet file with the names and units of its flat columns."""
    with _parquet(path) as file:
        schema, metadata = file.schema_arrow, file.metadata
        sizes = Counter[str]()  # [bytes] of each column when it is read
        for number in range(metadata.num_row_groups):
            group = metadata.row_group(number)
            for chunk in map(group.column, range(group.num_columns)):
                sizes[chunk.path_in_schema] += chunk.total_uncompressed_size
    heads, often = {}, Counter(schema.names)
    for item in schema:
        if not pa.types.is_nested(item.type) and often[item.name] == 1:
            name, inside = recordings.split_unit(item.name)
            said = item.metadata or {}
            stored = (said.get(b"unit") or said.get(b"units") or b"").decode(errors="replace").strip()
            heads[item.name] = Head(name, stored or inside, metadata.num_rows)

    def read(names: Sequence[str]) -> Mapping[str, Column]:
        """Return columns as they are stored."""
        recordings.check_size(f"{path}: reading it", sum(sizes[name] + 8 * heads[name].size for name in names))
        with _parquet(path) as file:
            table = file.read(columns=list(names), use_threads=False)
        return {name: Column(table.column(name)) for name in names}

    return ForeignRecording(path, heads, read)


@contextmanager
def _parquet(path: Path) -> Iterator["pq.ParquetFile"]:
    try:
        with pq.ParquetFile(path) as file:
            yield file
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(
            f"{path}: not a readable Parquet file ({recordings.one_line(error)}); export it again"
        ) from None


def open_mat(path: Path, rules: SourceRules) -> ForeignRecording:
    """Return a MAT file with the names, units and lengths of its numeric vectors; structures become dotted names."""
    return open_apart(path, "MAT")


def open_mdf(path: Path, rules: SourceRules) -> ForeignRecording:
    """Return an MDF file with its channels; a name that several groups have is called group:name."""
    if find_spec("asammdf") is None:
        raise UsageError(
            f"{path}: MDF needs the library asammdf, which is not installed; install it with: pip install 'lpvobs[mdf]'"
        )
    if sniff(path) != "mdf":  # the library would unpack it
        raise DataError(
            f"{path}: does not begin like an MDF file; unpack the file if it is packed, or delete format in the profile's [source]"
        )
    if path.suffix.lower() in ARCHIVES:  # the library would take it for its own copy of an archive, and delete it
        raise DataError(f"{path}: is an MDF file, but its name ends like that of an archive; rename it to .mf4")
    return open_apart(path, "MDF")


def open_apart(path: Path, kind: str) -> ForeignRecording:
    """Return a file that another process reads."""
    notes: dict[str, str] = {}
    heads = {column.pop("full"): Head(**column) for column in _asked(path, kind, None, notes)}

    def read(names: Sequence[str]) -> Mapping[str, Column]:
        """Return columns as they are stored; those of MDF in physical values, with their own stamps, empty where marked invalid."""
        recordings.check_samples(path, [heads[name].size for name in names])
        return {
            name: Column(table["values"], table["time"].to_numpy() if table.num_columns > 1 else None)
            for name, table in zip(names, _asked(path, kind, names, notes), strict=True)
        }

    return ForeignRecording(path, heads, read, notes)


def _asked(path: Path, kind: str, wanted: Sequence[str] | None, notes: dict[str, str]) -> Iterator[Any]:
    """Yield what the reading process says of every column, or tables of the wanted ones; keep its notes."""
    size, asked = path.stat().st_size, json.dumps([kind, wanted])
    said = io.BytesIO(answer("lpvobs.ingest.reader", path, SECONDS + size // PER_SECOND, BYTES + size, asked))
    reason = "the library that reads it fails, or takes too long"
    try:
        for line in said:
            content = json.loads(line)
            if "notes" in content:
                notes.update(content["notes"])
                return
            if "error" in content:
                reason = content["error"]
                break
            yield content if wanted is None else pa.ipc.open_stream(said).read_all()
    except (ValueError, pa.ArrowException):  # it ended in the middle of what it had to say
        pass
    raise DataError(f"{path}: not a readable {kind} file ({reason}); {REMEDIES[kind]}")


OPENERS = {"csv": open_csv, "parquet": open_parquet, "mat": open_mat, "mdf": open_mdf}


def open_recording(path: Path, rules: SourceRules) -> ForeignRecording:
    """Return a foreign file, opened by its format: the profile's, or that of its first bytes; raises DataError if it cannot be."""
    found = sniff(path)
    recording = OPENERS[rules.format or found](path, rules)
    if len(recording.heads) > recordings.MOST_COLUMNS:
        raise DataError(
            f"{path}: has {len(recording.heads)} columns, expected {recordings.MOST_COLUMNS} at most; export fewer"
        )
    return recording


def sniff(path: Path) -> str:
    """Return the format of a file by its first bytes; what no other format begins with is taken for CSV."""
    if not path.is_file():
        raise DataError(f"{path}: no such recording; name a CSV, Parquet, MAT or MDF4 file")
    with recordings.opened(path) as stream:
        first = stream.read(8)
    return next((kind for begins, kind in FIRST_BYTES.items() if first.startswith(begins)), "csv")
