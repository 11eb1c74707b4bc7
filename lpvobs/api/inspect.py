"""`inspect`: what is in a log, and what the policies did about its defects."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lpvobs.api.files import File, as_path, as_paths
from lpvobs.engines.channels import Channel
from lpvobs.engines.registry import ENGINES, usual_engine
from lpvobs.errors import DataError
from lpvobs.ingest.record import stored_record
from lpvobs.io.configuration.config import load_config
from lpvobs.io.logs.finding import find_logs
from lpvobs.io.logs.parquet import channel_units
from lpvobs.io.logs.policies import LogPolicies
from lpvobs.io.logs.reading import read_log
from lpvobs.records import Array, Defects, Log


def defect_list(defects: Defects) -> list[dict[str, Any]]:
    """Return every defect found in a log with its channel, the samples it concerns, and what was done about it."""
    spoiled: dict[str, int] = {}
    for item in defects.findings:
        spoiled[item.channel] = spoiled.get(item.channel, 0) + item.samples
    missing = {name: count - spoiled.get(name, 0) for name, count in defects.dropped.items()}
    found: list[dict[str, Any]] = [
        {"defect": "no reading", "channel": name, "count": count, "policy": "drop"}
        for name, count in missing.items()
        if count
    ]
    found += [
        {
            "defect": item.kind,
            "channel": item.channel,
            "count": item.samples,
            "first": item.first,
            "policy": item.policy,
        }
        for item in defects.findings
    ]
    if defects.gaps:
        found.append({"defect": "gap", "channel": "time", "count": defects.gaps, "policy": "split"})
    if defects.repeated:
        found.append({"defect": "repeated or backward", "channel": "time", "count": defects.repeated, "policy": "drop"})
    return found


@dataclass(frozen=True)
class Inspection:
    """A log as the estimator sees it, with the unit that each channel has in the file.

    `ingest` is what was done to make the log of a foreign recording, None for a log that says nothing of it; `lacking` what each
    engine would still need where the log suits none.
    """

    path: Path
    log: Log
    needed: Mapping[str, Channel]
    file_units: Mapping[str, str]
    ingest: Mapping[str, Any] | None = None
    lacking: Mapping[str, list[str]] = field(default_factory=dict)

    def as_content(self) -> dict[str, Any]:
        """Return plain data for text or JSON."""
        log, defects = self.log, self.log.defects
        steps = np.diff(log.time)
        channels: dict[str, Any] = {"time": self._channel("time", log.time, "s", "needed")}
        for name, values in log.channels.items():
            channels[name] = self._channel(name, values, self.needed[name].unit, "needed")
        for name, values in log.auxiliary.items():
            channels[name] = self._channel(name, values, self.file_units[name], "auxiliary")
        return {
            "log": str(self.path),
            "sha256": log.sha256,
            "samples": len(log),
            "samples_read": defects.samples_read,
            "dropped_rows": defects.dropped_rows,
            "repeated": defects.repeated,
            "gaps": defects.gaps,
            "segments": len(log.segments),
            "duration": float(log.time[-1] - log.time[0]),
            "rate": float(1.0 / np.median(steps)),
            "defects": defect_list(defects),
            "channels": channels,
            "ingest": self.ingest,
            "lacking": self.lacking,
        }

    def _channel(self, name: str, values: Array, unit: str, use: str) -> dict[str, Any]:
        finite = values[np.isfinite(values)]
        low, middle, high = (
            (float(finite.min()), float(np.median(finite)), float(finite.max())) if finite.size else (np.nan,) * 3
        )
        return {
            "unit": unit,
            "unit_in_file": self.file_units.get(name, ""),
            "use": use,
            "min": low,
            "median": middle,
            "max": high,
            "dropped": self.log.defects.dropped.get(name, 0),
            "refresh": _refresh(self.log.time, values),
        }


def inspect(log: File, config: File | None = None) -> Inspection:
    """Return what is in a log and what the policies did about its defects.

    Parameters
    ----------
    log : path
    config : path, optional
        Engine and policies; by default the engine that the log suits.

    Returns
    -------
    Inspection
        `as_content()` is plain data: channels with units, ranges in the log's units, defects.

    Raises
    ------
    DataError
        If no estimate could use the log.
    """
    channels, policies = _engine_of(config)
    return inspect_log(as_path(log), channels, policies)


def inspect_logs(
    logs: File | Iterable[File], config: File | None = None
) -> tuple[tuple[Inspection, ...], tuple[str, ...]]:
    """Return what is in each of several logs that can be used, and why the others cannot; raises UsageError as `inspect`."""
    channels, policies = _engine_of(config)
    found, refused = [], []
    for path in find_logs(as_paths(logs)):
        try:
            found.append(inspect_log(path, channels, policies))
        except DataError as error:
            refused.append(str(error))
    return tuple(found), tuple(refused)


def _engine_of(config: File | None) -> tuple[Mapping[str, Channel] | None, LogPolicies]:
    """Return the channels that the configured engine needs, and the policies; None and the default ones without it."""
    if config is None:
        return None, LogPolicies()
    configuration, _ = load_config(as_path(config))
    return configuration.engine_path().channels, configuration.policies


def inspect_log(path: Path, needed: Mapping[str, Channel] | None, policies: LogPolicies) -> Inspection:
    """Return what is in a log; raises DataError where no estimate could use it.

    `needed` is what the engine needs; None: the first engine that the log suits, else the usual one. A log that `ingest` made is
    shown even if it suits no engine: it may have been recorded for something else.
    """
    units, record = channel_units(path), stored_record(path)
    lacking: dict[str, list[str]] = {}
    if needed is None:
        lacking = {
            name: [channel for channel in kind.air_path.channels if channel not in units]
            for name, kind in ENGINES.items()
        }
        suited = [ENGINES[name].air_path.channels for name, missing in lacking.items() if not missing]
        needed = suited[0] if suited else {} if record else usual_engine().air_path.channels
        lacking = {} if suited else lacking
    log = read_log(path, needed, policies, auxiliary=True)
    return Inspection(path, log, needed, units, record, lacking)


def _refresh(time: Array, values: Array) -> float:
    """Return how often a channel changes [Hz]: the inverse of the usual time between changes, NaN for a constant."""
    changed = time[np.flatnonzero(values[1:] != values[:-1]) + 1]
    return float(1.0 / np.median(np.diff(changed))) if changed.size > 1 else float("nan")
