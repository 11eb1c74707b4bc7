"""`/engine`: what healthy logs have taught of an engine and of its errors, so that `trace` needs none of them."""

from dataclasses import dataclass

import h5py
import numpy as np

from lpvobs.engines.curves import Knowledge, LearnedCurve, LearnedNumber, Nodes
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.errors import DataError
from lpvobs.io.results.hdf import Field, write_group
from lpvobs.io.results.mapping import Contents, Layout, fields, read, values, write
from lpvobs.records import Item

GROUP = "engine"
ALL = ("deviation", "other_deviation")
COVARIANCE = Layout(Knowledge, {"covariance": Item("1", "covariance of all relative deviations", ALL)})


@dataclass(frozen=True, eq=False)
class Learning:
    """What healthy logs have taught of an engine, and how wrong its balances are on parts of them that taught nothing."""

    known: Knowledge
    healthy: HealthyErrors
    balances: tuple[str, ...]


def _layout(name: str, unit: str, meaning: str, axes: tuple[str, ...]) -> Layout[LearnedCurve]:
    """Return how a curve stands in its group, its values under their own name."""
    items = {"values": Item(unit, meaning, axes, name)}
    return Layout(LearnedCurve, items | {"relative_error": Item("1", "standard error over the value", axes)})


def write_learned(file: h5py.File, learning: Learning) -> None:
    """Write `/engine` into a file that has none."""
    known = learning.known
    group = file.create_group(GROUP)
    group.attrs["logs"] = list(known.sources)
    for name, curve in known.curves.items():
        axes: Contents = {axis: Field(nodes.values, nodes.unit, nodes.meaning) for axis, nodes in curve.axes.items()}
        write_group(group, name, axes | fields(_layout(curve.name, curve.unit, curve.meaning, tuple(axes)), curve))
    every = np.arange(known.covariance.shape[0], dtype=np.int32)
    meaning = "relative deviation of every node of the curves, then of the numbers that have one"
    plain: Contents = {name: Field(item.value, item.unit, item.meaning) for name, item in known.numbers.items()}
    plain |= {axis: Field(every, "1", meaning) for axis in ALL}
    write_group(group, "numbers", plain | fields(COVARIANCE, known))
    write(group, "healthy_errors", learning.healthy, {"balance": learning.balances})


def read_learned(file: h5py.File) -> Learning:
    """Return what `/engine` of an open file holds; raises DataError where there is none."""
    if GROUP not in file:
        raise DataError(f"{file.filename}: has no learned engine; make it with `lpvobs calibrate --healthy`")
    group = file[GROUP]
    own, errors = group["numbers"], group["healthy_errors"]
    known = Knowledge(
        curves={name: _curve(group[name]) for name in group if name not in ("numbers", "healthy_errors")},
        numbers={name: LearnedNumber(float(item[()]), *_said(item)) for name, item in own.items() if item.ndim == 0},
        sources=tuple(map(str, group.attrs["logs"])),
        **values(own, COVARIANCE),
    )
    return Learning(known, read(errors, HealthyErrors), tuple(map(str, errors["balance"].asstr()[()])))


def _said(item: h5py.Dataset) -> tuple[str, str]:
    """Return unit and meaning of a dataset."""
    return str(item.attrs["units"]), str(item.attrs["long_name"])


def _curve(group: h5py.Group) -> LearnedCurve:
    (name,) = (key for key, item in group.items() if item.ndim and not item.is_scale and key != "relative_error")
    found = {dimension[0].name.rsplit("/", 1)[1]: dimension[0] for dimension in group[name].dims}
    axes = {key: Nodes(axis[()], *_said(axis)) for key, axis in found.items()}
    unit, meaning = _said(group[name])
    return read(group, _layout(name, unit, meaning, tuple(axes)), axes=axes, name=name, unit=unit, meaning=meaning)
