"""`inspect`: what is in a log, and what the policies did about its defects."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from lpvobs.api.files import File, Files, as_path, as_paths, usable
from lpvobs.engines.channels import Channel
from lpvobs.engines.registry import ENGINES, usual_engine
from lpvobs.ingest.record import stored_record
from lpvobs.io.configuration.config import Config, load_config
from lpvobs.io.logs import finding, parquet, reading
from lpvobs.io.logs.policies import LogPolicies
from lpvobs.kinds import Count, Output, Refused, Seconds, Sha
from lpvobs.records import Array, Defects, Log

Units = Mapping[str, str]


class Defect(Output):
    """What is wrong with some samples, and what was done about it."""

    defect: str
    channel: str
    count: Count
    policy: str
    first: Annotated[float, Meta(description="s")] | UnsetType = UNSET


class ChannelOutput(Output):
    """A channel of a log: its range in the log's unit."""

    unit: str
    unit_in_file: str
    use: Literal["needed", "auxiliary"]
    min: float
    median: float
    max: float
    dropped: Count
    refresh: Annotated[float, Meta(description="Hz, how often the channel changes; null for a constant channel")]


class Informed(Output):
    """Nodes of the map that get a value from a log, as it is or with one channel more."""

    channel: Annotated[str | None, Meta(description="The further channel; null for the log as it is.")]
    supposed: Annotated[str, Meta(description="What this channel is taken to read.")]
    nodes: Count
    standard_error: Annotated[
        float | None,
        Meta(description="kg/s, median over the nodes that the log as it is informs, or over all if it informs none."),
    ]


class InspectedLog(Output):
    """What is in a log, and what the policies did."""

    log: str
    sha256: Sha
    samples: Count
    samples_read: Count
    dropped_rows: Count
    repeated: Count
    gaps: Count
    segments: Count
    duration: Seconds
    rate: Annotated[float, Meta(description="Hz")]
    defects: Sequence[Defect]
    channels: Mapping[str, ChannelOutput]
    ingest: Annotated[Mapping[str, Any], Meta(extra_json_schema={"$ref": "#/$defs/IngestRecord"})] | None
    serves: Annotated[Sequence[str], Meta(description="Kinds of engine for which the log has every required channel.")]
    lacking: Annotated[
        Mapping[str, Sequence[str]],
        Meta(description="For each other kind of engine: required channels that the log lacks."),
    ]
    further: Annotated[
        Mapping[str, Sequence[str]],
        Meta(description="For each engine in serves: optional channels that the log lacks."),
    ]
    informs: Annotated[
        Sequence[Informed],
        Meta(description="With --config: map nodes that the log informs, and with one channel more."),
    ]


class InspectOutput(Output):
    """What is in logs, and what the policies did."""

    logs: Sequence[InspectedLog]
    refused: Refused


def defects_of(defects: Defects) -> tuple[Defect, ...]:
    """Return every defect found in a log with its channel, the samples it concerns, and what was done about it."""
    spoiled: Counter[str] = Counter()
    for item in defects.findings:
        spoiled[item.channel] += item.samples
    missing = {name: count - spoiled[name] for name, count in defects.dropped.items()}
    found = [Defect(defect="no reading", channel=name, count=n, policy="drop") for name, n in missing.items() if n]
    found += [
        Defect(defect=item.kind, channel=item.channel, count=item.samples, policy=item.policy, first=item.first)
        for item in defects.findings
    ]
    for defect, count, policy in (("gap", defects.gaps, "split"), ("repeated or backward", defects.repeated, "drop")):
        found += [Defect(defect=defect, channel="time", count=count, policy=policy)] if count else []
    return tuple(found)


def inspect(log: File, config: File | None = None) -> InspectedLog:
    """Return what is in a log and what the policies did about its defects.

    Raises DataError if no estimate could use the log.

    Parameters
    ----------
    config : path, optional
        Engine and policies; by default the first engine that the log serves.
    """
    return _inspecting(config)(as_path(log))


def inspect_logs(logs: Files, config: File | None = None) -> InspectOutput:
    """Return what is in each of several logs that can be used, and why the others cannot; raises UsageError as `inspect`."""
    found, refused = usable(finding.find_logs(as_paths(logs)), _inspecting(config), one=False)
    return InspectOutput(logs=tuple(found.values()), refused=refused)


def _inspecting(config: File | None) -> Callable[[Path], InspectedLog]:
    """Return the function that inspects a log for the configured engine, else for the first one that the log serves."""
    if config is None:
        return partial(inspect_log, needed=None, policies=LogPolicies())
    known, _ = load_config(as_path(config))
    return partial(inspect_log, needed=known.engine_path().channels, policies=known.policies, config=known)


