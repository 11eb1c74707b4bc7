"""`estimate`: logs in, map and metrics out."""

from collections.abc import Callable, Sequence
from pathlib import Path

from lpvobs.airpath.base import AirPath
from lpvobs.errors import UsageError
from lpvobs.io.config import Config
from lpvobs.io.gains import StoredGain
from lpvobs.io.logs import read_log, read_references
from lpvobs.io.provenance import Provenance
from lpvobs.io.results import LogSummary, write_result
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import Metrics, compare
from lpvobs.observer.estimate import LogRun, MapEstimate, StateGain, estimate_default, estimate_published
from lpvobs.observer.rivals import estimate_batch, estimate_ekf
from lpvobs.records import Log

METHODS = ("observer", "published", "ekf", "batch")


def estimate_logs(
    config: Config,
    config_text: str,
    stored: StoredGain,
    paths: Sequence[Path],
    out: Path,
    method: str,
    progress: Callable[[float], None],
) -> tuple[MapEstimate, tuple[LogSummary, ...]]:
    """Estimate the map from logs and write the result.

    The reference channels are read after the map is final, by `_metrics`, and by nothing else.

    Raises
    ------
    UsageError
        For an unknown method or two logs of the same name.
    DataError
        If a log or the gain cannot be used.
    """
    if method not in METHODS:
        raise UsageError(f"--method {method}: unknown; expected one of {', '.join(METHODS)}")
    _refuse_doubles(paths)
    air_path, grid = config.engine_path(), config.grid()
    logs = []
    for done, path in enumerate(paths):
        logs.append(read_log(path, air_path.channels, config.policies))
        progress(0.5 * (done + 1) / len(paths))
    gain = StateGain(stored.outputs, stored.gain.L)
    estimate = _estimate(config, air_path, grid, gain, logs, method)
    progress(0.9)
    summaries = tuple(
        _summary(stored, run, _metrics(air_path, estimate, path, log))
        for path, log, run in zip(paths, logs, estimate.runs, strict=True)
    )
    axes = (air_path.axes[0].channel, air_path.axes[1].channel)
    provenance = Provenance({path.name: log.sha256 for path, log in zip(paths, logs, strict=True)}, config_text)
    write_result(out, air_path.name, axes, air_path.parameter_names, estimate, summaries, stored, provenance)
    progress(1.0)
    return estimate, summaries


def _estimate(
    config: Config, air_path: AirPath, grid: Grid, gain: StateGain, logs: Sequence[Log], method: str
) -> MapEstimate:
    settings = config.estimate
    if method == "published":
        return estimate_published(air_path, grid, gain, logs, config.published, settings)
    if method == "ekf":
        return estimate_ekf(air_path, grid, gain.outputs, logs, config.ekf, settings)
    if method == "batch":
        return estimate_batch(air_path, grid, gain.outputs, logs, settings)
    return estimate_default(air_path, grid, gain, logs, settings)


def _refuse_doubles(paths: Sequence[Path]) -> None:
    seen: dict[str, Path] = {}
    for path in paths:
        if path.stem in seen:
            raise UsageError(f"{path}: same name as {seen[path.stem]}; results keep logs by name, rename one")
        seen[path.stem] = path


def _metrics(air_path: AirPath, estimate: MapEstimate, path: Path, log: Log) -> Metrics | None:
    """Compare the final map with the references of a log, if it has any."""
    references = read_references(path, log.rows)
    if references is None:
        return None
    fuel, speed = air_path.axes
    return compare(estimate.grid, estimate.theta, log[fuel.channel], log[speed.channel], references.delta_W_c)


def _summary(stored: StoredGain, run: LogRun, metrics: Metrics | None) -> LogSummary:
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
        share_certified=float(stored.gain.region.contains(run.parameters).mean()),
        lower=run.parameters.min(axis=0),
        upper=run.parameters.max(axis=0),
        metrics=metrics,
    )
