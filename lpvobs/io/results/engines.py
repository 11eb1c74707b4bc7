"""`ENGINE.h5`: what is known of an engine, with the bench points behind it; and what a result says of the engine of its map.

`/engine` is what healthy logs have taught of an engine and of its errors, so that `trace` needs none of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import h5py
import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.base import AirPath
from lpvobs.engines.curves import Knowledge, LearnedCurve, LearnedNumber, Nodes
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.unknowns import LeftAtNodes, Unknowns
from lpvobs.errors import DataError
from lpvobs.io.results.hdf import Contents, Field, creating, reading, write_fields, write_group
from lpvobs.io.results.mapping import Layout, fields, read, values, write
from lpvobs.io.results.provenance import Provenance, expect_engine
from lpvobs.observer.estimate import EngineFound
from lpvobs.records import Array, Item

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


def _axes(axes: Mapping[str, Nodes]) -> Contents:
    """Return the nodes of a curve as datasets; a slash in a dataset's name would be a group."""
    return {
        name.replace("/", "_over_"): Field(nodes.values, Item(nodes.unit, nodes.meaning))
        for name, nodes in axes.items()
    }


def write_learned(file: h5py.File, learning: Learning) -> None:
    """Write `/engine` into a file that has none."""
    known = learning.known
    group = file.create_group(GROUP)
    group.attrs["logs"] = list(known.sources)
    for name, curve in known.curves.items():
        axes = _axes(curve.axes)
        write_group(group, name, axes | fields(_layout(curve.name, curve.unit, curve.meaning, tuple(axes)), curve))
    every = np.arange(known.covariance.shape[0], dtype=np.int32)
    meaning = "relative deviation of every node of the curves, then of the numbers that have one"
    plain: Contents = {name: Field(item.value, Item(item.unit, item.meaning)) for name, item in known.numbers.items()}
    plain |= {axis: Field(every, Item("1", meaning)) for axis in ALL}
    write_group(group, "numbers", plain | fields(COVARIANCE, known))
    write(group, "healthy_errors", learning.healthy, {"balance": learning.balances})


def read_learned(file: h5py.File) -> Learning:
    """Return what `/engine` of an open file holds; raises DataError where there is none."""
    if GROUP not in file:
        raise DataError(
            f"{file.filename}: has no properties learned from healthy logs; make the file again with `lpvobs calibrate --healthy`"
        )
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


KIND = "engine"
REMEDY = "make an engine with `lpvobs calibrate`"


@dataclass(frozen=True)
class EngineRow:
    """A bench point as a calibration saw it."""

    kind: Annotated[str, Item("1", "balance or measured part", name="row")]
    point: Annotated[int, Item("1", "number of the bench point, -1 for one of a component's table")]
    reference: Annotated[float, Item("kg/s", "reference flow")]
    before: Annotated[float, Item("kg/s", "reference less the flow of the configured engine", gaps=True)]
    held_out: Annotated[float, Item("kg/s", "reference less what all other points say of it")]
    held_out_error: Annotated[float, Item("kg/s", "standard deviation of held_out")]


@dataclass(frozen=True)
class ComponentPoint:
    """What a row says of a component's correction: the correction there, and with it all that is left of the row."""

    component: Annotated[str, Item("1", "component", name="row")]
    kind: Annotated[str, Item("1", "balance or measured part")]
    along: Annotated[float, Item("1", "first input of the component, in the unit of its axis")]
    across: Annotated[float, Item("1", "second input, zero where there is none")]
    value: Annotated[float, Item("1", "correction, in its unit")]


@dataclass(frozen=True, eq=False)
class StoredEngine:
    """A calibrated engine."""

    air_path: str
    constants: Mapping[str, float]  # as configured
    unknowns: Unknowns  # mean and covariance, deviations counted from those
    prior_error: Array  # (q,) standard deviation of every unknown before the data, at the amplitudes found
    amplitudes: Mapping[str, float]  # of the corrections by group
    left: Mapping[str, float]  # by kind of row, over the flow: what no correction follows
    rows: Annotated[tuple[EngineRow, ...], Item(axes=("row",), name="rows")]  # none where no bench was there
    provenance: Annotated[Provenance, Item()]
    # on the corrections; none where no bench was there
    points: Annotated[tuple[ComponentPoint, ...], Item(axes=("row",), name="points")] = ()
    learned: Learning | None = None  # of an engine whose curves healthy logs show; it has no other unknowns

    @property
    def deviation(self) -> dict[str, float]:
        """Relative deviation of every constant from the configured one."""
        return self.unknowns.deviation()

    @property
    def error(self) -> Array:
        """Standard deviation of every unknown, shape (q,)."""
        return np.sqrt(np.maximum(np.diag(self.unknowns.covariance), 0.0))

    def corrections(self) -> dict[str, Array]:
        """Return the values of every correction, shape (size,) each."""
        return {name: self.unknowns.mean[own] for name, own in self.unknowns.places().items()}

    @property
    def determined(self) -> NDArray[np.bool_]:
        """Whether the data say more of an unknown than was known before: less than half of the spread is left; shape (q,)."""
        return np.asarray(self.error < DETERMINED * self.prior_error)


