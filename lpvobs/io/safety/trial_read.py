"""Reads a whole HDF5 file in a process of its own: `python -m lpvobs.io.safety.trial_read FILE SECONDS BYTES`.

Exit code 0 if everything in it can be read; otherwise the reason stands on stdout, or the process has died of it.
"""

import sys

import h5py

from lpvobs.io.safety.sandbox import limit


def read_everything(path: str) -> None:
    """Read every dataset and attribute that a file holds itself; raises whatever HDF5 raises."""

    def visit(_: str, item: h5py.Group | h5py.Dataset) -> None:
        dict(item.attrs)
        if isinstance(item, h5py.Dataset) and not item.is_virtual and not item.external:
            item[()]

    with h5py.File(path, "r") as file:
        dict(file.attrs)
        file.visititems(visit)


def main(path: str, seconds: str, most_bytes: str) -> int:
    """Read the file within limits; return the exit code."""
    limit(int(seconds), int(most_bytes))
    try:
        read_everything(path)
    except Exception as error:
        print(" ".join(f"{error}".split())[:200] or type(error).__name__)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
