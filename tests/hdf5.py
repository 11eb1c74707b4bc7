"""What HDF5 files hold, for tests that compare them."""

from pathlib import Path

import h5py
import numpy as np


def datasets(path: Path) -> dict[str, np.ndarray]:
    """Return the values of every dataset by its name."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
    return found


def contents(path: Path) -> dict[str, object]:
    """Return every group, dataset and attribute, numbers as bytes, texts as texts; without /provenance and HDF5's own addresses."""
    found: dict[str, object] = {}

    def look(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if name.split("/", maxsplit=1)[0] == "provenance":
            return
        found[name] = _as_it_is(item[()]) if isinstance(item, h5py.Dataset) else None
        for key, value in item.attrs.items():
            if key not in ("REFERENCE_LIST", "DIMENSION_LIST"):
                found[f"{name}@{key}"] = _as_it_is(value)

    with h5py.File(path) as file:
        file.visititems(look)
    return found


def _as_it_is(value: object) -> object:
    """Return numbers as bytes, so that NaN equals NaN, and texts as they are."""
    values = np.asarray(value)
    return values.tolist() if values.dtype.kind == "O" else values.tobytes()
