"""What an HDF5 file from a stranger may not do: point to other files, or claim more than fits into memory."""

import h5py

from lpvobs.errors import DataError

MOST_OBJECTS = 1_000_000
MOST_BYTES = 2**30
"""Largest size of all numbers in a file together, unpacked; the largest map needs a fifth of it."""


def expect_self_contained(file: h5py.File, name: str, remedy: str) -> None:
    """Raise DataError unless a file holds everything itself, under hard links, and unpacks to a reasonable size.

    Links are looked at, never followed: a soft or external link, a virtual dataset or one whose numbers lie in another file would
    make this program read whatever its writer names.
    """
    links = 0
    total = 0

    def look(path: bytes, info: h5py.h5l.LinkInfo) -> str | None:
        nonlocal links
        links += 1
        if info.type != h5py.h5l.TYPE_HARD:
            return f"'{path.decode(errors='replace')}' is a link to elsewhere"
        return "it holds too many objects" if links > MOST_OBJECTS else None

    def measure(path: bytes, info: h5py.h5o.ObjInfo) -> str | None:
        nonlocal total
        if info.type != h5py.h5o.TYPE_DATASET:
            return None
        dataset = h5py.h5d.open(file.id, path)
        properties = dataset.get_create_plist()
        if properties.get_layout() == h5py.h5d.VIRTUAL or properties.get_external_count():
            return f"'{path.decode(errors='replace')}' keeps its numbers in another file"
        total += dataset.get_space().get_simple_extent_npoints() * dataset.get_type().get_size()
        return f"it unpacks to more than {MOST_BYTES} bytes" if total > MOST_BYTES else None

    try:
        reason = file.id.links.visit(look, info=True) or h5py.h5o.visit(file.id, measure, info=True)
    except (RuntimeError, KeyError, OSError, ValueError, TypeError) as error:
        raise DataError(f"{name}: damaged ({error}); {remedy}") from None
    if reason:
        raise DataError(f"{name}: {reason}, expected a file that holds all it needs; {remedy}")
