"""Results in one HDF5 file: map, extrapolation, gain, metrics, provenance."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.io.agreement import read_agreement
from lpvobs.io.gains import StoredGain, read_gain_group, write_gain_group
from lpvobs.io.hdf import Field, changing, creating, flags, number, numbers, reading, text, texts, write_group
from lpvobs.io.parquet import state_of
from lpvobs.io.provenance import Provenance, read_provenance
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import Metrics
from lpvobs.maps.quadratic import COEFFICIENTS, QuadraticFit
from lpvobs.observer.disagreement import Agreement
from lpvobs.observer.estimate import MapEstimate
from lpvobs.records import Array

KIND = "result"
REMEDY = "make it with `lpvobs estimate`"

METRIC_UNITS = {
    "samples": ("1", "samples compared with the reference"),
    "mean_relative_error": ("1", "mean of |estimate - reference| / |reference|"),
    "share_left_out": (
        "1",
        "share of samples left out of the mean relative error: |reference| under 1 % of its maximum",
    ),
    "rms_ratio": ("1", "rms of the error / rms of the reference"),
    "rmse": ("kg/s", "rms of estimate - reference"),
    "bias": ("kg/s", "mean of estimate - reference"),
    "visited_cells": ("1", "cells of the grid with a compared sample"),
    "floor_mean_relative_error": ("1", "mean relative error of the best bilinear fit to the reference"),
    "floor_rms_ratio": ("1", "rms ratio of the best bilinear fit to the reference"),
}


@dataclass(frozen=True)
class LogSummary:
    """What a result keeps of each log that made it.

    Attributes
    ----------
    name, sha256 : str
    samples, samples_read, dropped_rows, gaps, repeated : int
    duration : float
        [s]
    dropped : mapping of str to int
        By channel.
    found : mapping of str to int
        Samples that are stuck, saturated or spiked, by kind and channel, such as `stuck p_im`; they are among the dropped.
    share_certified : float
        Share of the samples inside the region that the gain's certificate covers.
    lower, upper : ndarray, shape (m,)
        Range of the scheduling parameters along the log.
    metrics : Metrics or None
        None where the log has no references.
    """

    name: str
    sha256: str
    samples: int
    samples_read: int
    dropped_rows: int
    gaps: int
    repeated: int
    duration: float
    dropped: Mapping[str, int]
    found: Mapping[str, int]
    share_certified: float
    lower: Array
    upper: Array
    metrics: Metrics | None


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
            _write_log(*groups, log, parameter_names)
        provenance.write(file)
        if further is not None:
            further(file)


def add_extrapolation(stored: StoredResult, fitted: QuadraticFit, outer_coverage: float) -> None:
    """Write `/extrapolation` into a result, all or nothing; `/map` stays as it is.

    `outer_coverage` is the share of outer estimated nodes that the quadratic of the others predicts within their interval.
    """

    def change(file: h5py.File) -> None:
        if "extrapolation" in file:
            del file["extrapolation"]
        axes = _axis_names(file)
        nodes = {
            name: Field(file["map"][name][()], file["map"][name].attrs["units"], file["map"][name].attrs["long_name"])
            for name in axes
        }
        fuel, speed = (nodes[name].units for name in axes)
        units = (
            f"kg/s/({fuel})^2",
            f"kg/s/({fuel})",
            f"kg/s/({speed})^2",
            f"kg/s/({speed})",
            f"kg/s/({fuel})/({speed})",
            "kg/s",
        )
        units_of_each = {"coefficient_units": text(units)}
        write_group(
            file,
            "extrapolation",
            nodes
            | {
                "coefficient": Field(text(COEFFICIENTS), "1", "coefficient of Eq. (37)"),
                "coefficients": Field(
                    fitted.coefficients,
                    "1",
                    "coefficients of Eq. (37), units in coefficient_units",
                    ("coefficient",),
                    units_of_each,
                ),
                "coefficients_standard_error": Field(
                    fitted.standard_error, "1", "standard errors of the coefficients", ("coefficient",), units_of_each
                ),
                "delta_W_c": Field(fitted.delta_W_c, "kg/s", "sensor error, every node filled", axes[::-1]),
                "standard_error": Field(
                    fitted.map_standard_error, "kg/s", "standard error; of prediction where extrapolated", axes[::-1]
                ),
                "support": Field(
                    fitted.support,
                    "1",
                    "where the value comes from",
                    axes[::-1],
                    flags([1, 2], ["estimated", "extrapolated"]),
                ),
                "lack_of_fit": Field(
                    fitted.lack_of_fit, "kg/s", "standard deviation of the surface around the quadratic"
                ),
                "nodes": Field(fitted.nodes, "1", "nodes that the quadratic was fitted to"),
                "outer_coverage": Field(
                    outer_coverage,
                    "1",
                    "share of outer estimated nodes inside their 90 % interval when fitted without them",
                ),
            },
        )

    update(stored, change)


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
            logs=tuple(_read_log(file, name, len(parameter_names)) for name in file["logs"]),
            gain=read_gain_group(file),
            extrapolation=_read_extrapolation(file, grid),
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
        speed: Field(grid.n_e, "rpm", "engine speed"),
        fuel: Field(grid.u_delta, units[fuel], "injected fuel"),
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


def _write_log(logs: h5py.Group, metrics: h5py.Group, log: LogSummary, parameter_names: tuple[str, ...]) -> None:
    logs.attrs["parameter_names"] = " ".join(parameter_names)
    group = write_group(
        logs,
        log.name,
        {
            "parameter": Field(text(parameter_names), "1", "scheduling parameter"),
            "lower": Field(log.lower, "SI", "smallest scheduling parameters along the log", ("parameter",)),
            "upper": Field(log.upper, "SI", "largest scheduling parameters along the log", ("parameter",)),
            "share_certified": Field(log.share_certified, "1", "share of samples inside the region of the certificate"),
        },
    )
    for name in ("sha256", "samples", "samples_read", "dropped_rows", "gaps", "repeated", "duration"):
        group.attrs[name] = getattr(log, name)
    for channel, count in log.dropped.items():
        group.attrs[f"dropped_{channel}"] = count
    for finding, count in log.found.items():
        group.attrs[f"found_{finding}"] = count
    if log.metrics is not None:
        write_group(
            metrics, log.name, {name: Field(value, *METRIC_UNITS[name]) for name, value in asdict(log.metrics).items()}
        )


def _read_log(file: h5py.File, name: str, parameters: int) -> LogSummary:
    group = file["logs"][name]
    attributes = dict(group.attrs)
    metrics = None
    if name in file["metrics"]:
        stored = file["metrics"][name]
        values: dict[str, Any] = {key: number(stored, key) for key in METRIC_UNITS}
        metrics = Metrics(**{**values, **{key: int(values[key]) for key in ("samples", "visited_cells")}})
    return LogSummary(
        name=name,
        sha256=str(attributes["sha256"]),
        **{key: int(attributes[key]) for key in ("samples", "samples_read", "dropped_rows", "gaps", "repeated")},
        duration=float(attributes["duration"]),
        dropped={
            key.removeprefix("dropped_"): int(value)
            for key, value in attributes.items()
            if key.startswith("dropped_") and key != "dropped_rows"
        },
        found={key.removeprefix("found_"): int(value) for key, value in attributes.items() if key.startswith("found_")},
        share_certified=number(group, "share_certified"),
        lower=numbers(group, "lower", parameters),
        upper=numbers(group, "upper", parameters),
        metrics=metrics,
    )


def _read_extrapolation(file: h5py.File, grid: Grid) -> QuadraticFit | None:
    if "extrapolation" not in file:
        return None
    group = file["extrapolation"]
    return QuadraticFit(
        coefficients=numbers(group, "coefficients", len(COEFFICIENTS)),
        standard_error=numbers(group, "coefficients_standard_error", len(COEFFICIENTS)),
        lack_of_fit=number(group, "lack_of_fit"),
        nodes=int(number(group, "nodes")),
        delta_W_c=numbers(group, "delta_W_c", *grid.shape),
        map_standard_error=numbers(group, "standard_error", *grid.shape),
        support=numbers(group, "support", *grid.shape).astype(np.int8),
    )
