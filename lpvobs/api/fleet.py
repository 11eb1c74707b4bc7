"""The default method over any number of logs: one part per log, wherever it is computed, added in the order of their digests.

The result does not depend on how many processes or machines took part, nor on who finished first. A run that was killed goes on
with the logs that it had not finished, see `lpvobs.io.results.parts`.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lpvobs.api.doubts import Doubts, doubts_of
from lpvobs.api.jobs import Workers
from lpvobs.engines.base import AirPath
from lpvobs.engines.mix_ups import Suspects
from lpvobs.errors import DataError, UsageError
from lpvobs.io.configuration.config import Config
from lpvobs.io.logs.parquet import has_references
from lpvobs.io.logs.policies import LogPolicies
from lpvobs.io.logs.reading import LogFile, references
from lpvobs.io.results.log_summaries import LogSummary, summary_of
from lpvobs.io.results.parts import PartsFolder, StoredPart, run_key
from lpvobs.io.safety.unchanged import file_digest
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import Metrics, compare_pieces
from lpvobs.observer.balance_agreement import Watched
from lpvobs.observer.disagreement import Agreement, agreements
from lpvobs.observer.estimate import MapEstimate, merged
from lpvobs.observer.parts import LogInformation, StateGain, inform
from lpvobs.observer.settings import EstimateSettings
from lpvobs.records import Array

PARTS_SHARE = 0.85
"""Share of the progress for the parts of the logs; the rest compares the map with references."""


@dataclass(frozen=True)
class Workplace:
    """Where and how tasks run: processes on this machine, or the address of a Dask scheduler."""

    jobs: int = 1
    scheduler: str | None = None


@dataclass(frozen=True)
class Estimated:
    """What `estimate` wrote.

    Attributes
    ----------
    summaries : tuple of LogSummary
        What the result keeps of each log, in the order given.
    refused : tuple of str
        Why other logs were left out.
    scatter : float
        [kg/s], between logs; NaN where it is not known.
    agreement : tuple of Agreement
        Of each log with the map of all; none for a single log or a rival method.
    doubts : Doubts
        What speaks against logs and engine.
    """

    estimate: MapEstimate
    summaries: tuple[LogSummary, ...]
    refused: tuple[str, ...]
    doubts: Doubts
    scatter: float = float("nan")
    agreement: tuple[Agreement, ...] = ()


@dataclass(frozen=True)
class PartTask:
    """One log to go through, with all that this takes."""

    path: Path
    air_path: AirPath
    grid: Grid
    gain: StateGain
    settings: EstimateSettings
    policies: LogPolicies
    done: frozenset[str]
    alone: bool
    suspects: Suspects


@dataclass(frozen=True)
class PartOutcome:
    """What came of a log: its part, unless that is there already, or why it cannot be used."""

    sha256: str
    stored: StoredPart | None = None
    refusal: str | None = None


@dataclass(frozen=True)
class MetricsTask:
    """A final map to compare with the references of one log."""

    path: Path
    grid: Grid
    theta: Array
    units: dict[str, str]
    kept: tuple[NDArray[np.uint8], ...]


def estimate_fleet(
    config: Config,
    config_text: str,
    gain: StateGain,
    paths: Sequence[Path],
    out: Path,
    workplace: Workplace,
    progress: Callable[[float], None],
    air_path: AirPath,
) -> Estimated:
    """Return the map of all logs that can be used.

    Raises UsageError for two logs of the same bytes; DataError if no log can be used, or they inform no node.

    Parameters
    ----------
    config_text : str
        Parts are kept for a run with the same configuration.
    out : Path
        The result to be made; parts of several logs wait beside it.
    progress : callable
        Takes the fraction done.
    air_path : AirPath
        The engine, with what it has learned from the logs.
    """
    refuse_copies(paths)
    grid = config.grid()
    known = air_path.knowledge()
    learned = "" if known is None else known.digest()
    settings = config.estimate.limited_to(air_path.balance_constants)
    key = run_key(config_text + learned, gain)
    store = _Store(PartsFolder(out, key) if len(paths) > 1 else None)
    with Workers(min(workplace.jobs, len(paths)), workplace.scheduler) as workers:
        alone = workplace == Workplace()
        task = PartTask(
            Path(), air_path, grid, gain, settings, config.policies, store.done(), alone, config.kind.suspects
        )
        found, refusals = _parts(workers, task, paths, store, lambda f: progress(PARTS_SHARE * f))
        estimate, solution = merged(grid, store.parts(found), settings)
        refuse_empty(estimate)
        sums = ((path.stem, store.read(sha256).balances) for sha256, path in sorted(found.items()))
        doubts = doubts_of(config, air_path, estimate, sums)
        scatter = float("nan")
        agreement: tuple[Agreement, ...] = ()
        if len(found) > 1:
            scatter, agreement = agreements(grid, solution, store.parts(found), settings)
        rest = 1.0 - PARTS_SHARE
        metrics = _metrics(workers, air_path, estimate, found, store, lambda f: progress(PARTS_SHARE + 0.9 * rest * f))
    summaries = {
        found[run.sha256]: summary_of(run, metrics[run.sha256], doubts.ratios[run.name]) for run in estimate.runs
    }
    compared_with_all = {item.name: item for item in agreement}
    used = [path for path in paths if path in summaries]
    return Estimated(
        estimate=estimate,
        summaries=tuple(summaries[path] for path in used),
        refused=refusals,
        doubts=doubts,
        scatter=scatter,
        agreement=tuple(compared_with_all[path.stem] for path in used if path.stem in compared_with_all),
    )


def _parts(
    workers: Workers, task: PartTask, paths: Sequence[Path], store: "_Store", progress: Callable[[float], None]
) -> tuple[dict[str, Path], tuple[str, ...]]:
    """Have the parts of all logs in the store; return the logs by digest, and why others were left out."""
    tasks = [replace(task, path=path) for path in paths]
    found: dict[str, Path] = {}
    refused: dict[int, str] = {}
    for count, (number, outcome) in enumerate(workers.finished(part_of, tasks), 1):
        if outcome.refusal is not None:
            refused[number] = outcome.refusal
        else:
            store.keep(outcome)
            found[outcome.sha256] = paths[number]
        progress(count / len(tasks))
    refusals = tuple(refused[number] for number in sorted(refused))
    if not found:
        store.remove()
        raise DataError("; ".join(refusals))
    return found, refusals


def refuse_empty(estimate: MapEstimate) -> None:
    """Raise where no node is informed, or a value is not a number."""
    if not estimate.supported.any():
        names = ", ".join(run.name for run in estimate.runs)
        raise DataError(
            f"{names}: no node of the map is informed for least_information in [estimate]; "
            f"drive longer and over more operating points"
        )
    if not np.isfinite(estimate.theta[estimate.supported]).all():
        raise DataError("the estimate is not finite: the gain does not stabilise this engine; synthesise one for it")


def remove_parts(out: Path) -> None:
    """Delete the parts beside a result that has been written."""
    PartsFolder(out, "").remove()


def part_of(task: PartTask) -> PartOutcome:
    """Go through one log; a log that cannot be used is an outcome, not a failure."""
    sha256 = ""
    try:
        log = LogFile(task.path, task.air_path.channels, task.policies, threads=task.alone)
        sha256 = log.sha256
        if sha256 in task.done:
            return PartOutcome(sha256)
        watched = Watched(log, task.air_path, task.grid, tuple(task.settings.tolerance), task.suspects)
        part = inform(task.air_path, task.grid, task.gain, watched, task.settings)
    except DataError as error:
        return PartOutcome(sha256, refusal=str(error))
    return PartOutcome(sha256, StoredPart(part, log.kept, watched.sums))


def compared(task: MetricsTask) -> Metrics:
    """Compare a map with the references of one log."""
    read = partial(references, task.path, task.units, task.kept)
    if len(task.kept) == 1:  # fits into memory: no need to read it twice
        pieces = list(read())
        return compare_pieces(task.grid, task.theta, lambda: pieces)  # type: ignore[arg-type, return-value]
    return compare_pieces(task.grid, task.theta, read)  # type: ignore[arg-type]


def refuse_copies(paths: Sequence[Path]) -> None:
    """Raise for two logs of the same bytes, which would count twice; only files of the same size are looked into."""
    by_size: dict[int, list[Path]] = {}
    for path in paths:
        with suppress(OSError):
            by_size.setdefault(path.stat().st_size, []).append(path)
    for same in by_size.values():
        seen: dict[str, Path] = {}
        for path in same if len(same) > 1 else ():
            if not path.is_file():
                continue
            try:
                digest = file_digest(path)
            except OSError:  # whoever reads it tells why it cannot be
                continue
            if digest in seen:
                raise UsageError(
                    f"{path}: same bytes as {seen[digest]}; the same drive would count twice, leave one out"
                )
            seen[digest] = path


def _metrics(
    workers: Workers,
    air_path: AirPath,
    estimate: MapEstimate,
    found: dict[str, Path],
    store: "_Store",
    progress: Callable[[float], None],
) -> dict[str, Metrics | None]:
    units = {axis.channel: air_path.channels[axis.channel].unit for axis in air_path.axes}
    known = [sha256 for sha256, path in found.items() if has_references(path)]
    tasks = [
        MetricsTask(found[sha256], estimate.grid, estimate.theta, units, store.read(sha256).kept) for sha256 in known
    ]
    metrics: dict[str, Metrics | None] = dict.fromkeys(found)
    for count, (number, result) in enumerate(workers.finished(compared, tasks), 1):
        metrics[known[number]] = result
        progress(count / len(tasks))
    return metrics


class _Store:
    """Where parts wait: in a folder, or a single one in memory."""

    def __init__(self, folder: PartsFolder | None):
        self.folder = folder
        self.held: dict[str, StoredPart] = {}

    def done(self) -> frozenset[str]:
        return self.folder.found() if self.folder else frozenset()

    def keep(self, outcome: PartOutcome) -> None:
        if outcome.stored is None:
            return
        if self.folder:
            self.folder.keep(outcome.stored)
        else:
            self.held[outcome.sha256] = outcome.stored

    def read(self, sha256: str) -> StoredPart:
        return self.folder.read(sha256) if self.folder else self.held[sha256]

    def parts(self, found: dict[str, Path]) -> Iterator[LogInformation]:
        """Yield the parts in the order of their digests, each under the name that its log has now."""
        for sha256 in sorted(found):
            part = self.read(sha256).part
            yield replace(part, run=replace(part.run, name=found[sha256].stem))

    def remove(self) -> None:
        if self.folder:
            self.folder.remove()
