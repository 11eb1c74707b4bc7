"""What a result keeps of the logs that made it: of each, how far it is from the map of all, and how far the balances agree."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Annotated

import h5py

from lpvobs.io.results.hdf import Field, write_group
from lpvobs.io.results.mapping import rows, write
from lpvobs.maps.metrics import Metrics
from lpvobs.observer.balance_agreement import BalanceAgreement
from lpvobs.observer.disagreement import Agreement
from lpvobs.observer.log_run import LogRun
from lpvobs.records import Array, Item


@dataclass(frozen=True)
class LogSummary:
    """What a result keeps of each log that made it.

    `dropped` is by channel; `found`, among the dropped, are samples that are stuck, saturated or spiked, by kind and channel,
    such as `stuck p_im`. The duration is in s. `balance_ratio` is the disagreement of the balances over what is to be expected
    of it, NaN where there is one balance; metrics are None where the log has no references.
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
    share_certified: Annotated[float, Item("1", "share of samples inside the region of the certificate", gaps=True)]
    lower: Annotated[Array, Item("SI", "smallest scheduling parameters along the log", ("parameter",))]
    upper: Annotated[Array, Item("SI", "largest scheduling parameters along the log", ("parameter",))]
    balance_ratio: float
    mean_flow: Annotated[float, Item("kg/s", "mean of the sensor's readings", gaps=True)]
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
        mean_flow=run.mean_flow,
        metrics=metrics,
    )


def write_log(logs: h5py.Group, metrics: h5py.Group, log: LogSummary, parameter_names: tuple[str, ...]) -> None:
    """Write a log into the groups `/logs` and, where it has references, `/metrics`."""
    write(logs, log.name, log, {"parameter": parameter_names})
    if log.metrics is not None:
        write(metrics, log.name, log.metrics)


def write_agreement(file: h5py.File, scatter: float, logs: tuple[Agreement, ...]) -> None:
    """Write how far each log's own map is from the common one."""
    between = Field(scatter, "kg/s", "standard deviation of a node between logs, beyond noise")
    write_group(file, "agreement", rows(logs, "log") | {"scatter": between})


def write_balance_agreement(file: h5py.File, found: BalanceAgreement, doubts: Sequence[str]) -> None:
    """Write how far the balances agree, and what speaks against logs and engine, a line each."""
    write(file, "balance_agreement", found).attrs["doubts"] = "\n".join(doubts)
