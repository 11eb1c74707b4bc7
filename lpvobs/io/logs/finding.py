"""Logs named one by one, by pattern or by folder."""

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from lpvobs.errors import UsageError

WILD = re.compile(r"[*?]|\[.+\]")
ENDING = ".parquet"


def find_logs(named: Sequence[Path]) -> list[Path]:
    """Return the files meant: what a pattern matches and every Parquet file below a folder, in alphabetical order.

    Raises UsageError if a pattern or a folder holds no log, or a pattern means nothing.
    """
    found: list[Path] = []
    for path in named:
        if path.is_dir():
            matches = sorted(file for file in path.rglob(f"*{ENDING}") if file.is_file())
        elif WILD.search(str(path)) and not path.exists():
            matches = _matches(path)
        else:
            found.append(path)
            continue
        if not matches:
            raise UsageError(f"{path}: no log there; expected Parquet files, name them, their folder or a pattern")
        found += matches
    return found


def _matches(pattern: Path) -> list[Path]:
    start = Path(pattern.anchor) if pattern.is_absolute() else Path()
    try:
        found = sorted(start.glob(str(pattern.relative_to(pattern.anchor)) if pattern.is_absolute() else str(pattern)))
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
            raise UsageError(f"{str(path)!a}: results keep logs by name, and this is none; rename the file")
    if again := next((path for path, name in names.items() if Counter(names.values())[name] > 1), None):
        raise UsageError(f"{again}: cannot be told from another log by name or folders; rename one")
    return names
