"""`ENGINE.h5`: what is known of an engine, with the bench points behind it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import h5py
import numpy as np

from lpvobs.engines.base import AirPath
from lpvobs.engines.unknowns import Unknowns
from lpvobs.errors import DataError
from lpvobs.io.results.hdf import Field, creating, reading, text, write_group
from lpvobs.io.results.mapping import read_rows, rows
from lpvobs.io.results.provenance import Provenance, read_provenance
from lpvobs.io.safety.unchanged import file_digest
from lpvobs.records import Array, Item

KIND = "engine"
REMEDY = "make it with `lpvobs calibrate`"


@dataclass(frozen=True)
class EngineRow:
    """A bench point as a calibration saw it."""

    kind: Annotated[str, Item("1", "balance or measured part", name="row")]
    point: Annotated[int, Item("1", "number of the bench point, -1 for one of a component's table")]
    reference: Annotated[float, Item("kg/s", "reference flow")]
    before: Annotated[float, Item("kg/s", "reference less the flow of the configured engine", gaps=True)]
    held_out: Annotated[float, Item("kg/s", "reference less what all other points say of it")]
    held_out_error: Annotated[float, Item("kg/s", "standard deviation of held_out")]


@dataclass(frozen=True, eq=False)
class StoredEngine:
    """A calibrated engine."""

    air_path: str
    constants: Mapping[str, float]  # as configured
    unknowns: Unknowns  # mean and covariance, deviations counted from those
    prior_error: Array  # (q,) standard deviation of every unknown before the data, at the amplitudes found
    amplitudes: Mapping[str, float]  # of the corrections by group
    left: Mapping[str, float]  # by kind of row, over the flow: what no correction follows
    rows: tuple[EngineRow, ...]  # None where no bench was there
    provenance: Provenance

    @property
    def deviation(self) -> dict[str, float]:
        """Relative deviation of every constant from the configured one."""
        return self.unknowns.deviation()

    @property
    def error(self) -> Array:
        """Standard deviation of every unknown, shape (q,)."""
        return np.sqrt(np.maximum(np.diag(self.unknowns.covariance), 0.0))

    def determined(self) -> dict[str, bool]:
        """Return by constant whether the data say more of it than was known before: less than half of the spread is left."""
        told = self.error < DETERMINED * self.prior_error
        return dict(zip(self.unknowns.constants, told.tolist(), strict=False))


@dataclass(frozen=True)
class CalibratedEngine:
    """A calibrated engine, with the name and the digest of its file."""

    name: str
    sha256: str
    stored: StoredEngine


DETERMINED = 0.5
"""Share of the prior standard deviation below which the data have determined a constant."""


def write_engine(path: Path, stored: StoredEngine) -> None:
    """Write an engine; at any instant the target is absent, the old file, or the complete new one."""
    unknowns = stored.unknowns
    with creating(path) as file:
        file.attrs["schema"] = f"lpvobs/{KIND}/1"
        file.attrs["air_path"] = stored.air_path
        for name in ("constants", "amplitudes", "left"):
            group = file.create_group(name)
            for key, value in getattr(stored, name).items():
                group.attrs[key] = value
        before = Field(stored.prior_error, "1", "standard deviation before the data", ("unknown",))
        write_group(file, "unknowns", {**unknowns_fields(unknowns), "prior_error": before})
        _write_components(file.create_group("components"), stored)
        write_group(file, "rows", rows(stored.rows, "row"))
        stored.provenance.write(file)


def unknowns_fields(unknowns: Unknowns) -> dict[str, Field]:
    """Return the unknowns of an engine as a file has them."""
    square = ("unknown", "other_unknown")
    names = {axis: Field(text(unknowns.names), "1", "constant, or node of a correction") for axis in square}
    return names | {
        "mean": Field(unknowns.mean, "1", "relative deviation of a constant, value of a correction", square[:1]),
        "covariance": Field(unknowns.covariance, "1", "covariance of mean", square),
    }


def read_unknowns(group: h5py.Group, air_path: AirPath) -> Unknowns:
    """Return the unknowns of a calibrated engine; raises DataError for others than this version has."""
    names = tuple(map(str, group["unknown"].asstr()[()]))
    q, components = len(names), air_path.components
    own = names[: max(q - sum(component.size for component in components), 0)]
    found = Unknowns(own, components, _finite(group, "mean", q), _finite(group, "covariance", q, q), learned=True)
    if found.names != names or not set(own) <= set(air_path.engine_constants()):
        raise DataError(
            f"{group.file.filename}: has unknowns that this version of lpvobs does not know; {REMEDY} again"
        )
    return found


def _write_components(parent: h5py.Group, stored: StoredEngine) -> None:
    """Write every correction over its own axes, for people; `unknowns` has the same numbers."""
    for component in stored.unknowns.components:
        own = stored.unknowns.places()[component.name]
        names = [name.replace("/", "_over_") for name in component.axes]
        axes = {
            name: Field(nodes.values, nodes.unit, nodes.meaning)
            for name, nodes in zip(names, component.axes.values(), strict=True)
        }
        shape = [nodes.values.size for nodes in component.axes.values()]
        shown = {
            "correction": Field(
                stored.unknowns.mean[own].reshape(shape), component.unit, component.meaning, tuple(names)
            ),
            "standard_error": Field(stored.error[own].reshape(shape), component.unit, "standard error", tuple(names)),
        }
        write_group(parent, component.name, {**axes, **shown, "group": component.group})


def read_engine(path: Path, air_path: AirPath) -> StoredEngine:
    """Return a stored engine; raises DataError for anything else, and for one that was calibrated from other constants."""
    with reading(path, KIND, REMEDY) as file:
        constants = _numbers(file["constants"])
        _expect_engine(path, str(file.attrs["air_path"]), constants, air_path)
        unknowns = read_unknowns(file["unknowns"], air_path)
        return StoredEngine(
            air_path=air_path.name,
            constants=constants,
            unknowns=unknowns,
            prior_error=_finite(file["unknowns"], "prior_error", unknowns.size),
            amplitudes=_numbers(file["amplitudes"]),
            left=_numbers(file["left"]),
            rows=read_rows(file["rows"], EngineRow, "row"),
            provenance=read_provenance(file),
        )


def calibrated_engine(path: Path, air_path: AirPath) -> CalibratedEngine:
    """Return a stored engine with the digest of its file; raises as `read_engine` does."""
    stored = read_engine(path, air_path)
    return CalibratedEngine(path.name, file_digest(path), stored)


def _expect_engine(path: Path, kind: str, constants: Mapping[str, float], air_path: AirPath) -> None:
    """Raise DataError unless an engine was calibrated from the configured constants."""
    if kind != air_path.name:
        raise DataError(f"{path}: is a {kind} engine, the configuration has '{air_path.name}'; {REMEDY} from this one")
    for name, value in air_path.engine_constants().items():
        if constants.get(name) != value:
            raise DataError(
                f"{path}: calibrated from another engine: {name} is {constants.get(name)} there and {value:g} in the "
                f"configuration; {REMEDY} from this configuration"
            )


def _numbers(group: h5py.Group) -> dict[str, float]:
    """Return the attributes of a group; raises ValueError for what is not a finite number."""
    found = {str(name): float(value) for name, value in group.attrs.items()}
    if not np.isfinite(list(found.values())).all():
        raise ValueError(f"'{group.name}' holds what is not finite")
    return found


def _finite(group: h5py.Group, name: str, *shape: int) -> Array:
    """Return a dataset of finite numbers; raises ValueError for another shape or content."""
    found = np.asarray(group[name][()], dtype=float)
    if found.shape != shape or not np.isfinite(found).all():
        raise ValueError(f"'{name}' has the shape {found.shape}, expected finite numbers of shape {shape}")
    return found
