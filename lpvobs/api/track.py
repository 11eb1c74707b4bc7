"""`track`: maps by vehicle and time, from sums that add up without the logs."""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate, groupby
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from lpvobs.api import estimate, files, known_engine
from lpvobs.api.files import File, Files, Progress, as_path, as_paths, refuse_copies, shown, usable, writing
from lpvobs.api.fleet import LogOutcome, PartTask, begun, gone_through, learned_digest, linearised, outcomes_of, part_of
from lpvobs.api.jobs import Workers
from lpvobs.errors import DataError, UsageError
from lpvobs.io.configuration.config import Config, load_config
from lpvobs.io.logs import finding, parquet, reading
from lpvobs.io.results.fleets import FleetSums, StoredFleet, dated, read_fleet, write_fleet, write_table
from lpvobs.io.results.parts import PartsFolder, run_key
from lpvobs.io.results.provenance import Provenance
from lpvobs.io.safety.atomic import state_of
from lpvobs.kinds import Count, Output, Refused
from lpvobs.observer.estimate import merged
from lpvobs.observer.log_run import Beginning
from lpvobs.observer.parts import added_up
from lpvobs.records import Item
from lpvobs.tracking.changes import Detectable
from lpvobs.tracking.fleet import MapChange, NextCell, Standing
from lpvobs.tracking.fleet import track as tracked
from lpvobs.tracking.sums import Basis, DatedEffect, KeptLog, basis_of, kept, weighed

FIRST_VEHICLES, FIRST_LOGS = 2, 2
"""By name and by date: they show where the engine is linearised, and how rows are weighed."""

ALONE = 24 << 20
"""[bytes] of logs that this process has read by the time that two others have started and read theirs."""


class TrackOutput(Output):
    """What is known of a fleet; trends and sizes are level [kg/s], gain [1] and shape [kg/s]."""

    fleet: str
    logs: Count
    new: Annotated[int, Meta(description="Number of logs that were not in the fleet before.")]
    reused: Annotated[int, Meta(description="Number of new logs that an earlier, interrupted run had already read.")]
    refused: Refused
    periods: Sequence[str]
    vehicles: Sequence[Standing]
    changes: Sequence[MapChange]
    effects: Annotated[
        Sequence[DatedEffect], Meta(description="Effects that refine found, with the dates of the logs that have them.")
    ]
    next: Sequence[NextCell]
    power: Annotated[
        Sequence[Detectable],
        Meta(description="Smallest changes of the gain that are found in 90 % of cases, by number of logs."),
    ]


@dataclass(frozen=True)
class _Whose:
    """A log that can be told whose it is."""

    path: Path
    vehicle: str
    kind: str
    day: float


