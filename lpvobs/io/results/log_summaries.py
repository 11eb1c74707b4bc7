"""What a result keeps of each log that made it, in HDF5."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import h5py

from lpvobs.io.results.hdf import Field, number, numbers, text, write_group
from lpvobs.maps.metrics import Metrics
from lpvobs.records import Array

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


def write_log(logs: h5py.Group, metrics: h5py.Group, log: LogSummary, parameter_names: tuple[str, ...]) -> None:
    """Write a log into the groups `/logs` and, where it has references, `/metrics`."""
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


def read_log_summary(file: h5py.File, name: str, parameters: int) -> LogSummary:
    """Return what a result keeps of a log with so many scheduling parameters."""
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
