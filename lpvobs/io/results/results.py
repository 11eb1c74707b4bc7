"""Results in one HDF5 file: map, extrapolation, gain, metrics, provenance, and what is kept of the logs that made it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import fields as fields_of
from math import nan
from pathlib import Path
from typing import Annotated, Any, TypeVar

import h5py
import numpy as np

from lpvobs.engines.base import AirPath
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import DataError
from lpvobs.io.results import engines, gains, surfaces
from lpvobs.io.results.hdf import Field, changing, creating, reading, write_group
from lpvobs.io.results.mapping import Layout, fields, read, read_if_there, rows, values, write
from lpvobs.io.results.provenance import Provenance, read_refused
from lpvobs.io.safety.atomic import state_of
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import Metrics
from lpvobs.maps.quadratic import COEFFICIENTS, Filled
from lpvobs.observer import disagreement, log_run
from lpvobs.observer.balance_agreement import BalanceAgreement
from lpvobs.observer.estimate import MapEstimate, NodeMap
from lpvobs.records import Array, Item

Record = TypeVar("Record")
KIND, REMEDY = surfaces.RESULT


@dataclass(frozen=True)
class LogSummary:
    """What a result keeps of each log that made it."""

    name: str
    sha256: str
    samples: int
    samples_read: int
    dropped_rows: int
    gaps: int
    repeated: int
    duration: float  # [s]
    dropped: Mapping[str, int]  # by channel
    # among these stuck, saturated and spiked samples, by kind and channel, such as `stuck p_im`
    found: Mapping[str, int]
    share_certified: Annotated[float, Item("1", "share of samples inside the region of the certificate", gaps=True)]
    lower: Annotated[Array, Item("SI", "smallest scheduling parameters along the log", ("parameter",))]
    upper: Annotated[Array, Item("SI", "largest scheduling parameters along the log", ("parameter",))]
    # disagreement of the balances over what is to be expected of it; NaN where there is one balance
    balance_ratio: float
    mean_flow: Annotated[float, Item("kg/s", "mean of the sensor's readings", gaps=True)]
    metrics: Metrics | None  # None where the log has no references


@dataclass(frozen=True)
class StoredResult(NodeMap):
    """A result as read back; the extrapolation is None until `extrapolate` has run, `state` is what the file was then."""

    path: Path
    air_path: str
    logs: tuple[LogSummary, ...]
    gain: gains.StoredGain
    extrapolation: Filled | None
    outer_coverage: float  # how often the extrapolation is right at outer nodes; NaN where there is none
    provenance: Provenance
    balance_agreement: float = np.nan  # ratio over all logs, see `BalanceAgreement`
    headline: str = ""  # what the map says, in a sentence
    engine: engines.EngineOfMap | None = None
    state: tuple[int, ...] = ()
    refused: tuple[str, ...] = ()  # why other logs were left out


def write_result(
    path: Path,
    air_path: AirPath,
    estimate: MapEstimate,
    logs: tuple[LogSummary, ...],
    gain: gains.StoredGain,
    provenance: Provenance,
    further: Callable[[h5py.File], None] | None = None,
) -> None:
    """Write a new result, which appears whole; `further` adds groups to it before it takes its place."""
    with creating(path, KIND) as file:
        file.attrs["air_path"] = air_path.name
        file.attrs["method"] = estimate.method
        _write_map(file, estimate, {axis.channel: Item(axis.unit, axis.meaning) for axis in air_path.axes})
        gains.write_gain_group(file, gain)
        of_logs, of_metrics = file.create_group("logs"), file.create_group("metrics")
        for log in logs:
            write(of_logs, log.name, log, {"parameter": air_path.parameter_names})
            if log.metrics is not None:
                write(of_metrics, log.name, log.metrics)
        if estimate.engine is not None:
            engines.write_engine_found(file, estimate.engine)
        if estimate.along_flow is not None:
            write(file, "along_flow", estimate.along_flow)
        write(file, "provenance", provenance)
        if further is not None:
            further(file)


def update(stored: StoredResult, change: Callable[[h5py.File], None]) -> None:
    """Apply a change to a copy of a result that then takes its place; raises DataError if the file is no longer the one read."""
    refuse_replaced(stored)
    with reading(stored.path, KIND, REMEDY):
        pass
    with changing(stored.path, stored.path) as file:
        change(file)
        refuse_replaced(stored)


def refuse_replaced(stored: StoredResult) -> None:
    """Raise DataError if another program has written to a result since it was read: what was found does not belong to it now."""
    if state_of(stored.path) != stored.state:
        raise DataError(
            f"{stored.path}: another process changed this file during the run, so this run did not write to it; run this again"
        )


def read_beside(path: Path, group: str, record: type[Record]) -> Record | None:
    """Return a record that another verb has written into a result, None where none has."""
    with reading(path, KIND, REMEDY) as file:
        return read_if_there(file.get(group), record)


def read_result(path: Path) -> StoredResult:
    """Return a stored result; raises DataError if the file is not a complete result."""
    state = state_of(path)
    with reading(path, KIND, REMEDY) as file:
        if (air_path := str(file.attrs["air_path"])) not in ENGINES:
            raise DataError(
                f"{path}: the result is for an engine of kind '{air_path}', expected one of {', '.join(ENGINES)}; read the file "
                f"with the version of lpvobs that wrote it"
            )
        axes, logs, filled = surfaces.axes_of(file), file["logs"], file.get(surfaces.GROUP)
        found: dict[str, Any] = {}
        for name, layout in _layouts(axes).items():
            found |= values(file[name], layout)
        agreement = read_if_there(file.get("balance_agreement"), BalanceAgreement)
        return StoredResult(
            path=path,
            air_path=air_path,
            method=str(file.attrs["method"]),
            grid=read(file["map"], surfaces.grid_layout(axes)),
            **found,
            logs=tuple(
                read(logs[name], LogSummary, name=name, metrics=read_if_there(file["metrics"].get(name), Metrics))
                for name in logs
            ),
            gain=gains.read_gain_group(file),
            extrapolation=read_if_there(filled, surfaces.map_layout(Filled, axes)),
            outer_coverage=np.nan if filled is None else float(filled["outer_coverage"][()]),
            provenance=read(file["provenance"], Provenance),
            headline=str(file.attrs.get("headline", "")),
            balance_agreement=agreement.ratio if agreement else np.nan,
            engine=read_if_there(file.get(engines.ENGINE_FOUND), engines.EngineOfMap),
            state=state,
            refused=read_refused(file),
        )


GROUPS = {
    "map": ("theta", "standard_error", "supported"),
    "excitation": ("excitation",),
    "nodes": ("covariance", "noise", "design"),
    "sensitivity": ("constants", "sensitivity"),
}


def _layouts(axes: surfaces.Axes) -> dict[str, Layout[NodeMap]]:
    """Return how a map and what belongs to it stand in their groups."""
    whole = surfaces.map_layout(NodeMap, axes)
    return {
        name: replace(whole, items={key: whole.items[key] for key in keys}, attributes=())
        for name, keys in GROUPS.items()
    }


def _write_map(file: h5py.File, estimate: MapEstimate, axes: surfaces.Axes) -> None:
    grid, on_nodes = estimate.grid, surfaces.grid_layout(axes)
    middle = Grid(*(0.5 * (nodes[1:] + nodes[:-1]) for nodes in (grid.fuel, grid.speed)))
    of_cells = {name: replace(axis, meaning=f"{axis.meaning}, middle of the cell") for name, axis in axes.items()}
    scales = {
        "map": fields(on_nodes, grid),
        "excitation": fields(surfaces.grid_layout(of_cells), middle),
        "nodes": {},
        "sensitivity": fields(on_nodes, grid),
    }
    shown = replace(estimate, sensitivity=np.where(estimate.supported, estimate.sensitivity, np.nan))
    for name, layout in _layouts(axes).items():
        write_group(file, name, scales[name] | fields(layout, shown, {"term": COEFFICIENTS}))
    file["map"].attrs["axes"] = " ".join(axes)


def summary_of(run: log_run.LogRun, metrics: Metrics | None, balance_ratio: float = nan) -> LogSummary:
    """Return what a result keeps of a log."""
    known = {**vars(run.defects), **vars(run), "balance_ratio": balance_ratio, "metrics": metrics}
    known["found"] = {f"{item.kind} {item.channel}": item.samples for item in run.defects.findings}
    return LogSummary(**{item.name: known[item.name] for item in fields_of(LogSummary)})


def write_doubts(file: h5py.File, found: BalanceAgreement, doubts: Sequence[str], grid: Grid, reading: Array) -> None:
    """Write how far the balances agree, what speaks against logs and engine, and the mean reading of the sensor around each node.

    The reading, shape (p_2, p_1) [kg/s], is what a share of the flow is taken of.
    """
    write(file, "balance_agreement", found).attrs["doubts"] = "\n".join(doubts)
    axes = surfaces.axes_of(file)
    mean = Field(reading, Item("kg/s", "mean reading of the sensor in the cells around the node", tuple(axes)[::-1]))
    write_group(file, "readings", fields(surfaces.grid_layout(axes), grid) | {"reading": mean})


def write_agreement(file: h5py.File, scatter: float, logs: tuple[disagreement.Agreement, ...]) -> None:
    """Write how far each log's own map is from the common one."""
    between = Field(scatter, Item("kg/s", "standard deviation of a node between logs, beyond noise"))
    write_group(file, "agreement", rows(logs, "log") | {"scatter": between})
