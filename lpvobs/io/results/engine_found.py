"""`/engine_found`: what the logs of a map say of the engine: its constants, and the corrections of its components."""

from dataclasses import dataclass
from typing import Annotated

import h5py
import numpy as np

from lpvobs.engines.base import AirPath
from lpvobs.engines.unknowns import Unknowns
from lpvobs.io.results.engines import read_unknowns, write_corrections, write_unknowns
from lpvobs.io.results.mapping import read, write
from lpvobs.observer.estimate import EngineFound
from lpvobs.records import Array, Item

GROUP, BEFORE = "engine_found", "engine_before"


@dataclass(frozen=True, eq=False)
class EngineOfMap:
    """The engine that a map goes with."""

    constants: Annotated[tuple[str, ...], Item("1", "uncertain constant of the engine", name="constant")]
    deviation: Annotated[
        Array, Item("1", "from the configured value; of a mode, from the calibrated one", ("constant",))
    ]
    covariance: Annotated[Array, Item("1", "covariance of the deviations", ("constant", "other_constant"))]
    groups: Annotated[tuple[str, ...], Item("1", "components whose corrections share an amplitude", name="group")]
    amplitudes: Annotated[
        tuple[float, ...], Item("1", "of these, over what is expected before any data", ("group",), "amplitude")
    ]


def stored_engine(found: EngineFound) -> EngineOfMap:
    """Return what a result keeps of the constants; their deviations are seen from the configured values."""
    unknowns, q = found.unknowns, len(found.unknowns.constants)
    seen_from = np.array([1.0 + found.point.get(name, 0.0) for name in unknowns.coordinates])
    deviation = unknowns.reduction.T @ (found.mean - unknowns.mean)
    deviation[:q] = list(found.deviation().values())
    return EngineOfMap(
        constants=unknowns.coordinates,
        deviation=deviation,
        covariance=unknowns.reduced(found.covariance) * np.outer(seen_from, seen_from),
        groups=unknowns.groups(),
        amplitudes=found.amplitudes,
    )


def write_engine_found(file: h5py.File, found: EngineFound) -> None:
    """Write constants, and every component's correction over its own axes, into a result that has none.

    Of a calibrated engine, what the calibration knew is written beside it.
    """
    if found.unknowns.learned:
        write_unknowns(file, BEFORE, found.before())
    group = write(file, GROUP, stored_engine(found))
    errors = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))  # of what is known exactly, rounding is left
    write_corrections(group, found.unknowns, found.mean, errors)


def read_engine_found(file: h5py.File) -> EngineOfMap | None:
    """Return what an open result says of its engine's constants, None where the method does not tell."""
    return read(file[GROUP], EngineOfMap) if GROUP in file else None


def read_engine_before(file: h5py.File, air_path: AirPath) -> Unknowns | None:
    """Return what was known of the engine before an open result's logs, None where that is the configuration alone."""
    return read_unknowns(file[BEFORE], air_path) if BEFORE in file else None
