"""Parquet files of other tools: units in the fields' metadata or in brackets behind the names."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lpvobs.errors import DataError
from lpvobs.ingest.profiles import SourceRules
from lpvobs.ingest.recordings import Column, ForeignRecording, Head, check_size, one_line, split_unit

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq


@dataclass(frozen=True)
class ParquetRecording(ForeignRecording):
    """A Parquet file whose schema has been read; `sizes` [bytes] is what each column takes when it is read."""

    sizes: Mapping[str, int]

    def read(self, names: Sequence[str]) -> Mapping[str, Column]:
        """Return columns as they are stored."""
        check_size(self.path, sum(self.sizes[name] + 8 * self.heads[name].size for name in names))
        with _parquet(self.path) as file:
            table = file.read(columns=list(names), use_threads=False)
        return {name: Column(table.column(name)) for name in names}


def open_parquet(path: Path, rules: SourceRules) -> ParquetRecording:
    """Return a Parquet file with the names and units of its flat columns."""
    import pyarrow as pa

    with _parquet(path) as file:
        schema, metadata = file.schema_arrow, file.metadata
        sizes = dict.fromkeys(schema.names, 0)
        for number in range(metadata.num_row_groups):
            group = metadata.row_group(number)
            for place in range(group.num_columns):
                chunk = group.column(place)
                sizes[chunk.path_in_schema] = sizes.get(chunk.path_in_schema, 0) + chunk.total_uncompressed_size
        rows = metadata.num_rows
    heads = {item.name: _head(item, rows) for item in schema if not pa.types.is_nested(item.type)}
    return ParquetRecording(path, {name: head for name, head in heads.items() if schema.names.count(name) == 1}, sizes)


def _head(item: "pa.Field", rows: int) -> Head:
    name, inside = split_unit(item.name)
    metadata = item.metadata or {}
    stored = (metadata.get(b"unit") or metadata.get(b"units") or b"").decode(errors="replace").strip()
    return Head(name, stored or inside, rows)


@contextmanager
def _parquet(path: Path) -> Iterator["pq.ParquetFile"]:
    """Yield an open file, or say why it cannot be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            yield file
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(f"{path}: not a readable Parquet file ({one_line(error)}); export it again") from None
