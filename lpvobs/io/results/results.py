"""Results in one HDF5 file: map, extrapolation, gain, metrics, provenance."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.io.logs.parquet import state_of
from lpvobs.io.results.agreement import read_agreement
from lpvobs.io.results.extrapolations import read_extrapolation, write_extrapolation
from lpvobs.io.results.gains import StoredGain, read_gain_group, write_gain_group
from lpvobs.io.results.hdf import Field, changing, creating, flags, number, numbers, reading, text, texts, write_group
from lpvobs.io.results.log_summaries import LogSummary, read_log_summary, write_log
from lpvobs.io.results.provenance import Provenance, read_provenance
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, QuadraticFit
from lpvobs.observer.disagreement import Agreement
from lpvobs.observer.estimate import MapEstimate
from lpvobs.records import Array

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
    extrapolation: QuadraticFit | None
    outer_coverage: float
    provenance: Provenance
    agreement: tuple[Agreement, ...] = ()
    state: tuple[int, ...] = ()


def write_result(
    path: Path,
    air_path: str,
    axes: tuple[str, str],
    parameter_names: tuple[str, ...],
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
        file.attrs["air_path"] = air_path
        file.attrs["method"] = estimate.method
        _write_map(file, estimate, axes)
        _write_sensitivity(file, estimate, axes)
        write_gain_group(file, gain)
        groups = file.create_group("logs"), file.create_group("metrics")
        for log in logs:
            write_log(*groups, log, parameter_names)
        provenance.write(file)
        if further is not None:
            further(file)


def add_extrapolation(stored: StoredResult, fitted: QuadraticFit, outer_coverage: float) -> None:
    """Write `/extrapolation` into a result, all or nothing; `/map` stays as it is.

    `outer_coverage` is the share of outer estimated nodes that the quadratic of the others predicts within their interval.
    """
    update(stored, lambda file: write_extrapolation(file, _axis_names(file), fitted, outer_coverage))


def update(stored: StoredResult, change: Callable[[h5py.File], None]) -> None:
    """Apply a change to a copy of a result that then takes its place.

    Raises
    ------
    DataError
        If the file is no longer the one that was read.
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
    """Return a stored result.

    Raises
    ------
    DataError
        If the file is not a complete result.
    """
    state = state_of(path)
    with reading(path, KIND, REMEDY) as file:
        fuel, speed = _axis_names(file)
        stored = file["map"]
        grid = Grid(*(numbers(stored, name, stored[name].size) for name in (fuel, speed)))
        parameter_names = tuple(file["logs"].attrs["parameter_names"].split()) if file["logs"].keys() else ()
        constants = texts(file["sensitivity"], "constant")
        p_2, p_1 = grid.shape
        return StoredResult(
            path=path,
            air_path=str(file.attrs["air_path"]),
            method=str(file.attrs["method"]),
            grid=grid,
            theta=numbers(stored, "delta_W_c", p_2, p_1),
            standard_error=numbers(stored, "standard_error", p_2, p_1),
            covariance=numbers(file["nodes"], "covariance", grid.size, grid.size),
            noise=numbers(file["nodes"], "noise", grid.size, grid.size),
            design=numbers(file["nodes"], "design", grid.size, len(COEFFICIENTS)),
            supported=numbers(stored, "support", p_2, p_1) == 1,
            excitation=numbers(file["excitation"], "delta_1", p_2 - 1, p_1 - 1),
            constants=constants,
            sensitivity=numbers(file["sensitivity"], "delta_W_c", len(constants), p_2, p_1),
            parameter_names=parameter_names,
            logs=tuple(read_log_summary(file, name, len(parameter_names)) for name in file["logs"]),
            gain=read_gain_group(file),
            extrapolation=read_extrapolation(file, grid),
            outer_coverage=number(file["extrapolation"], "outer_coverage") if "extrapolation" in file else math.nan,
            provenance=read_provenance(file),
            agreement=read_agreement(file),
            state=state,
        )


def _axis_names(file: h5py.File) -> tuple[str, str]:
    """Return the names of the fuel and the speed axis."""
    fuel, speed = str(file["map"].attrs["axes"]).split()
    return fuel, speed


def _write_map(file: h5py.File, estimate: MapEstimate, axes: tuple[str, str]) -> None:
    fuel, speed = axes
    grid = estimate.grid
    units = {"u_delta": "mg/cycle", "m_f": "1"}
    both = (speed, fuel)
    nodes = {
        speed: Field(grid.speed, "rpm", "engine speed"),
        fuel: Field(grid.fuel, units[fuel], "injected fuel"),
    }
    support = np.where(estimate.supported, 1, 0).astype(np.int8)
    group = write_group(
        file,
        "map",
        nodes
        | {
            "delta_W_c": Field(estimate.theta, "kg/s", "error of the mass air flow sensor, reading minus truth", both),
            "standard_error": Field(estimate.standard_error, "kg/s", "standard error of delta_W_c", both),
            "support": Field(support, "1", "where the value comes from", both, flags([0, 1], ["none", "estimated"])),
        },
    )
    group.attrs["axes"] = f"{fuel} {speed}"
    middle = {name: 0.5 * (field.values[1:] + field.values[:-1]) for name, field in nodes.items()}
    write_group(
        file,
        "excitation",
        {
            name: Field(middle[name], field.units, f"{field.long_name}, middle of the cell")
            for name, field in nodes.items()
        }
        | {
            "delta_1": Field(
                estimate.excitation, "s", "persistency of excitation of the cell, delta_1 of Eq. (29)", both
            )
        },
    )
    order = np.arange(grid.size, dtype=np.int32)
    write_group(
        file,
        "nodes",
        {
            "node": Field(order, "1", "node in the order of Eq. (23): n_e block by n_e block"),
            "other_node": Field(order, "1", "the same"),
            "term": Field(text(COEFFICIENTS), "1", "term of Eq. (37), in coordinates from -1 to 1 over the grid"),
            "covariance": Field(estimate.covariance, "kg^2/s^2", "covariance of the nodes", ("node", "other_node")),
            "noise": Field(
                estimate.noise, "kg^2/s^2", "part of it that no engine constant explains", ("node", "other_node")
            ),
            "design": Field(estimate.design, "1", "node values that stand for each term", ("node", "term")),
        },
    )


def _write_sensitivity(file: h5py.File, estimate: MapEstimate, axes: tuple[str, str]) -> None:
    fuel, speed = axes
    nodes = {name: Field(file["map"][name][()], file["map"][name].attrs["units"], name) for name in axes}
    write_group(
        file,
        "sensitivity",
        nodes
        | {
            "constant": Field(text(estimate.constants), "1", "uncertain constant of the engine"),
            "delta_W_c": Field(
                np.where(estimate.supported, estimate.sensitivity, np.nan),
                "kg/s",
                "change of the map per relative error of the constant",
                ("constant", speed, fuel),
            ),
        },
    )
