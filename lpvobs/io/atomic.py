"""Files that appear whole or not at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lpvobs.errors import DataError


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Yield the path of a temporary file beside `target`; on success it takes the target's place, else it is removed.

    At any instant the target is absent, the old file, or the complete new one.

    Raises
    ------
    DataError
        If the folder does not exist or cannot be written, or the target is a folder, a device or a pipe.
    """
    target = _regular(target)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
    except OSError as error:
        raise DataError(
            f"{target}: cannot be written ({error.strerror}); name a folder that exists and is writable"
        ) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except OSError as error:
        raise DataError(f"{target}: writing failed ({error.strerror or error}); the file is as it was before") from None
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def _regular(target: Path) -> Path:
    """Return the file behind symbolic links; refuse what must not be replaced, and names that other readers cannot open."""
    try:
        str(target).encode()
    except UnicodeEncodeError:
        raise DataError(f"{str(target)!a}: the name is not UTF-8; choose another") from None
    resolved = target.resolve()
    if resolved.exists() and not resolved.is_file():
        raise DataError(f"{target}: is not a regular file, and would be replaced by one; name a file")
    return resolved


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
