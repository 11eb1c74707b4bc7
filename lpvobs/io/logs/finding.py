"""Logs named one by one, by pattern or by folder; whose each is, and when it was driven."""

import csv
import datetime
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from lpvobs.errors import DataError, UsageError
from lpvobs.io.arrow import pq
from lpvobs.io.logs.parquet import RemotePath, log_path, schema_of

WILD = re.compile(r"[*?]|\[.+\]")
ENDING = ".parquet"
EPOCH = datetime.date(1970, 1, 1)
FIELD = re.compile(r"\{(\w+)\}")
DATES = ("date", "day", "month")  # fields that say when, the finest first
PERIODS: Mapping[str, str] = {"day": "%Y-%m-%d", "week": "%G-W%V", "month": "%Y-%m", "year": "%Y"}


def find_logs(named: Sequence[Path]) -> list[Path]:
    """Return what a pattern matches and every Parquet file below a folder, in alphabetical order; raises UsageError for none."""
    found: list[Path] = []
    for path in map(log_path, named):
        if path.is_dir():
            matches = sorted(file for file in path.rglob(f"*{ENDING}") if file.is_file())
        elif WILD.search(str(path)) and not path.exists():
            matches = _matches(path)
        else:
            found.append(path)
            continue
        if not matches:
            raise UsageError(
                f"{path}: there is no log here; expected Parquet files; name the files, their folder or a pattern"
            )
        found += matches
    return found


def _matches(pattern: Path) -> list[Path]:
    if isinstance(pattern, RemotePath):
        return list(pattern.matching())
    try:  # a relative pattern has the anchor ``
        found = sorted(Path(pattern.anchor).glob(str(pattern.relative_to(pattern.anchor))))
    except ValueError as error:
        raise UsageError(f"{pattern}: {error}; name logs, their folder or a pattern such as logs/*.parquet") from None
    return [path for path in found if not path.is_dir()]


def log_names(paths: Sequence[Path]) -> dict[Path, str]:
    """Return a name for each log: its stem, with folders before it where stems are alike; raises UsageError for none."""
    names = {path: path.stem for path in paths}
    for depth in range(2, max((len(path.parts) for path in paths), default=0) + 1):
        often = Counter(names.values())
        names |= {path: "_".join((*path.parts[-depth:-1], path.stem)) for path in paths if often[names[path]] > 1}
    for path, name in names.items():
        try:
            usable = name.strip(".") and str(path).encode()
        except UnicodeEncodeError:
            usable = None
        if not usable:
            raise UsageError(f"{str(path)!a}: the file has no usable name, but each log needs a name; rename the file")
    if again := next((path for path, name in names.items() if Counter(names.values())[name] > 1), None):
        raise UsageError(f"{again}: has the same name and folders as another log; rename one of the two")
    return names


def origins_of(paths: Sequence[Path], pattern: str | None, table: Path | None) -> dict[Path, dict[str, str]]:
    """Return what is known of each log by field; a table with a column `log` says more than the path, the path more than the file.

    Raises UsageError for a pattern without fields, or a path that does not follow it; DataError for a table that is none.
    """
    rows = {} if table is None else _rows(table)
    named = {} if pattern is None else {path: _in_path(pattern, path) for path in paths}
    return {path: _own(path) | named.get(path, {}) | rows.get(path.resolve(), {}) for path in paths}


def _in_path(pattern: str, path: Path) -> dict[str, str]:
    if not FIELD.search(pattern):
        raise UsageError(
            f"--path {pattern}: has no field in braces; expected for example {{vehicle}}/{{month}}.parquet"
        )
    parts = FIELD.split(re.escape(pattern).replace(r"\{", "{").replace(r"\}", "}"))
    shape = "".join(f"(?P<{part}>[^/]+?)" if i % 2 else part for i, part in enumerate(parts))
    try:
        found = re.search(f"(?:^|/){shape}$", path.as_posix())
    except re.error:
        raise UsageError(
            f"--path {pattern}: a field appears twice, or a field name begins with a digit; use each field "
            "once, with a name that begins with a letter"
        ) from None
    if found is None:
        raise UsageError(
            f"{path}: the path does not fit the pattern --path {pattern}; correct the pattern or name other logs"
        )
    return found.groupdict()


def _own(path: Path) -> dict[str, str]:
    try:
        held = schema_of(path).metadata or {}
    except DataError:
        return {}
    return {k.decode(errors="replace"): v.decode(errors="replace") for k, v in held.items() if len(v) < 200}


def _rows(table: Path) -> dict[Path, dict[str, str]]:
    try:
        if table.suffix == ".parquet":
            rows = [{key: str(value) for key, value in row.items()} for row in pq.read_table(table).to_pylist()]
        else:
            with table.open(encoding="utf-8", newline="") as stream:
                rows = list(csv.DictReader(stream))
        named = [(log_path(Path(row.pop("log"))), row) for row in rows]
        return {(path if isinstance(path, RemotePath) else table.parent / path).resolve(): row for path, row in named}
    except (OSError, ValueError, KeyError, csv.Error):
        raise DataError(
            f"{table}: cannot be read as a table of logs; expected CSV or Parquet with the columns log, vehicle, date"
        ) from None


def day_of(path: Path, origin: Mapping[str, str]) -> float:
    """Return when a log was driven, days since 1970-01-01; of a month its middle."""
    text = next((origin[name] for name in DATES if origin.get(name)), "")
    try:
        whole = datetime.date.fromisoformat(text[:10] if len(text) > 7 else f"{text}-15")
    except ValueError:
        said = f"'{text}' is not a date" if text else "the date of this log is unknown"
        raise DataError(
            f"{path}: {said}; expected a date such as 2025-01-31 or a month such as 2025-01; "
            f"give it with --path or --origins, or with --date when you ingest the log"
        ) from None
    return float((whole - EPOCH).days)


def date_of(day: float) -> datetime.date:
    """Return the date of a day since 1970-01-01."""
    return EPOCH + datetime.timedelta(days=round(day))


def own_origin(vehicle: str | None, date: str | None, engine: str) -> dict[str, str]:
    """Return the metadata of a new log that says whose it is; nothing where neither is given. Raises UsageError for no date."""
    if vehicle is None and date is None:
        return {}
    if date is not None:
        try:
            day_of(Path(), {"date": date})
        except DataError:
            raise UsageError(f"--date {date}: is not a date; expected for example 2025-01-31") from None
    known = {"vehicle": vehicle, "engine": engine or None, "date": date}
    return {key: value for key, value in known.items() if value is not None}
