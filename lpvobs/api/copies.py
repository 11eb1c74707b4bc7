"""Logs that are there twice."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from lpvobs.errors import UsageError
from lpvobs.io.safety.unchanged import file_digest


def refuse_copies(paths: Sequence[Path]) -> None:
    """Raise for two logs of the same bytes, which would count twice; only files of the same size are looked into."""
    by_size: dict[int, list[Path]] = {}
    for path in paths:
        with suppress(OSError):
            by_size.setdefault(path.stat().st_size, []).append(path)
    for same in by_size.values():
        seen: dict[str, Path] = {}
        for path in same if len(same) > 1 else ():
            if not path.is_file():
                continue
            try:
                digest = file_digest(path)
            except OSError:  # whoever reads it tells why it cannot be
                continue
            if digest in seen:
                raise UsageError(
                    f"{path}: same bytes as {seen[digest]}; the same drive would count twice, leave one out"
                )
            seen[digest] = path
