"""What a result keeps of each log that made it, in HDF5."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan

import h5py

from lpvobs.io.results.hdf import write_group
from lpvobs.io.results.mapping import Item, Layout, fields, read
from lpvobs.maps.metrics import Metrics
from lpvobs.observer.log_run import LogRun
from lpvobs.records import Array

METRICS = Layout(
    Metrics,
    {
        "samples": Item("1", "samples compared with the reference"),
        "mean_relative_error": Item("1", "mean of |estimate - reference| / |reference|", gaps=True),
        "share_left_out": Item(
            "1", "share of samples left out of the mean relative error: |reference| under 1 % of its maximum", gaps=True
        ),
        "rms_ratio": Item("1", "rms of the error / rms of the reference", gaps=True),
        "rmse": Item("kg/s", "rms of estimate - reference", gaps=True),
        "bias": Item("kg/s", "mean of estimate - reference", gaps=True),
        "visited_cells": Item("1", "cells of the grid with a compared sample"),
        "floor_mean_relative_error": Item(
            "1", "mean relative error of the best bilinear fit to the reference", gaps=True
        ),
        "floor_rms_ratio": Item("1", "rms ratio of the best bilinear fit to the reference", gaps=True),
    },
)


@dataclass(frozen=True)
class LogSummary:
    """What a result keeps of each log that made it.

    Attributes
    ----------
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
    balance_ratio : float
        Disagreement of the balances over what is to be expected of it; NaN where there is one balance.
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
    balance_ratio: float
    metrics: Metrics | None


def summary_of(run: LogRun, metrics: Metrics | None, balance_ratio: float = nan) -> LogSummary:
    """Return what a result keeps of a log."""
    return LogSummary(
        name=run.name,
        sha256=run.sha256,
        samples=run.samples,
        samples_read=run.defects.samples_read,
        dropped_rows=run.defects.dropped_rows,
        gaps=run.defects.gaps,
        repeated=run.defects.repeated,
        duration=run.duration,
        dropped=run.defects.dropped,
        found={f"{item.kind} {item.channel}": item.samples for item in run.defects.findings},
        share_certified=run.share_certified,
        lower=run.lower,
        upper=run.upper,
        balance_ratio=balance_ratio,
        metrics=metrics,
    )


SUMMARY = Layout(
    LogSummary,
    {
        "lower": Item("SI", "smallest scheduling parameters along the log", ("parameter",)),
        "upper": Item("SI", "largest scheduling parameters along the log", ("parameter",)),
        "share_certified": Item("1", "share of samples inside the region of the certificate", gaps=True),
    },
    {"parameter": "scheduling parameter"},
    (
        "sha256",
        "samples",
        "samples_read",
        "dropped_rows",
        "gaps",
        "repeated",
        "duration",
        "dropped",
        "found",
        "balance_ratio",
    ),
)


def write_log(logs: h5py.Group, metrics: h5py.Group, log: LogSummary, parameter_names: tuple[str, ...]) -> None:
    """Write a log into the groups `/logs` and, where it has references, `/metrics`."""
    write_group(logs, log.name, fields(SUMMARY, log, {"parameter": parameter_names}))
    if log.metrics is not None:
        write_group(metrics, log.name, fields(METRICS, log.metrics))


def read_log_summary(file: h5py.File, name: str) -> LogSummary:
    """Return what a result keeps of a log."""
    metrics = read(file["metrics"][name], METRICS) if name in file["metrics"] else None
    return read(file["logs"][name], SUMMARY, name=name, metrics=metrics)
