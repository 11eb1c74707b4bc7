"""A checksum behind the end of every HDF5 file that is written here, and what keeps a damaged or hostile one from HDF5.

HDF5 ignores what follows its own end, so every reader opens a sealed file unchanged, and a library that writes to it cuts the seal
off. Hence three cases, told apart before HDF5 sees the file, because HDF5 may crash on or loop over a damaged one:

- the seal is there and right: the bytes are those that were written;
- the seal is there and wrong: damaged, refused;
- there is no seal: another program wrote or changed the file, or its end is damaged. A process of its own, with limits, reads
  all of it first: it says that the file is whole, or why it could not read it, or dies of it.
"""

import hashlib
from functools import lru_cache
from pathlib import Path

import h5py

from lpvobs.errors import DataError
from lpvobs.io.safety.sandbox import answer, limited

HEAD = b"\nlpvobs sha256 "
LENGTH = len(HEAD) + 64 + 1
SECONDS, BYTES = 6, 2 * 2**30
"""What reading a file without a seal may take before it counts as damaged: computing and memory."""
BLOCK = 1 << 20
WHOLE = "whole"


def sealed(content: bytes) -> bytes:
    """Return the bytes of a file with their checksum behind them."""
    return content + HEAD + hashlib.sha256(content).hexdigest().encode() + b"\n"


def expect_sound(path: Path, remedy: str) -> None:
    """Raise DataError for a file whose seal is wrong, or that has none and cannot be read within limits."""
    found = path.stat()
    if reason := _damage(str(path), found.st_ino, found.st_size, found.st_mtime_ns):
        raise DataError(f"{path}: damaged ({reason}); {remedy}")


@lru_cache(maxsize=64)
def _damage(path: str, inode: int, size: int, changed: int) -> str:
    """Return what is wrong with a file, or nothing; remembered for as long as the file stays as it is."""
    with Path(path).open("rb") as file:
        file.seek(max(size - LENGTH, 0))
        tail = file.read(LENGTH)
        if not (tail.startswith(HEAD) and tail.endswith(b"\n")):
            said = answer("lpvobs.io.safety.seal", Path(path), SECONDS, BYTES).decode(errors="replace").strip()
            return "" if said == WHOLE else said or "HDF5 fails to read it, or takes too long"
        file.seek(0)
        hashed = hashlib.sha256()
        for place in range(0, size - LENGTH, BLOCK):
            hashed.update(file.read(min(BLOCK, size - LENGTH - place)))
    sound = hashed.hexdigest().encode() == tail[len(HEAD) : -1]
    return "" if sound else "its checksum does not match its content"


MOST_OBJECTS = 1_000_000
MOST_BYTES, MOST_TIMES = 2**30, 16
"""Largest size of all numbers in a file together, unpacked, or times its own. The largest map needs a fifth of the first, a fleet
grows with its vehicles and unpacks to less than twice itself; what is packed to do harm unpacks to a thousand times."""


def expect_self_contained(file: h5py.File, name: str, remedy: str) -> None:
    """Raise DataError unless a file holds everything itself, and unpacks to a reasonable size."""
    # Links are looked at, and only those within the file followed: others lead to whatever the file's writer names.
    links, total = 0, 0
    most = max(MOST_BYTES, MOST_TIMES * file.id.get_filesize())

    def look(path: bytes, info: h5py.h5l.LinkInfo) -> str | None:
        nonlocal links, total
        links += 1
        where = f"'{path.decode(errors='replace')}'"
        if info.type != h5py.h5l.TYPE_HARD:
            return f"{where} is a link to another place"
        if links > MOST_OBJECTS:
            return f"it has more than {MOST_OBJECTS} objects"
        dataset = h5py.h5o.open(file.id, path)
        if isinstance(dataset, h5py.h5d.DatasetID):
            properties = dataset.get_create_plist()
            if properties.get_layout() == h5py.h5d.VIRTUAL or properties.get_external_count():
                return f"{where} stores its numbers in another file"
            total += dataset.get_space().get_simple_extent_npoints() * dataset.get_type().get_size()
        return f"it unpacks to more than {most} bytes" if total > most else None

    try:
        reason = file.id.links.visit(look, info=True)
    except (RuntimeError, KeyError, OSError, ValueError, TypeError) as error:
        raise DataError(f"{name}: damaged ({error}); {remedy}") from None
    if reason:
        raise DataError(f"{name}: {reason}, expected a complete file; {remedy}")


def read_everything(path: Path) -> str:
    """Read every dataset and attribute that a file holds itself; return what HDF5 raises, or that it is whole."""

    def visit(_: str, item: h5py.Group | h5py.Dataset) -> None:
        dict(item.attrs)
        if isinstance(item, h5py.Dataset) and not item.is_virtual and not item.external:
            item[()]

    try:
        with h5py.File(path, "r") as file:
            dict(file.attrs)
            file.visititems(visit)
    except Exception as error:
        return " ".join(f"{error}".split())[:200] or type(error).__name__
    return WHOLE


if __name__ == "__main__":
    print(read_everything(limited()))
