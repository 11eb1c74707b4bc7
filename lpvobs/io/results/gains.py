"""A gain with its certificate, in a file of its own and inside every result that it made."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import h5py
import msgspec
import numpy as np

from lpvobs.errors import DataError
from lpvobs.io.results import hdf, mapping, provenance
from lpvobs.observer.parts import StateGain
from lpvobs.records import Array, Item
from lpvobs.synthesis.certificate import Gain
from lpvobs.synthesis.region import Region

if TYPE_CHECKING:
    from lpvobs.io.configuration.config import Config

KIND = "gain"
REMEDY = "make a gain with `lpvobs synth-gain`"


@dataclass(frozen=True)
class StoredGain:
    """A gain, whose engine it is for, and which logs its region was drawn from."""

    origin: str  # `synthesised`, or where a published gain was printed
    air_path: str
    engine: Mapping[str, float]  # the engine's constants
    states: Annotated[tuple[str, ...], Item("1", "state", name="state")]
    outputs: tuple[str, ...]  # the measured states among the outputs; the sensor comes after them
    gain: Annotated[Gain, Item(name=".")]
    log_bounds: Annotated[Mapping[str, Array], Item("SI", "range of the parameters", ("log", "bound", "parameter"))]
    # [K], ranges that the region was made for
    temperatures: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def state(self) -> StateGain:
        """The part that corrects the state."""
        return StateGain(self.outputs, self.gain.L, self.gain.region)

    def made_for(self) -> str:
        """Return in words which engine and temperatures the region belongs to; the digest is of the engine's constants."""
        digest = hashlib.sha256(msgspec.json.encode(self.engine, order="sorted")).hexdigest()[:12]
        ranges = [f"{name} {low:g} to {high:g} K" for name, (low, high) in self.temperatures.items()]
        return f"a {self.air_path} engine, constants {digest}; {', '.join(ranges) or 'temperatures unknown'}"


@dataclass(frozen=True)
class _Bounds:
    """The region that a certificate covers, its bounds in one array of shape (m, 2), as the contract has it."""

    names: Annotated[tuple[str, ...], Item("1", "scheduling parameter", name="parameter")]
    rho_bounds: Annotated[Array, Item("SI", "region that the certificate covers", ("parameter", "bound"))]
    nonnegative_sums: tuple[tuple[str, str], ...]


def write_gain(path: Path, stored: StoredGain, made_by: provenance.Provenance) -> None:
    """Write a gain file, which appears whole."""
    with hdf.creating(path, KIND) as file:
        write_gain_group(file, stored)
        mapping.write(file, "provenance", made_by)


def read_gain(path: Path) -> StoredGain:
    """Return a gain from its file; raises DataError if the file is not a complete gain."""
    with hdf.reading(path, KIND, REMEDY) as file:
        return read_gain_group(file)


def write_gain_group(parent: h5py.File, stored: StoredGain) -> None:
    """Write `/gain`."""
    region, labels = stored.gain.region, {"state": stored.states, "output": (*stored.outputs, "sensor")}
    bounds = _Bounds(region.names, np.stack([region.lower, region.upper], axis=1), region.nonnegative_sums)
    mapping.write(parent, "gain", stored, labels, mapping.fields(_Bounds, bounds))


def read_gain_group(parent: h5py.File) -> StoredGain:
    """Return what `write_gain_group` wrote."""
    group = parent["gain"]
    bounds = mapping.read(group, _Bounds)
    lower, upper = map(tuple, bounds.rho_bounds.T.tolist())
    region = Region(bounds.names, lower, upper, bounds.nonnegative_sums)
    return mapping.read(group, StoredGain, gain=mapping.read(group, Gain, region=region))


def expect_engine(path: Path, stored: StoredGain, config: "Config") -> None:
    """Raise DataError unless the gain is for the configured engine and temperatures; a printed one is proven at one temperature."""
    provenance.expect_engine(path, "gain for", (stored.air_path, stored.engine), config.engine_path(), REMEDY)
    for name, (low, high) in stored.temperatures.items():
        if low < high and (low, high) != config.gain.temperatures.get(name):
            raise DataError(
                f"{path}: the gain was made for other temperatures: {name} is {low:g} to {high:g} K in the gain, but "
                f"[gain.temperatures] of the configuration has another range; {REMEDY} from this configuration"
            )
