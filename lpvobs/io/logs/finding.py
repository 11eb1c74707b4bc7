"""Logs named one by one, by pattern or by folder."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from lpvobs.errors import UsageError
from lpvobs.io.logs.parquet import RemotePath, log_path

WILD = re.compile(r"[*?]|\[.+\]")
ENDING = ".parquet"


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
