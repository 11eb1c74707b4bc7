"""A gain with its certificate, in a file of its own and inside every result that it made."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from lpvobs.errors import DataError
from lpvobs.io.results.hdf import Field, creating, flags, number, numbers, reading, text, texts, write_group
from lpvobs.io.results.provenance import Provenance
from lpvobs.records import Array
from lpvobs.synthesis.certificate import Certificate
from lpvobs.synthesis.gain import Gain
from lpvobs.synthesis.region import Region

KIND = "gain"
REMEDY = "make it with `lpvobs synth-gain`"


@dataclass(frozen=True)
class StoredGain:
    """A gain, whose engine it is for, and which logs its region was drawn from.

    Attributes
    ----------
    origin : str
        `synthesised`, or where a published gain was printed.
    air_path : str
    engine : mapping of str to float
        The engine's constants.
    states, outputs : tuple of str
        The measured states among the outputs; the sensor comes after them.
    gain : Gain
    log_bounds : mapping of str to ndarray, shape (2, m)
        Smallest and largest scheduling parameters of each log.
    """

    origin: str
    air_path: str
    engine: Mapping[str, float]
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    gain: Gain
    log_bounds: Mapping[str, Array]


def write_gain(path: Path, stored: StoredGain, provenance: Provenance) -> None:
    """Write a gain file; at any instant the target is absent, the old file, or the complete new one."""
    with creating(path) as file:
        file.attrs["schema"] = f"lpvobs/{KIND}/1"
        write_gain_group(file, stored)
        provenance.write(file)


def read_gain(path: Path) -> StoredGain:
    """Return a gain from its file.

    Raises
    ------
    DataError
        If the file is not a complete gain.
    """
    with reading(path, KIND, REMEDY) as file:
        return read_gain_group(file)


def write_gain_group(parent: h5py.File, stored: StoredGain) -> None:
    """Write `/gain`."""
    gain, region = stored.gain, stored.gain.region
    sensor_row = (*stored.outputs, "sensor")
    group = write_group(
        parent,
        "gain",
        {
            "state": Field(text(stored.states), "1", "state"),
            "other_state": Field(text(stored.states), "1", "state"),
            "output": Field(text(sensor_row), "1", "output"),
            "parameter": Field(text(region.names), "1", "scheduling parameter"),
            "bound": Field(np.array([0, 1], dtype=np.int8), "1", "which bound", (), flags([0, 1], ["lower", "upper"])),
            "L": Field(
                gain.L, "SI", "observer gain of Eq. (26), state unit per output unit and second", ("state", "output")
            ),
            "P": Field(gain.P, "SI", "Lyapunov matrix of Theorem 1", ("state", "other_state")),
            "Q": Field(gain.Q, "SI", "matrix Q of Theorem 1", ("state", "other_state")),
            "eps_1": Field(gain.eps_1, "1", "eps_1 of Theorem 1"),
            "eps_2": Field(gain.eps_2, "1", "eps_2 of Theorem 1"),
            "rho_bounds": Field(
                np.stack([region.lower, region.upper], axis=1),
                "SI",
                "region that the certificate covers",
                ("parameter", "bound"),
            ),
        },
    )
    group.attrs["origin"] = stored.origin
    group.attrs["air_path"] = stored.air_path
    group.attrs["engine"] = json.dumps(dict(stored.engine))
    group.attrs["outputs"] = " ".join(stored.outputs)
    group.attrs["nonnegative_sums"] = " ".join("+".join(pair) for pair in region.nonnegative_sums)
    certificate = gain.certificate
    write_group(
        group,
        "certificate",
        {
            "proven": Field(np.int8(certificate.proven), "1", "Theorem 1 proven", (), flags([0, 1], ["no", "yes"])),
            "falling_gain": Field(
                np.int8(certificate.falling_gain),
                "1",
                "1 - eps_1 - eps_2 > 0 proven, too",
                (),
                flags([0, 1], ["no", "yes"]),
            ),
            "vertices": Field(certificate.vertices, "1", "vertices of the region"),
            "smallest_pivot": Field(certificate.smallest_pivot, "1", "smallest relative pivot"),
        },
    )
    bounds = group.create_group("log_bounds")
    for name, values in stored.log_bounds.items():
        dataset = bounds.create_dataset(name, data=values)
        dataset.attrs["units"] = "SI"
        dataset.attrs["long_name"] = "smallest and largest scheduling parameters of the log"
        for dimension, axis in enumerate(("bound", "parameter")):
            dataset.dims[dimension].attach_scale(group[axis])


def read_gain_group(parent: h5py.File) -> StoredGain:
    """Return what `write_gain_group` wrote."""
    group = parent["gain"]
    names, states = texts(group, "parameter"), texts(group, "state")
    outputs = tuple(str(group.attrs["outputs"]).split())
    bounds = numbers(group, "rho_bounds", len(names), 2)
    pairs = [pair.split("+") for pair in str(group.attrs["nonnegative_sums"]).split()]
    region = Region(
        names,
        tuple(bounds[:, 0].tolist()),
        tuple(bounds[:, 1].tolist()),
        tuple((first, second) for first, second in pairs),
    )
    stored = group["certificate"]
    proven = number(stored, "proven") == 1
    certificate = Certificate(
        proven=proven,
        vertices=int(number(stored, "vertices")),
        smallest_pivot=number(stored, "smallest_pivot"),
        failed_vertex=None,
        falling_gain=number(stored, "falling_gain") == 1,
        reason="" if proven else "not proven when it was written",
    )
    n = len(states)
    gain = Gain(
        numbers(group, "L", n, len(outputs) + 1),
        numbers(group, "P", n, n),
        numbers(group, "Q", n, n),
        number(group, "eps_1"),
        number(group, "eps_2"),
        region,
        certificate,
    )
    engine = json.loads(group.attrs["engine"])
    if not isinstance(engine, dict):
        raise ValueError("'engine' is no table of constants")
    return StoredGain(
        origin=str(group.attrs["origin"]),
        air_path=str(group.attrs["air_path"]),
        engine=engine,
        states=states,
        outputs=outputs,
        gain=gain,
        log_bounds={name: numbers(group["log_bounds"], name, 2, len(names)) for name in group["log_bounds"]},
    )


def expect_engine(path: Path, stored: StoredGain, air_path: str, engine: Mapping[str, float]) -> None:
    """Raise DataError unless the gain was made for this engine."""
    if stored.air_path != air_path:
        raise DataError(
            f"{path}: gain for air path '{stored.air_path}', the configuration has '{air_path}'; {REMEDY} again"
        )
    for name, value in engine.items():
        if stored.engine.get(name) != value:
            raise DataError(
                f"{path}: gain for another engine: {name} is {stored.engine.get(name)} there and {value:g} in the configuration; "
                f"{REMEDY} from this configuration"
            )