def inspect_log(
    path: Path, needed: Mapping[str, Channel] | None, policies: LogPolicies, config: Config | None = None
) -> InspectedLog:
    """Return what is in a log; raises DataError where no estimate could use it, unless `ingest` made it."""
    # `needed` is what the engine needs; None: the first engine that the log suits, else the usual one.
    units, record = parquet.channel_units(path), stored_record(path)
    lacking, further = {}, {}
    if needed is None:
        for name, kind in ENGINES.items():
            missed = {key: item for key, item in kind.air_path.channels.items() if key not in units}
            lacking[name] = [key for key, item in missed.items() if not item.may_lack(units)]
            further[name] = [key for key in missed if key not in lacking[name]]
        suited = [ENGINES[name].air_path.channels for name, missing in lacking.items() if not missing]
        needed = suited[0] if suited else {} if record else usual_engine().air_path.channels
    log = reading.read_log(path, needed, policies, auxiliary=True)
    absent = [name for name in needed if name not in units]
    of_all = {"time": log.time, **log.channels, **log.auxiliary}
    in_log = {"time": "s"} | {name: needed[name].unit for name in log.channels}
    return InspectedLog(
        log=str(path),
        sha256=log.sha256,
        samples=len(log),
        **{name: getattr(log.defects, name) for name in ("samples_read", "dropped_rows", "repeated", "gaps")},
        segments=len(log.segments),
        duration=float(log.time[-1] - log.time[0]),
        rate=float(1.0 / np.median(np.diff(log.time))),
        defects=defects_of(log.defects),
        channels={name: _channel(log, name, values, units, in_log) for name, values in of_all.items()},
        ingest=record,
        serves=[name for name, missing in lacking.items() if not missing],
        lacking={name: missing for name, missing in lacking.items() if missing},
        further={name: more for name, more in further.items() if more and not lacking[name]},
        informs=informed_with_each(config, path, log, absent) if config is not None and absent else (),
    )


def meanings(engine: str, channels: Sequence[str]) -> str:
    """Return channels of an engine with what they are; of those that stand for each other, one is enough."""
    known, told = ENGINES[engine].air_path.channels, dict[str, str]()
    for name in channels:
        text = f"{name} ({known[name].meaning})"
        first = next((other for other in known[name].one_of or () if other in told), None)
        told[first or name] = text if first is None else f"{told[first]} or {text}"
    return ", ".join(told.values())


def _channel(log: Log, name: str, values: Array, file_units: Units, in_log: Units) -> ChannelOutput:
    """Return what is in a channel; `in_log` has the units of those that the engine needs."""
    finite = values[np.isfinite(values)]
    at_rest = np.finfo(float).eps * np.max(np.abs(finite), initial=0.0)
    finite = np.where(np.abs(finite) < at_rest, 0.0, finite)
    low, middle, high = (float(of(finite)) if finite.size else np.nan for of in (np.min, np.median, np.max))
    changed = log.time[np.flatnonzero(values[1:] != values[:-1]) + 1]
    in_file = file_units.get(name, "")
    return ChannelOutput(
        unit=in_log.get(name, in_file),
        unit_in_file=in_file,
        use="needed" if name in in_log else "auxiliary",
        min=low,
        median=middle,
        max=high,
        dropped=log.defects.dropped.get(name, 0),
        refresh=float(1.0 / np.median(np.diff(changed))) if changed.size > 1 else np.nan,
    )


def informed_with_each(config: Config, path: Path, log: Log, lacking: Sequence[str]) -> tuple[Informed, ...]:
    """Return what a log says of the map as it is, and with each channel that it lacks; nothing if the engine has no stand-in.

    A stand-in is what the channel would read of the engine as configured. The map behind it is not shown: only its errors count,
    and they come from the noise of the other channels and from what the log's operation tells apart.
    """
    air_path = config.engine_path()
    stand_ins = {name: given for name, given in air_path.stand_ins(log).items() if name in lacking}
    if not stand_ins:
        return ()
    from lpvobs.api.estimate import gain_for  # load the compiler and the solver, which `inspect` needs for this alone
    from lpvobs.observer.estimate import estimate_default

    gain, grid = gain_for(config, [path], None, "observer").state, config.grid()
    logs: dict[str | None, tuple[str, Log]] = {None: ("", log)}
    for name, (supposed, values) in stand_ins.items():
        logs[name] = supposed, replace(log, channels={**log.channels, name: values})
    now, informs = None, []
    for channel, (supposed, each) in logs.items():
        found = estimate_default(air_path, grid, gain, [each], config.estimate)
        now = found.supported if now is None else now
        on = found.supported & now if now.any() else found.supported
        error = float(np.median(found.standard_error[on])) if on.any() else None
        nodes = int(found.supported.sum())
        informs.append(Informed(channel=channel, supposed=supposed, nodes=nodes, standard_error=error))
    return tuple(informs)
