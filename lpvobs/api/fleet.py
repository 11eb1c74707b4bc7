"""The default method over any number of logs: one part per log, wherever it is computed, added in the order of their digests.

The result does not depend on how many processes or machines took part, nor on who finished first. A run that was killed goes on
with the logs that it had not finished, see `lpvobs.io.results.parts`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from operator import add
from pathlib import Path
from typing import Generic

import numpy as np
from numpy.typing import NDArray

from lpvobs.api.doubts import Doubting, Doubts
from lpvobs.api.files import Progress, within
from lpvobs.api.groups import Together, by_group, differences, together
from lpvobs.api.jobs import Result, Task, Workers
from lpvobs.api.known_engine import KnownEngine
from lpvobs.engines import base, channels
from lpvobs.errors import DataError
from lpvobs.io.logs import finding, parquet, reading
from lpvobs.io.logs.policies import LogPolicies
from lpvobs.io.results.parts import Left, PartsFolder, StoredPart, run_key
from lpvobs.io.results.results import LogSummary, summary_of
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import Metrics, compare_pieces
from lpvobs.observer.balance_agreement import Watched, judged
from lpvobs.observer.disagreement import Agreement, agreements
from lpvobs.observer.estimate import PASSES, MapEstimate, Point, merged, of_sums
from lpvobs.observer.information import Solution
from lpvobs.observer.log_run import Beginning
from lpvobs.observer.parts import LogInformation, StateGain, inform
from lpvobs.records import Array, Recording

OPENING, OPENING_SECONDS = 4, 1800.0
"""Logs, first by name, and [s] of each, that show where the engine is linearised: they are gone through more than once."""
OPENING_SHARE, PARTS_SHARE = 0.3, 0.6
"""Shares of the progress for these, and for the parts of all logs; the rest compares the map with references."""


@dataclass(frozen=True, repr=False)
class Estimated:
    """What `estimate` wrote."""

    estimate: MapEstimate
    summaries: tuple[LogSummary, ...]  # what the result keeps of each log, in the order given
    refused: tuple[str, ...]  # why other logs were left out
    doubts: Doubts  # what speaks against logs and engine
    scatter: float = float("nan")  # [kg/s], between logs; NaN where it is not known
    agreement: tuple[Agreement, ...] = ()  # of each log with the map of all; none for a single log or a rival method
    engine: Path | None = None  # the calibrated engine that it started from
    reused: int = 0  # logs that a run before this one had done
    headline: str = ""  # what the map says, in a sentence

    def __repr__(self) -> str:
        left = f", {len(self.refused)} left out" if self.refused else ""
        logs = ", ".join(log.name for log in self.summaries[:3]) + (", ..." if len(self.summaries) > 3 else "")
        return f"Estimated from {logs}{left}: {self.headline}"


@dataclass(frozen=True)
class PartTask:
    """What it takes to go through a log."""

    point: Point
    grid: Grid
    gain: StateGain
    policies: LogPolicies
    suspects: channels.Suspects
    alone: bool
    done: frozenset[str] = frozenset()
    seconds: float = np.inf

    def inform(self, recording: Recording) -> LogInformation:
        """Return the part of a log that is gone through."""
        point = self.point
        return inform(point.air_path, self.grid, self.gain, recording, point.settings, point.unknowns)


@dataclass(frozen=True)
class LogOutcome(Generic[Left]):
    """What came of a log: what it leaves, unless that is there already, whether of the whole, or why it cannot be used."""

    sha256: str
    stored: Left | None = None
    refusal: str | None = None
    whole: bool = True


def begun(before: KnownEngine, gain: StateGain, workers: Workers) -> PartTask:
    """Return what every log needs to be gone through, the engine being as it is known before them."""
    config, known = before.config, before.calibrated
    settings = config.estimate.of_engine(before.air_path.usual_tolerance)
    point = Point(before.air_path, settings, {} if known is None else known.deviation(), known)
    return PartTask(point, config.grid(), gain, config.reading, config.kind.suspects, workers.alone)


def estimate_fleet(
    before: KnownEngine,
    config_text: str,
    gain: StateGain,
    paths: Sequence[Path],
    out: Path,
    workers: Workers,
    progress: Progress,
) -> Estimated:
    """Return the map of all logs that can be used.

    Parts of several logs wait beside `out`, for a run with the same configuration. The engine has what it learned from the logs.
    Raises DataError if no log can be used, or they inform no node.
    """
    config, air_path = before.config, before.air_path
    grid, names = config.grid(), finding.log_names(paths)
    several = len(paths) > 1  # a single log leaves nothing to go on with: its part ends with the run
    with workers:
        task = begun(before, gain, workers)
        task, outcomes, merge = linearised(workers, task, sorted(paths, key=names.__getitem__), progress)
        engine = "" if before.calibrated is None else "".join(before.inputs.values())
        made_with = config_text + learned_digest(air_path) + engine
        folder = PartsFolder(out, run_key(made_with + repr(sorted(task.point.deviation.items())), gain), StoredPart)
        opened = {each.sha256: each.stored for each in outcomes.values() if each.stored is not None}
        if several:
            for sha256, stored in opened.items():
                folder.keep(sha256, stored)
            task = replace(task, done=folder.found())
        further = [path for path in paths if path not in outcomes]
        keep = folder.keep if several else None
        done = OPENING_SHARE + PARTS_SHARE
        outcomes |= outcomes_of(workers, partial(part_of, task), further, keep, within(progress, OPENING_SHARE, done))
        parts = {each.sha256: each.stored for each in outcomes.values() if each.stored is not None}
        read: Callable[[str], StoredPart] = folder.read if several else parts.__getitem__
        found = {outcomes[path].sha256: path for path in paths if outcomes[path].refusal is None}
        refusals = tuple(text for path in paths if (text := outcomes[path].refusal) is not None)
        if not found:
            if several:
                folder.remove()
            raise DataError("; ".join(refusals))
        called = {sha256: names[path] for sha256, path in found.items()}
        doubting = Doubting(config, judged(air_path, task.point.settings, task.point.known))
        every = reduce(add, looked_at(doubting, by_group(workers, called, partial(together, read, grid, task.point))))
        if merge is None or found.keys() != opened.keys():
            merge = of_sums(grid, every.total, every.runs, task.point)
        estimate, solution = replace(merge[0], runs=every.runs), merge[1]  # under the names that logs have now
        refuse_empty(estimate)
        doubts = doubting.doubts(estimate)
        agreed: tuple[float, tuple[Agreement, ...]] = (float("nan"), ())
        if len(found) > 1:
            differing = partial(differences, read, solution, config.estimate.prior_map)
            agreed = agreements([each for group in by_group(workers, called, differing) for each in group])
        units = {axis.channel: air_path.channels[axis.channel].unit for axis in air_path.axes}
        judging = partial(compared, grid, estimate.theta, units)
        kept = {run.sha256: rows for run, rows in zip(every.runs, every.kept, strict=True)}
        known = [(sha256, path, kept[sha256]) for sha256, path in found.items() if parquet.has_references(path)]
        judged_by = finished(workers, judging, known, within(progress, done, 0.1 * done + 0.9))
        metrics = {sha256: result for (sha256, *_), result in judged_by}
    runs, ratios = estimate.runs, doubts.ratios
    summaries = {run.sha256: summary_of(run, metrics.get(run.sha256), ratios[run.name]) for run in runs}
    turn = {name: number for number, name in enumerate(called.values())}
    return Estimated(
        reused=len((task.done & found.keys()) - opened.keys()),
        estimate=estimate,
        summaries=tuple(summaries[log] for log in found),
        refused=refusals,
        doubts=doubts,
        scatter=agreed[0],
        agreement=tuple(sorted(agreed[1], key=lambda item: turn[item.name])),
    )


def looked_at(doubting: Doubting, groups: Iterable[Together]) -> Iterator[Together]:
    """Yield groups of logs without the sums of their balances, once those have been looked at."""
    for group in groups:
        for run, balances in zip(group.runs, group.balances, strict=True):
            doubting.look(run.name, balances)
        yield replace(group, balances=())


def learned_digest(air_path: base.AirPath) -> str:
    """Return a digest of what an engine has learned, nothing of one that learns nothing."""
    known = air_path.knowledge()
    return "" if known is None else known.digest()


def linearised(
    workers: Workers, task: PartTask, paths: Sequence[Path], progress: Progress
) -> tuple[PartTask, dict[Path, LogOutcome[StoredPart]], tuple[MapEstimate, Solution] | None]:
    """Return the task at the point where the opening logs have the engine, and what whole logs say there if that is known.

    With them comes their map at this point, if that is known and all of them are whole. Logs that cannot be used make room for
    others.
    """
    opening, merge = replace(task, seconds=OPENING_SECONDS), None
    found: dict[Path, LogOutcome[StoredPart]] = {}
    for turn in range(PASSES):
        waiting = [path for path in paths if path not in found]
        while waiting and (lack := OPENING - sum(outcome.stored is not None for outcome in found.values())) > 0:
            going = within(progress, OPENING_SHARE * turn / PASSES, OPENING_SHARE * (turn + 1) / PASSES)
            found |= outcomes_of(workers, partial(part_of, opening), waiting[:lack], None, going)
            waiting = waiting[lack:]
        parts = [outcome.stored.part for outcome in found.values() if outcome.stored is not None]
        if not parts:
            break
        estimate, solution = merged(task.grid, sorted(parts, key=lambda part: part.run.sha256), opening.point)
        moved = opening.point.moved(estimate.engine)
        if moved is opening.point:
            merge = (estimate, solution) if all(outcome.whole for outcome in found.values()) else None
            break
        opening = replace(opening, point=moved)
        found = {path: outcome for path, outcome in found.items() if outcome.stored is None}
    return replace(task, point=opening.point), {path: each for path, each in found.items() if each.whole}, merge


def finished(
    workers: Workers, function: Callable[[Task], Result], tasks: Sequence[Task], progress: Progress
) -> Iterator[tuple[Task, Result]]:
    """Yield each task and its result as it finishes, and tell how many have."""
    for count, (number, result) in enumerate(workers.finished(function, tasks), 1):
        yield tasks[number], result
        progress(count / len(tasks))


def outcomes_of(
    workers: Workers,
    function: Callable[[Task], LogOutcome[Left]],
    logs: Sequence[Task],
    keep: Callable[[str, Left], None] | None,
    progress: Progress,
) -> dict[Task, LogOutcome[Left]]:
    """Go through logs; what each leaves is handed to `keep`, and forgotten but for its digest.

    Processes of this machine hand it over themselves; other machines do not see where it is kept.
    """
    if keep is None:
        return dict(finished(workers, function, logs, progress))
    if workers.scheduler is None:
        function = partial(_and_kept, keep, function)
    going = finished(workers, function, logs, progress)
    return {log: _kept(keep, outcome) for log, outcome in going}


def _and_kept(
    keep: Callable[[str, Left], None], function: Callable[[Task], LogOutcome[Left]], log: Task
) -> LogOutcome[Left]:
    return _kept(keep, function(log))


def _kept(keep: Callable[[str, Left], None], outcome: LogOutcome[Left]) -> LogOutcome[Left]:
    """Hand over what a log leaves, if that is there and not handed over yet."""
    if outcome.stored is not None:
        keep(outcome.sha256, outcome.stored)
    return replace(outcome, stored=None)


def refuse_empty(estimate: MapEstimate) -> None:
    """Raise where no node is informed, or a value is not a number."""
    if not estimate.supported.any():
        names = ", ".join(run.name for run in estimate.runs)
        raise DataError(
            f"logs {names}: no node of the map was driven for long enough (least_information in [estimate]); "
            f"drive longer and over more operating points"
        )
    if not np.isfinite(estimate.theta[estimate.supported]).all():
        raise DataError(
            "the estimated map contains infinite values, because the observer is unstable with this gain; make a gain for this "
            "engine with `lpvobs synth-gain`"
        )


def part_of(task: PartTask, path: Path) -> LogOutcome[StoredPart]:
    """Go through one log."""

    def stored(log: reading.LogFile, beginning: Beginning) -> StoredPart:
        point = task.point
        watched = Watched(beginning, judged(point.configured, point.settings, point.known), task.grid, task.suspects)
        return StoredPart(task.inform(watched), log.kept, watched.sums)

    return gone_through(task, path, stored)


def gone_through(task: PartTask, path: Path, left: Callable[[reading.LogFile, Beginning], Left]) -> LogOutcome[Left]:
    """Go through one log for what it leaves; a log that cannot be used is an outcome, not a failure."""
    sha256 = ""
    try:
        log = reading.LogFile(path, task.point.air_path.channels, task.policies, threads=task.alone)
        sha256 = log.sha256
        if sha256 in task.done:
            return LogOutcome(sha256)
        beginning = Beginning(log, task.seconds)
        return LogOutcome(sha256, left(log, beginning), whole=not beginning.goes_on)
    except DataError as error:
        return LogOutcome(sha256, refusal=str(error))


def compared(
    grid: Grid, theta: Array, units: Mapping[str, str], log: tuple[str, Path, tuple[NDArray[np.uint8], ...]]
) -> Metrics:
    """Compare a map with the references of one log: its digest, its file, and which of its rows were used."""
    _, path, kept = log
    read = partial(reading.references, path, units, kept)
    if len(kept) == 1:  # fits into memory: no need to read it twice
        pieces = list(read())
        return compare_pieces(grid, theta, lambda: pieces)  # type: ignore[arg-type, return-value]
    return compare_pieces(grid, theta, read)  # type: ignore[arg-type]
