"""`/engine`: what healthy logs have taught of an engine and of its errors, so that `trace` needs none of them."""

from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from lpvobs.engines.curves import Knowledge, LearnedCurve, LearnedNumber, Nodes
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.errors import DataError
from lpvobs.io.results.hdf import Field, write_group
from lpvobs.io.results.mapping import read, write
from lpvobs.records import Array

GROUP = "engine"


@dataclass(frozen=True, eq=False)
class Learning:
    """What healthy logs have taught of an engine, and how wrong its balances are on parts of them that taught nothing."""

    known: Knowledge
    healthy: HealthyErrors
    balances: tuple[str, ...]


def write_learned(file: h5py.File, learning: Learning) -> None:
    """Write `/engine` into a file that has none."""
    known = learning.known
    group = file.create_group(GROUP)
    group.attrs["logs"] = list(known.sources)
    for name, curve in known.curves.items():
        axes = {axis: Field(nodes.values, nodes.unit, nodes.meaning) for axis, nodes in curve.axes.items()}
        values = Field(curve.values, curve.unit, curve.meaning, tuple(axes))
        error = Field(curve.relative_error, "1", "standard error over the value", tuple(axes))
        write_group(group, name, axes | {curve.name: values, "relative_error": error})
    every = np.arange(known.covariance.shape[0], dtype=np.int32)
    plain = {name: Field(number.value, number.unit, number.meaning) for name, number in known.numbers.items()}
    meaning = "relative deviation of every node of the curves, then of the numbers that have one"
    covariance = Field(known.covariance, "1", "covariance of all relative deviations", ("deviation", "other_deviation"))
    both = {axis: Field(every, "1", meaning) for axis in ("deviation", "other_deviation")}
    write_group(group, "numbers", plain | both | {"covariance": covariance})
    write(group, "healthy_errors", learning.healthy, {"balance": learning.balances})


def read_learned(file: h5py.File) -> Learning:
    """Return what `/engine` of an open file holds; raises DataError where there is none."""
    if GROUP not in file:
        raise DataError(f"{file.filename}: has no learned engine; make it with `lpvobs calibrate --healthy`")
    group = file[GROUP]
    own = group["numbers"]
    size = own["deviation"].size
    known = Knowledge(
        curves={name: _curve(group[name]) for name in group if name not in ("numbers", "healthy_errors")},
        numbers={
            name: LearnedNumber(float(item[()]), str(item.attrs["units"]), str(item.attrs["long_name"]))
            for name, item in own.items()
            if item.ndim == 0
        },
        covariance=_numbers(own, "covariance", size, size),
        sources=tuple(map(str, group.attrs["logs"])),
    )
    errors = group["healthy_errors"]
    balances = tuple(map(str, errors["balance"].asstr()[()]))
    return Learning(known, read(errors, HealthyErrors), balances)


def _curve(group: h5py.Group) -> LearnedCurve:
    (name,) = (key for key, item in group.items() if item.ndim and not item.is_scale and key != "relative_error")
    axes = {dimension[0].name.rsplit("/", 1)[1]: dimension[0] for dimension in group[name].dims}
    shape = tuple(axis.size for axis in axes.values())

    def words(item: Any) -> tuple[str, str]:
        return str(item.attrs["units"]), str(item.attrs["long_name"])

    return LearnedCurve(
        axes={key: Nodes(axis[()], *words(axis)) for key, axis in axes.items()},
        name=name,
        unit=words(group[name])[0],
        meaning=words(group[name])[1],
        values=_numbers(group, name, *shape),
        relative_error=_numbers(group, "relative_error", *shape),
    )


def _numbers(group: h5py.Group, name: str, *shape: int) -> Array:
    """Return a dataset of finite numbers; raises ValueError for another shape or content, of which `hdf.reading` tells."""
    found = np.asarray(group[name][()])
    if found.dtype.kind not in "fiu" or found.shape != shape or not np.isfinite(found).all():
        raise ValueError(
            f"'{name}' holds {found.dtype} of shape {found.shape}, expected finite numbers of shape {shape}"
        )
    return found.astype(float, copy=False)
