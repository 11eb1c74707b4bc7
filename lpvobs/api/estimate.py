"""`estimate`: logs in, map and metrics out."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import h5py
from msgspec import Meta

from lpvobs.api import files, fleet, known_engine, verify
from lpvobs.api.doubts import Doubting
from lpvobs.api.jobs import Workers, processors
from lpvobs.engines.base import AirPath
from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import Config, load_config
from lpvobs.io.logs import finding, reading
from lpvobs.io.results import gains, parts, results
from lpvobs.io.results.provenance import Provenance, write_refused
from lpvobs.io.safety.atomic import replacing
from lpvobs.kinds import Count, Output, Refused
from lpvobs.maps.metrics import Metrics, compare
from lpvobs.observer import disagreement, rivals
from lpvobs.observer.balance_agreement import BalanceAgreement, Watched, judged
from lpvobs.observer.estimate import MapEstimate
from lpvobs.observer.information import AlongFlow
from lpvobs.observer.parts import StateGain, operating_point
from lpvobs.observer.settings import CONSTANTS
from lpvobs.records import Log
from lpvobs.report import outputs, spoken

MANY = 8  # number of logs from which on other processes are started, each of which takes about a second to start
METHODS = ("observer", "published", "ekf", "batch")


class NodeCounts(Output):
    """Nodes of a map, and those of them that the logs inform."""

    nodes: Count
    estimated: Count


class EngineUsed(Output):
    """Where the engine comes from."""

    source: Annotated[str, Meta(description="File of the engine, or `configuration`.")]
    calibrated: bool


class EstimateOutput(Output):
    """A map, and its metrics by log."""

    result: str
    method: str
    headline: Annotated[str, Meta(description="Summary of the map in one sentence.")]
    logs: Sequence[outputs.LogOutput]
    refused: Refused
    map: NodeCounts
    scatter: Annotated[float, Meta(description="kg/s, scatter of a node between the maps of single logs")]
    agreement: Sequence[disagreement.Agreement]
    balance_agreement: BalanceAgreement
    engine: EngineUsed
    along_flow: AlongFlow | None
    doubts: Annotated[Sequence[str], Meta(description="Warnings about logs or the engine, one line each.")]


def estimate(
    config: files.File,
    logs: files.Files,
    out: files.File,
    *,
    gain: files.File | None = None,
    engine: files.File | None = None,
    method: str = "observer",
    constants: str | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: files.Progress | None = None,
) -> fleet.Estimated:
    """Estimate the error map of the sensor from logs and write the result.

    Raises UsageError for an unknown method, or logs that are there twice; DataError if the gain or none of the logs can be
    used, or they inform no node; NotProven if the certificate of the gain does not hold.

    Parameters
    ----------
    logs : path or several
        Parquet logs, patterns, or folders of logs.
    gain : path, optional
        Made by `synth_gain`; without it one is made and proven first.
    engine : path, optional
        Made by `calibrate` from the same configuration; by default what `[engine] file` names, else the engine is as configured,
        within its tolerances.
    method : str
        `observer`; `published`: Gamma = 200 I, as in the paper; `ekf`; `batch`.
    constants : str, optional
        `joint` or `consider`, see `EstimateSettings`; by default as the configuration says.
    jobs : int, optional
        Logs done at the same time, one per process.
    scheduler : str, optional
        Address of a Dask scheduler, on whose workers the logs are done.

    Notes
    -----
    `estimate.theta` and `estimate.standard_error` have the shape (p,) [kg/s], nodes in the order of Eq. (23); metrics are
    there where a log has references. Eq. (26) with gains that fall with information; departures from the paper: `docs/method.md`.
    """
    paths = files.some_logs(logs)
    configuration, text = load_config(files.as_path(config))
    engine = engine or configuration.engine_file(files.as_path(config))
    files.expect_one_of("--method", method, METHODS)
    with files.writing(out, [config, *paths, gain, engine]) as target:
        if constants is not None:
            files.expect_one_of("--constants", constants, CONSTANTS)
            if method != "observer":
                raise UsageError(
                    f"--constants: the method {method} always uses the configured constants; drop --constants or --method"
                )
            configuration = replace(configuration, estimate=replace(configuration.estimate, constants=constants))
        workers, told = workers_for(method, len(paths), jobs, scheduler), files.shown(progress)
        if engine is not None and method != "observer" and not configuration.kind.air_path.learns:
            raise UsageError(f"--method {method}: this method always uses the configured engine; drop --engine")
        before = known_engine.engine_before(configuration, paths, engine)
        stored = gain_for(configuration, paths, gain, method, before.air_path)
        files.refuse_copies(paths)
        if method == "observer":
            done = fleet.estimate_fleet(before, text, stored.state, paths, target, workers, told)
        else:
            done = _one_after_another(before, stored.state, paths, method, told)
        says = _write(target, before, text, stored, paths, done)
        told(1.0)
    return replace(done, engine=None if engine is None else files.as_path(engine), headline=says)


def _write(
    out: Path,
    before: known_engine.KnownEngine,
    config_text: str,
    stored: gains.StoredGain,
    paths: Sequence[Path],
    done: fleet.Estimated,
) -> str:
    """Write the result, and what its logs show of a healthy engine; return what the map says, in a sentence."""
    names = finding.log_names(paths)
    digests = {log.name: log.sha256 for log in done.summaries}
    inputs = {f"{name}{path.suffix}": digests[name] for path, name in names.items() if name in digests}
    provenance = Provenance({**inputs, **before.inputs}, config_text)
    found, doubts = done.estimate, done.doubts
    says = spoken.headline(found, before.air_path.axes, doubts.driven, doubts.agreement.ratio)

    def further(file: h5py.File) -> None:
        file.attrs["headline"] = says
        results.write_doubts(file, doubts.agreement, doubts.says, found.grid, doubts.reading)
        write_refused(file, done.refused)
        if done.agreement:
            results.write_agreement(file, scatter=done.scatter, logs=done.agreement)
        before.write(file)

    with replacing(out) as whole:  # a map without what its logs show of a healthy engine would say less, and not tell
        results.write_result(whole, before.air_path, found, done.summaries, stored, provenance, further)
        if found.method == "observer":
            from lpvobs.api.search_start import learn_healthy  # loads the search for effects

            learn_healthy(whole, names, [item.name for item in done.agreement if item.disagrees])
    parts.PartsFolder(out, "", parts.StoredPart).remove()
    return says


def _one_after_another(
    before: known_engine.KnownEngine, gain: StateGain, paths: Sequence[Path], method: str, progress: files.Progress
) -> fleet.Estimated:
    """Estimate by a method that goes through the logs in turn, the map of one being the start of the next."""
    config, air_path, settings, grid = before.config, before.air_path, before.config.estimate, before.config.grid()
    logs, refused = files.usable(paths, partial(reading.read_log, channels=air_path.channels, policies=config.reading))
    names = finding.log_names(paths)
    logs = {path: replace(log, name=names[path]) for path, log in logs.items()}
    progress(0.5)
    given = (air_path, grid, gain, [*logs.values()])
    if method == "published":
        estimate = rivals.estimate_published(*given, config.published, settings)
    elif method == "ekf":
        estimate = rivals.estimate_ekf(*given, config.ekf, settings)
    else:
        estimate = rivals.estimate_batch(*given, settings)
    fleet.refuse_empty(estimate)
    engine = judged(air_path, settings.of_engine(air_path.usual_tolerance), None)
    doubting = Doubting(config, engine)
    for log in logs.values():
        watched = Watched(log, engine, grid, config.kind.suspects)
        deque(watched.pieces(), maxlen=0)  # goes through the log
        doubting.look(log.name, watched.sums)
    doubts = doubting.doubts(estimate)
    progress(0.9)
    summaries = tuple(
        results.summary_of(run, metrics_of(air_path, estimate, path, log), doubts.ratios[run.name])
        for (path, log), run in zip(logs.items(), estimate.runs, strict=True)
    )
    return fleet.Estimated(estimate, summaries, refused, doubts)


def workers_for(method: str, logs: int, jobs: int | None, scheduler: str | None) -> Workers:
    """Return who does the logs: here by default if they are few, else in one process per processor."""
    if jobs is not None and scheduler is not None:
        raise UsageError(
            "--jobs starts processes on this machine, but --scheduler uses workers on other machines; drop one of the two options"
        )
    if method != "observer" and (scheduler is not None or (jobs or 1) > 1):
        raise UsageError(f"--method {method}: processes one log after the other; drop --jobs and --scheduler")
    if jobs is not None and jobs < 1:
        raise UsageError(f"--jobs {jobs}: expected a number of processes of at least 1")
    if jobs is None:
        jobs = processors() if logs >= MANY else 1
    return Workers(jobs, scheduler)


def gain_for(
    config: Config, paths: Sequence[Path], gain: files.File | None, method: str, air_path: AirPath | None = None
) -> gains.StoredGain:
    """Return the gain to estimate with: the given one, proven again, or else one made for the method and the engine."""
    if gain is None:
        from lpvobs.api.synth_gain import make_gain, make_published_gain  # with a gain, no solver is loaded

        if method == "published":
            return make_published_gain(config)
        return make_gain(config, paths, lenient=True, air_path=air_path)[0]
    stored = gains.read_gain(files.as_path(gain))
    gains.expect_engine(files.as_path(gain), stored, config)
    verify.expect_proven(gain, verify.check_again(stored))
    return stored


def metrics_of(air_path: AirPath, estimate: MapEstimate, path: Path, log: Log) -> Metrics | None:
    """Compare the final map with the references of a log, if it has any."""
    references = reading.read_references(path, log.rows)
    if references is None:
        return None
    return compare(estimate.grid, estimate.theta, *operating_point(air_path, log), references["ref_delta_W_c"])