def track(
    config: File,
    logs: Files = (),
    *,
    out: File,
    by: str = "vehicle",
    every: str = "month",
    path: str | None = None,
    origins: File | None = None,
    gain: File | None = None,
    engine: File | None = None,
    table: File | None = None,
    refined: Files = (),
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> tuple[StoredFleet, TrackOutput]:
    """Follow the map of every vehicle over time, and write what is found beside the sums of all logs.

    Raises UsageError for an unknown period, a path that does not follow the pattern, or logs that are there twice; DataError if
    no log can be used, or `out` was made with another configuration; NotProven if the certificate of the gain does not hold.

    Parameters
    ----------
    logs : path or several
        Parquet logs, patterns or folders. Those that `out` knows by their digest are not read again; none: `out` as it is, anew.
    by : str
        The field that says whose a log is.
    every : str
        Period of a map: day, week, month or year.
    path : str, optional
        Pattern of the logs' paths, such as `{vehicle}/{month}.parquet`.
    origins : path, optional
        A table, CSV or Parquet, with a column `log` and others such as `vehicle`, `engine` (its type) and `date`.
    gain, engine, jobs, scheduler
        As for `estimate`.
    table : path, optional
        Parquet file to write with a row for each vehicle, period and node.
    refined : path or several
        Results of `refine` on logs of the fleet: the effects that it found get their place in time, and stay with the fleet.

    Returns
    -------
    StoredFleet, TrackOutput
        The fleet as written, and the object that `lpvobs track --json` prints.
    """
    files.expect_one_of("--every", every, finding.PERIODS)
    configuration, text = load_config(as_path(config))
    found = finding.find_logs(as_paths(logs))
    refuse_copies(found)
    engine = engine or configuration.engine_file(as_path(config))
    told = as_paths(refined)
    read = [config, *found, gain, engine, origins, *told]
    with (
        writing(out, [*read, table]) as target,
        nullcontext() if table is None else writing(table, read),
    ):
        if not found and not target.is_file():
            raise UsageError(
                f"{target}: this fleet file does not exist, and no logs are named to make it from; name logs, or correct --out"
            )
        before = read_fleet(target) if target.is_file() else None
        if before is not None and before.provenance.config != text:
            raise _other(target)
        sums, reused = None if before is None else before.kept, 0
        known = frozenset(() if sums is None else (log.sha256 for log in sums.logs))
        fresh = [each for each in found if not (known and each.is_file() and parquet.log_digest(each) in known)]
        told_by = finding.origins_of(fresh, path, None if origins is None else as_path(origins))
        belonging, refused = usable([*told_by], partial(_whose, by, configuration, told_by), one=False)
        if whose := sorted(belonging.values(), key=lambda each: (each.vehicle, each.day, each.path.as_posix())):
            state = estimate.gain_for(configuration, found, gain, "observer").state
            sizes = (sum(state_of(each.path)[1:2]) for each in whose)  # none where there is no such log
            long = any(size > ALONE for size in accumulate(sizes))
            workers = estimate.workers_for("observer", len(whose) if long else 1, jobs, scheduler)
            task = begun(_known(configuration, engine), state, workers)
            sums, more, reused = _added(sums, whose, every, text, task, target, workers, shown(progress))
            refused = (*refused, *more)
        if sums is None:
            raise DataError("; ".join(refused))
        known_effects = () if before is None else before.effects
        told_of = (*known_effects, *(effect for each in told for effect in dated(each, sums.logs)))
        by_time = {(each.vehicle, each.first, each.id, each.parameter): each for each in told_of}
        sums, effects = replace(sums, every=every), tuple(by_time[key] for key in sorted(by_time))
        grid, least = configuration.grid(), configuration.estimate.least_information
        prior = configuration.estimate.prior_map
        result = tracked(grid, sums.basis, sums.sums, sums.logs, sums.periods(), prior, least)
        air_path = configuration.engine_path()
        axes = {axis.channel: Item(axis.unit, axis.meaning) for axis in air_path.axes}
        provenance = Provenance({f"{log.vehicle}/{log.name}": log.sha256 for log in sums.logs}, text)
        fleet = StoredFleet(target, air_path.name, axes, grid, sums, result, effects, provenance, refused)
        write_fleet(fleet)
        PartsFolder(target, "", KeptLog).remove()
        if table is not None:
            write_table(as_path(table), fleet)
    return fleet, output_of(fleet, len(sums.logs) - len(known), reused)


def output_of(fleet: StoredFleet, new: int, reused: int) -> TrackOutput:
    """Return what is printed of a fleet."""
    found = fleet.found
    return TrackOutput(
        fleet=str(fleet.path),
        logs=len(fleet.kept.logs),
        new=new,
        reused=reused,
        refused=fleet.refused,
        periods=sorted({each.period for each in found.maps}),
        vehicles=found.worst_first(),
        changes=found.changes,
        effects=fleet.effects,
        next=found.cells,
        power=found.power,
    )


def _other(path: Path) -> DataError:
    return DataError(
        f"{path}: this fleet was made with another configuration, gain, engine or version of lpvobs; use the same ones again, or "
        f"name a new file with --out, and all logs"
    )


def _known(config: Config, engine: File | None) -> known_engine.KnownEngine:
    """Return what is known of the engine before the logs; raises UsageError for curves that every log would learn anew."""
    before = known_engine.engine_before(config, (), engine)
    air_path = before.air_path
    if air_path.learns and air_path.knowledge() is None:
        raise UsageError(
            f"air_path = '{air_path.name}': the curves of this engine must not be learned from the fleet's own logs, because they "
            f"would hide sensor drift; learn them once with `lpvobs calibrate --healthy LOG`, and give --engine"
        )
    return before


def _whose(by: str, config: Config, origins: Mapping[Path, Mapping[str, str]], path: Path) -> _Whose:
    """Return whose a log is; raises DataError where that is not known, or there is no such log."""
    origin = origins[path]
    if not origin.get(by):
        parquet.metadata_of(path)  # raises where there is no such log, or it is damaged
        raise DataError(
            f"{path}: the field '{by}' of this log is unknown; give --path or --origins, or store the vehicle in the "
            "log with `lpvobs ingest --vehicle NAME`"
        )
    return _Whose(path, origin[by], origin.get("engine") or config.air_path, finding.day_of(path, origin))


def _sums_of(task: PartTask, basis: Basis, its: _Whose) -> LogOutcome[KeptLog]:
    """Go through one log for its weighed sums."""
    grid = task.grid

    def left(_: reading.LogFile, log: Beginning) -> KeptLog:
        part = task.inform(log)
        cells = (grid.speed.size - 1) * (grid.fuel.size - 1)
        return kept(part, weighed(part, basis), basis, (its.path.stem, its.vehicle, its.kind, its.day), cells)

    return gone_through(task, its.path, left)


def _added(
    before: FleetSums | None,
    whose: Sequence[_Whose],
    every: str,
    text: str,
    task: PartTask,
    out: Path,
    workers: Workers,
    progress: Progress,
) -> tuple[FleetSums | None, list[str], int]:
    """Return a fleet with the logs that can be used, why others cannot, and how many a run before this one had read.

    The logs are in the order of vehicles and dates.
    """
    with workers:
        if before is None:
            basis, task, refused = _weighed_by(workers, task, whose, progress)
            if basis is None:
                return None, refused, 0
        else:
            basis, task = before.basis, replace(task, point=replace(task.point, deviation=before.deviation))
        point = task.point  # the key is a digest of all that the sums of a log depend on beside it
        known = None if point.known is None else [point.known.mean.tolist(), point.known.covariance.tolist()]
        made_with = text + learned_digest(point.air_path) + repr((sorted(point.deviation.items()), known))
        key = run_key(made_with, task.gain)
        if before is not None and before.key != key:
            raise _other(out)
        folder = PartsFolder(out, key + basis.digest(), KeptLog)
        task = replace(task, done=folder.found())
        outcomes = outcomes_of(workers, partial(_sums_of, task, basis), whose, folder.keep, progress)
    logs = {} if before is None else {log.sha256: log for log in before.logs}
    sums = {} if before is None else {each.vehicle: each for each in before.sums}
    used = sorted(outcome.sha256 for outcome in outcomes.values() if outcome.refusal is None)
    for sha256 in used:
        added = folder.read(sha256)
        logs[sha256], name = added.log, added.log.vehicle
        sums[name] = sums[name].plus(added.sums) if name in sums else added.sums
    total, in_order = tuple(sums[name] for name in sorted(sums)), tuple(logs[each] for each in sorted(logs))
    refused = [said for each in whose if (said := outcomes[each].refusal) is not None]
    fleet = FleetSums(key, every, point.deviation, basis, total, in_order) if logs else before
    return fleet, refused, len(task.done.intersection(used))


def _weighed_by(
    workers: Workers, task: PartTask, whose: Sequence[_Whose], progress: Progress
) -> tuple[Basis | None, PartTask, list[str]]:
    """Return how rows are weighed and the task where the engine is linearised, after the first logs; else why there is none."""
    opening = [each.path for logs in _first(whose) for each in logs]
    others = [each.path for each in whose if each.path not in opening]
    task, outcomes, _ = linearised(workers, task, [*opening, *others], progress)
    while True:
        good = [each for each in whose if each.path not in outcomes or outcomes[each.path].refusal is None]
        first = _first(good)
        missing = [each.path for logs in first for each in logs if each.path not in outcomes]
        if not missing:
            break
        outcomes |= outcomes_of(workers, partial(part_of, task), missing, None, progress)
    if not first:
        return None, task, [text for each in whose if (text := outcomes[each.path].refusal) is not None]
    stored = [[outcomes[each.path].stored for each in logs] for logs in first]
    parts = [[each.part for each in logs if each is not None] for logs in stored]
    solutions = [merged(task.grid, logs, task.point)[1] for logs in parts]
    totals = [added_up(task.grid, each.layout, logs)[0] for each, logs in zip(solutions, parts, strict=True)]
    return basis_of(task.grid, solutions, totals, task.point.unknowns), task, []


def _first(whose: Sequence[_Whose]) -> list[list[_Whose]]:
    """Return the first logs of the first vehicles, of logs by vehicle and date."""
    by_vehicle = [list(logs)[:FIRST_LOGS] for _, logs in groupby(whose, lambda each: each.vehicle)]
    return by_vehicle[:FIRST_VEHICLES]
