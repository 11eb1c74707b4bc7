"""Files that appear whole or not at all, written by one process at a time; and whether a file is still the one that was looked at.

A writer claims its target with a lock on a hidden file beside it, `.NAME.lock`. The system drops the lock when the process ends,
however it ends, so no lock is ever stale: what a killed writer has left behind is swept away by the next one.
"""

import errno
import fcntl
import hashlib
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_ISREG

from lpvobs.errors import DataError

_claims: set[Path] = set()  # targets that this process has claimed
_TEMPORARY = re.compile(r"\.(.+)\.[a-z0-9_]{8}\.part", re.DOTALL)


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Yield the path of a temporary file beside `target`; on success it takes the target's place, else it is removed.

    At any instant the target is absent, the old file, or the complete new one. Raises DataError if the folder does not exist or
    cannot be written, the target is a folder, a device or a pipe, or another process is writing it.
    """
    with claimed(target) as regular:
        try:
            handle, name = tempfile.mkstemp(prefix=f".{_whole(regular).name}.", suffix=".part", dir=regular.parent)
            os.close(handle)
            temporary = Path(name)
            try:
                yield temporary
                with temporary.open("rb") as written:
                    os.fsync(written.fileno())
                mask = os.umask(0)
                os.umask(mask)
                temporary.chmod(0o666 & ~mask)
                temporary.replace(regular)
            finally:
                temporary.unlink(missing_ok=True)
        except OSError as error:
            raise DataError(
                f"{regular}: writing failed ({error.strerror or error}); the file was not changed; free disk space and "
                "run this again"
            ) from None


@contextmanager
def claimed(target: Path) -> Iterator[Path]:
    """Keep other processes from writing `target`, and sweep away what killed writers have left; yield the file, raise as above."""
    target = _regular(target)
    if _whole(target) in _claims:  # whoever claimed it first lets it go
        yield target
        return
    lock = target.with_name(f".{target.name}.lock")
    try:
        handle = _locked(lock)
    except BlockingIOError:
        raise DataError(f"{target}: another process is writing this file; wait, or name another file") from None
    except OSError as error:
        raise DataError(f"{target}: cannot be written ({error.strerror}); name a writable folder") from None
    try:
        _claims.add(target)
        with suppress(OSError):  # what killed writers have left; `map` sweeps nothing that `map.h5` writes
            for left in target.parent.iterdir():
                own = _TEMPORARY.fullmatch(left.name)
                if own and own[1] == target.name and S_ISREG(left.lstat().st_mode):
                    left.unlink(missing_ok=True)
        yield target
    finally:
        _claims.discard(target)
        with suppress(OSError):
            lock.unlink()
        os.close(handle)


def _whole(target: Path) -> Path:
    """Return the file that a temporary file of this process takes the place of, a target itself: the next writer sweeps that."""
    own = _TEMPORARY.fullmatch(target.name)
    return target.with_name(own[1]) if own and target.with_name(own[1]) in _claims else target


def _locked(lock: Path) -> int:
    """Return an open, locked file that is still the one under this name: the last owner removes it before it lets go."""
    while True:
        handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(handle), lock.stat()):
                return handle
        except FileNotFoundError:
            pass
        except OSError as error:
            if error.errno in (errno.ENOSYS, errno.ENOLCK, errno.ENOTSUP):  # a file system without locks: no protection
                return handle
            os.close(handle)
            raise
        os.close(handle)


def _regular(target: Path) -> Path:
    """Return the file behind symbolic links; refuse what must not be replaced, and names that other readers cannot open."""
    try:
        str(target).encode()
    except UnicodeEncodeError:
        raise DataError(f"{str(target)!a}: the name is not UTF-8; choose another name") from None
    try:
        resolved = target.resolve()
        taken = resolved.exists() and not resolved.is_file()
    except (OSError, RuntimeError, ValueError) as error:
        raise DataError(f"{target}: cannot be written ({error}); name a file") from None
    if taken or not resolved.name:
        raise DataError(f"{target}: is not a regular file, so it is not overwritten; name a file")
    return resolved


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def state_of(path: Path) -> tuple[int, ...]:
    """Return what changes when somebody writes to a file."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return (found.st_ino, found.st_size, found.st_mtime_ns)
