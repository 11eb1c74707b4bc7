"""Results in one HDF5 file: map, extrapolation, gain, metrics, provenance."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.base import AirPath
from lpvobs.errors import DataError
from lpvobs.io.results.engines import ENGINE_FOUND, EngineOfMap, write_engine_found
from lpvobs.io.results.extrapolations import LONG_NAME, ORIGIN, Axes, axes_of, grid_layout, read_extrapolation
from lpvobs.io.results.gains import StoredGain, read_gain_group, write_gain_group
from lpvobs.io.results.hdf import changing, creating, reading, write_group
from lpvobs.io.results.log_summaries import LogSummary, write_log
from lpvobs.io.results.mapping import Layout, fields, read, read_if_there, read_rows, values
from lpvobs.io.results.provenance import Provenance, read_provenance, read_refused
from lpvobs.io.safety.atomic import state_of
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import Metrics
from lpvobs.maps.quadratic import COEFFICIENTS, Filled
from lpvobs.observer.balance_agreement import BalanceAgreement
from lpvobs.observer.disagreement import Agreement
from lpvobs.observer.estimate import MapEstimate
from lpvobs.records import Array, Item

KIND = "result"
REMEDY = "make it with `lpvobs estimate`"


@dataclass(frozen=True)
class StoredResult:
    """A result as read back; the extrapolation is None until `extrapolate` has run, `state` is what the file was then."""

    path: Path
    air_path: str
    method: str
    grid: Grid
    theta: Array
    standard_error: Array
    covariance: Array
    noise: Array
    design: Array
    supported: NDArray[np.bool_]
    excitation: Array
    constants: tuple[str, ...]
    sensitivity: Array
    parameter_names: tuple[str, ...]
    logs: tuple[LogSummary, ...]
    gain: StoredGain
    extrapolation: Filled | None
    outer_coverage: float
    provenance: Provenance
    agreement: tuple[Agreement, ...] = ()
    balance_agreement: float = np.nan  # ratio over all logs, see `BalanceAgreement`
    engine: EngineOfMap | None = None
    state: tuple[int, ...] = ()
    refused: tuple[str, ...] = ()  # why other logs were left out


def write_result(
    path: Path,
    air_path: AirPath,
    estimate: MapEstimate,
    logs: tuple[LogSummary, ...],
    gain: StoredGain,
    provenance: Provenance,
    further: Callable[[h5py.File], None] | None = None,
) -> None:
    """Write a new result; at any instant the target is absent, the old file, or the complete new one.

    `further` adds groups to it before it takes its place.
    """
    with creating(path) as file:
        file.attrs["schema"] = f"lpvobs/{KIND}/1"
        file.attrs["air_path"] = air_path.name
        file.attrs["method"] = estimate.method
        _write_map(file, estimate, {axis.channel: Item(axis.unit, axis.meaning) for axis in air_path.axes})
        write_gain_group(file, gain)
        groups = file.create_group("logs"), file.create_group("metrics")
        for log in logs:
            write_log(*groups, log, air_path.parameter_names)
        if estimate.engine is not None:
            write_engine_found(file, estimate.engine)
        provenance.write(file)
        if further is not None:
            further(file)


def update(stored: StoredResult, change: Callable[[h5py.File], None]) -> None:
    """Apply a change to a copy of a result that then takes its place.

    Raises DataError if the file is no longer the one that was read.
    """
    refuse_replaced(stored)
    with reading(stored.path, KIND, REMEDY):
        pass
    with changing(stored.path, stored.path) as file:
        change(file)
        refuse_replaced(stored)


def refuse_replaced(stored: StoredResult) -> None:
    """Raise DataError if a result has been written to since it was read: what was found does not belong to what is there now.

    Claims keep this program's other verbs away, but not other programs.
    """
    if state_of(stored.path) != stored.state:
        raise DataError(
            f"{stored.path}: was replaced while this verb worked on the result of before; it stays as it is now; run the verb again"
        )


def read_result(path: Path) -> StoredResult:
    """Return a stored result; raises DataError if the file is not a complete result."""
    state = state_of(path)
    with reading(path, KIND, REMEDY) as file:
        axes = axes_of(file)
        found: dict[str, Any] = {}
        for name, layout in _layouts(*axes).items():
            found |= values(file[name], layout)
        logs = file["logs"]
        found_agreement = read_if_there(file.get("balance_agreement"), BalanceAgreement)
        extrapolation, outer_coverage = read_extrapolation(file, axes)
        return StoredResult(
            path=path,
            air_path=str(file.attrs["air_path"]),
            method=str(file.attrs["method"]),
            grid=read(file["map"], grid_layout(axes)),
            **found,
            **next((values(logs[name], PARAMETERS) for name in logs), {"parameter_names": ()}),
            logs=tuple(
                read(logs[name], LogSummary, name=name, metrics=read_if_there(file["metrics"].get(name), Metrics))
                for name in logs
            ),
            gain=read_gain_group(file),
            extrapolation=extrapolation,
            outer_coverage=outer_coverage,
            provenance=read_provenance(file),
            balance_agreement=found_agreement.ratio if found_agreement else np.nan,
            agreement=read_rows(file.get("agreement"), Agreement, "log"),
            engine=read_if_there(file.get(ENGINE_FOUND), EngineOfMap),
            state=state,
            refused=read_refused(file),
        )


PARAMETERS = Layout(StoredResult, {"parameter_names": Item("1", "scheduling parameter", name="parameter")})


def _layouts(fuel: str, speed: str) -> dict[str, Layout[StoredResult]]:
    """Return how a map and what belongs to it stand in their groups."""
    both, square = (speed, fuel), ("node", "other_node")
    per_constant = "change of the map per relative error of the constant"
    groups = {
        "map": {
            "theta": Item("kg/s", LONG_NAME, both, "delta_W_c", gaps=True),
            "standard_error": Item("kg/s", "standard error of delta_W_c", both, gaps=True),
            "supported": Item("1", ORIGIN, both, "support", meanings={0: "none", 1: "estimated"}),
        },
        "excitation": {
            "excitation": Item("s", "persistency of excitation of the cell, delta_1 of Eq. (29)", both, "delta_1")
        },
        "nodes": {
            "covariance": Item("kg^2/s^2", "covariance of the nodes; NaN where the method has none", square, gaps=True),
            "noise": Item("kg^2/s^2", "part of it that no engine constant explains", square, gaps=True),
            "design": Item("1", "node values that stand for each term", ("node", "term")),
        },
        "sensitivity": {
            "constants": Item("1", "uncertain constant of the engine", name="constant"),
            "sensitivity": Item("kg/s", per_constant, ("constant", *both), "delta_W_c", gaps=True),
        },
    }
    return {name: Layout(StoredResult, items) for name, items in groups.items()}


def _write_map(file: h5py.File, estimate: MapEstimate, axes: Axes) -> None:
    grid, on_nodes = estimate.grid, grid_layout(axes)
    middle = Grid(*(0.5 * (nodes[1:] + nodes[:-1]) for nodes in (grid.fuel, grid.speed)))
    of_cells = {name: replace(axis, meaning=f"{axis.meaning}, middle of the cell") for name, axis in axes.items()}
    scales = {
        "map": fields(on_nodes, grid),
        "excitation": fields(grid_layout(of_cells), middle),
        "nodes": {},
        "sensitivity": fields(on_nodes, grid),
    }
    shown = replace(estimate, sensitivity=np.where(estimate.supported, estimate.sensitivity, np.nan))
    for name, layout in _layouts(*axes).items():
        write_group(file, name, scales[name] | fields(layout, shown, {"term": COEFFICIENTS}))
    file["map"].attrs["axes"] = " ".join(axes)
