"""A checksum behind the end of every HDF5 file that is written here, and what is done with files whose checksum says no.

HDF5 ignores what follows its own end, so every reader opens a sealed file unchanged, and a library that writes to it cuts the seal
off. Hence three cases, told apart before HDF5 sees the file, because HDF5 may crash on or loop over a damaged one:

- the seal is there and right: the bytes are those that were written;
- the seal is there and wrong: damaged, refused;
- there is no seal: another program wrote or changed the file, or its end is damaged. A process of its own, with limits, reads
  all of it first.
"""

import hashlib
import subprocess
from functools import lru_cache
from pathlib import Path

from lpvobs.errors import DataError
from lpvobs.io.safety.sandbox import call, environment

HEAD = b"\nlpvobs sha256 "
LENGTH = len(HEAD) + 64 + 1
SECONDS, BYTES, PATIENCE = 6, 2 * 2**30, 90
"""What reading a file without a seal may take before it counts as damaged: computing, memory, and time on a busy machine [s]."""
BLOCK = 1 << 20


def sealed(content: bytes) -> bytes:
    """Return the bytes of a file with their checksum behind them."""
    return content + HEAD + hashlib.sha256(content).hexdigest().encode() + b"\n"


def expect_sound(path: Path, remedy: str) -> None:
    """Raise DataError for a file whose seal is wrong, or that has none and cannot be read within limits."""
    found = path.stat()
    reason = _damage(str(path), found.st_ino, found.st_size, found.st_mtime_ns)
    if reason:
        raise DataError(f"{path}: damaged ({reason}); {remedy}")


@lru_cache(maxsize=64)
def _damage(path: str, inode: int, size: int, changed: int) -> str:
    """Return what is wrong with a file, or nothing; remembered for as long as the file stays as it is."""
    written = _seal_of(Path(path), size)
    if written is None:
        return _probe(path)
    return "" if _digest(Path(path), size - LENGTH) == written else "its checksum does not match its content"


def _seal_of(path: Path, size: int) -> bytes | None:
    if size < LENGTH:
        return None
    with path.open("rb") as file:
        file.seek(size - LENGTH)
        tail = file.read(LENGTH)
    return tail[len(HEAD) : -1] if tail.startswith(HEAD) and tail.endswith(b"\n") else None


def _digest(path: Path, length: int) -> bytes:
    """Return the SHA-256 of the first bytes of a file, in hexadecimal."""
    hashed = hashlib.sha256()
    with path.open("rb") as file:
        while length > 0 and (block := file.read(min(BLOCK, length))):
            hashed.update(block)
            length -= len(block)
    return hashed.hexdigest().encode()


def _probe(path: str) -> str:
    """Return why a process of its own could not read the whole file, or nothing."""
    line = call("lpvobs.io.safety.trial_read", path, str(SECONDS), str(BYTES))
    try:
        done = subprocess.run(
            line, env=environment(), capture_output=True, timeout=PATIENCE, stdin=subprocess.DEVNULL, check=False
        )
    except subprocess.TimeoutExpired:
        return "HDF5 does not come to an end with it"
    if done.returncode == 0:
        return ""
    said = done.stdout.decode(errors="replace").strip()
    return said or "HDF5 fails on it"