DETERMINED = 0.5  # share of the prior standard deviation below which the data have determined an unknown


@dataclass(frozen=True, eq=False)
class _UnknownsAsStored:
    names: Annotated[tuple[str, ...], Item("1", "constant, or node of a correction", name="unknown")]
    mean: Annotated[Array, Item("1", "relative deviation of a constant, value of a correction", ("unknown",))]
    covariance: Annotated[Array, Item("1", "covariance of mean", ("unknown", "other_unknown"))]
    at_nodes: Annotated[LeftAtNodes | None, Item(name="left_at_nodes")]


PRIOR = Layout(StoredEngine, {"prior_error": Item("1", "standard deviation before the data", ("unknown",))})


def write_engine(path: Path, stored: StoredEngine) -> None:
    """Write an engine, which appears whole."""
    unknowns = fields(_UnknownsAsStored, stored.unknowns)
    unknowns["prior_error"] = fields(PRIOR, stored)["prior_error"]
    components = _corrections(stored.unknowns, stored.unknowns.mean, stored.error)
    with creating(path, KIND) as file:
        write_fields(file, fields(StoredEngine, stored) | {"unknowns": unknowns, "components": components})
        if stored.learned is not None:
            write_learned(file, stored.learned)


def read_unknowns(group: h5py.Group, air_path: AirPath) -> Unknowns:
    """Return the unknowns of a calibrated engine; raises DataError for others than this version has."""
    stored, components = read(group, _UnknownsAsStored), air_path.components
    own = stored.names[: max(len(stored.names) - sum(component.size for component in components), 0)]
    found = Unknowns(own, components, stored.mean, stored.covariance, learned=True, at_nodes=stored.at_nodes)
    if found.names != stored.names or not set(own) <= set(air_path.engine_constants()):
        raise DataError(
            f"{group.file.filename}: holds estimated quantities that this version of lpvobs does not have; {REMEDY} again"
        )
    return found


def _corrections(unknowns: Unknowns, mean: Array, error: Array) -> Contents:
    """Return the groups of all corrections, each over its own axes, for people."""
    found: Contents = {}
    for component in unknowns.components:
        own = unknowns.places()[component.name]
        axes = _axes(component.axes)
        shape = tuple(nodes.values.size for nodes in component.axes.values())
        item = Item(component.unit, component.meaning, tuple(axes))
        axes["correction"] = Field(mean[own].reshape(shape), item)
        axes["standard_error"] = Field(error[own].reshape(shape), replace(item, meaning="standard error of it"))
        found[component.name] = axes | {"group": component.group}
    return found


def read_engine(path: Path, air_path: AirPath) -> StoredEngine:
    """Return a stored engine; raises DataError for anything else, and for one that was calibrated from other constants."""
    with reading(path, KIND, REMEDY) as file:
        kept = values(file, StoredEngine)
        expect_engine(path, "calibrated from", (kept["air_path"], kept["constants"]), air_path, REMEDY)
        return StoredEngine(
            **kept,
            unknowns=read_unknowns(file["unknowns"], air_path),
            **values(file["unknowns"], PRIOR),
            learned=read_learned(file) if air_path.learns else None,
        )


ENGINE_FOUND, BEFORE = "engine_found", "engine_before"


@dataclass(frozen=True, eq=False)
class EngineOfMap:
    """The engine that a map goes with."""

    constants: Annotated[tuple[str, ...], Item("1", "uncertain constant of the engine", name="constant")]
    deviation: Annotated[Array, Item("1", "from the configured, of a mode from the calibrated value", ("constant",))]
    covariance: Annotated[Array, Item("1", "covariance of the deviations", ("constant", "other_constant"))]
    groups: Annotated[tuple[str, ...], Item("1", "components whose corrections share an amplitude", name="group")]
    amplitudes: Annotated[tuple[float, ...], Item("1", "of these, over what was expected", ("group",), "amplitude")]


def write_engine_found(file: h5py.File, found: EngineFound) -> None:
    """Write constants, corrections over their own axes, and what a calibration knew, into a result that has none."""
    if found.unknowns.learned:
        write_group(file, BEFORE, fields(_UnknownsAsStored, found.before()))
    unknowns, q = found.unknowns, len(found.unknowns.constants)
    seen_from = np.array([1.0 + found.point.get(name, 0.0) for name in unknowns.coordinates])
    deviation = unknowns.reduction.T @ (found.mean - unknowns.mean)
    deviation[:q] = list(found.deviation().values())  # seen from the configured values
    covariance = unknowns.reduced(found.covariance) * np.outer(seen_from, seen_from)
    stored = EngineOfMap(unknowns.coordinates, deviation, covariance, unknowns.groups(), found.amplitudes)
    errors = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))  # of what is known exactly, rounding is left
    write(file, ENGINE_FOUND, stored, beside=_corrections(unknowns, found.mean, errors))


def read_corrections(file: h5py.File, air_path: AirPath) -> dict[str, Array]:
    """Return the values of every correction of an open result, shape (size,) each."""
    return {item.name: file[ENGINE_FOUND][item.name]["correction"][()].reshape(-1) for item in air_path.components}
