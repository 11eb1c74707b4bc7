"""Tables of operating points: Parquet as for logs, or CSV with the units in a second line."""

import csv
from collections.abc import Mapping
from pathlib import Path

from lpvobs.io.logs.parquet import write_log
from lpvobs.io.safety.atomic import replacing
from lpvobs.records import Array


def write_table(path: Path, columns: Mapping[str, Array], units: Mapping[str, str]) -> None:
    """Write columns of equal length, shape (N,), with their units; a name that ends in `.csv` makes a CSV file.

    Numbers in CSV are the shortest that read back the same.
    """
    if path.suffix.lower() != ".csv":
        write_log(path, columns, units)
        return
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerow(units[name] for name in columns)
        writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
