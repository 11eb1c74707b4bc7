"""A gain with its certificate, in a file of its own and inside every result that it made."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import msgspec
import numpy as np

from lpvobs.errors import DataError
from lpvobs.io.configuration.config import Config
from lpvobs.io.results.hdf import creating, reading, write_group
from lpvobs.io.results.mapping import ENDS, Item, Layout, fields, read, read_rows, rows, values
from lpvobs.io.results.provenance import Provenance
from lpvobs.records import Array
from lpvobs.synthesis.certificate import Certificate
from lpvobs.synthesis.gain import Gain
from lpvobs.synthesis.region import Region

KIND = "gain"
REMEDY = "make it with `lpvobs synth-gain`"
Range = tuple[float, float]


@dataclass(frozen=True)
class StoredGain:
    """A gain, whose engine it is for, and which logs its region was drawn from.

    Attributes
    ----------
    origin : str
        `synthesised`, or where a published gain was printed.
    engine : mapping of str to float
        The engine's constants.
    states, outputs : tuple of str
        The measured states among the outputs; the sensor comes after them.
    log_bounds : mapping of str to ndarray, shape (2, m)
        Smallest and largest scheduling parameters of each log.
    temperatures : mapping of str to tuple of float
        [K], ranges that the region was made for.
    """

    origin: str
    air_path: str
    engine: Mapping[str, float]
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    gain: Gain
    log_bounds: Mapping[str, Array]
    temperatures: Mapping[str, Range] = field(default_factory=dict)

    def made_for(self) -> str:
        """Return in words which engine and temperatures the region belongs to; the digest is of the engine's constants."""
        digest = hashlib.sha256(msgspec.json.encode(self.engine, order="sorted")).hexdigest()[:12]
        ranges = [f"{name} {low:g} to {high:g} K" for name, (low, high) in self.temperatures.items()]
        return f"a {self.air_path} engine, constants {digest}; {', '.join(ranges) or 'temperatures unknown'}"


@dataclass(frozen=True)
class _Bounds:
    """The region that a certificate covers, its bounds in one array of shape (m, 2), as the contract has it."""

    names: tuple[str, ...]
    rho_bounds: Array
    nonnegative_sums: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class _LogBounds:
    log: str
    log_bounds: Array


STORED = Layout(
    StoredGain,
    {"state": Item("1", "state", of="states")},
    attributes=("origin", "air_path", "engine", "outputs", "temperatures"),
)
GAIN = Layout(
    Gain,
    {
        "L": Item("SI", "observer gain of Eq. (26), state unit per output unit and second", ("state", "output")),
        "P": Item("SI", "Lyapunov matrix of Theorem 1", ("state", "other_state")),
        "Q": Item("SI", "matrix Q of Theorem 1", ("state", "other_state")),
        "eps_1": Item("1", "eps_1 of Theorem 1"),
        "eps_2": Item("1", "eps_2 of Theorem 1"),
    },
    {"other_state": "state", "output": "output"},
)
REGION = Layout(
    _Bounds,
    {
        "parameter": Item("1", "scheduling parameter", of="names"),
        "rho_bounds": Item("SI", "region that the certificate covers", ("parameter", "bound")),
    },
    {"bound": ENDS},
    ("nonnegative_sums",),
)
LOG_BOUNDS = Layout(
    _LogBounds,
    {
        "log": Item("1", "log that the region was drawn from"),
        "log_bounds": Item("SI", "smallest and largest scheduling parameters of the log", ("bound", "parameter")),
    },
    row="log",
)
CERTIFICATE = Layout(
    Certificate,
    {
        "proven": Item("1", "Theorem 1 proven"),
        "falling_gain": Item("1", "1 - eps_1 - eps_2 > 0 proven, too"),
        "vertices": Item("1", "vertices of the region"),
        "smallest_pivot": Item("1", "smallest relative pivot", gaps=True),
    },
)


def write_gain(path: Path, stored: StoredGain, provenance: Provenance) -> None:
    """Write a gain file; at any instant the target is absent, the old file, or the complete new one."""
    with creating(path) as file:
        file.attrs["schema"] = f"lpvobs/{KIND}/1"
        write_gain_group(file, stored)
        provenance.write(file)


def read_gain(path: Path) -> StoredGain:
    """Return a gain from its file; raises DataError if the file is not a complete gain."""
    with reading(path, KIND, REMEDY) as file:
        return read_gain_group(file)


def write_gain_group(parent: h5py.File, stored: StoredGain) -> None:
    """Write `/gain`."""
    gain, region = stored.gain, stored.gain.region
    bounds = _Bounds(region.names, np.stack([region.lower, region.upper], axis=1), region.nonnegative_sums)
    group = write_group(
        parent,
        "gain",
        fields(STORED, stored)
        | fields(GAIN, gain, {"other_state": stored.states, "output": (*stored.outputs, "sensor")})
        | fields(REGION, bounds)
        | rows(LOG_BOUNDS, [_LogBounds(*item) for item in stored.log_bounds.items()]),
    )
    write_group(group, "certificate", fields(CERTIFICATE, gain.certificate))


def read_gain_group(parent: h5py.File) -> StoredGain:
    """Return what `write_gain_group` wrote."""
    group = parent["gain"]
    bounds = read(group, REGION)
    lower, upper = bounds.rho_bounds.T.tolist()
    certificate = values(group["certificate"], CERTIFICATE)
    reason = "" if certificate["proven"] else "not proven when it was written"
    gain = read(
        group,
        GAIN,
        region=Region(bounds.names, tuple(lower), tuple(upper), bounds.nonnegative_sums),
        certificate=Certificate(**certificate, failed_vertex=None, reason=reason),
    )
    logs = {item.log: item.log_bounds for item in read_rows(group, LOG_BOUNDS)}
    return read(group, STORED, gain=gain, log_bounds=logs)


def expect_engine(path: Path, stored: StoredGain, config: Config) -> None:
    """Raise DataError unless the gain is for the configured engine and temperatures; a printed one is proven at one temperature."""
    if stored.air_path != config.air_path:
        raise DataError(
            f"{path}: gain for air path '{stored.air_path}', the configuration has '{config.air_path}'; {REMEDY} again"
        )
    for name, value in config.engine_path().engine_constants().items():
        if stored.engine.get(name) != value:
            raise DataError(
                f"{path}: gain for another engine: {name} is {stored.engine.get(name)} there and {value:g} in the configuration; "
                f"{REMEDY} from this configuration"
            )
    for name, (low, high) in stored.temperatures.items():
        if low < high and (low, high) != config.gain.temperatures.get(name):
            raise DataError(
                f"{path}: gain for other temperatures: {name} is {low:g} to {high:g} K there and not in [gain.temperatures] of the "
                f"configuration; {REMEDY} from this configuration"
            )
