"""`trace`: what the model lacks, from a stored result and logs."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np

from lpvobs.discovery.catalogue import diesel_plant
from lpvobs.discovery.closing import nominal_map, trace
from lpvobs.discovery.outcome import Trace
from lpvobs.discovery.problem import MapPrior, free_map
from lpvobs.errors import DataError, UsageError
from lpvobs.io.config import Config, config_of
from lpvobs.io.logs import read_log
from lpvobs.io.results import StoredResult, read_result, update
from lpvobs.records import Log


def trace_result(
    path: Path, log_paths: Sequence[Path], freeze_map: bool | None, progress: Callable[[float], None]
) -> tuple[Trace, bool]:
    """Trace the residual of a stored model on logs, write `/trace` into the result; return it, and whether the map was frozen.

    Parameters
    ----------
    path : Path
        A result.
    log_paths : sequence of Path
    freeze_map : bool or None
        Whether the stored map stands. None decides: it stands on logs that did not make it, and is estimated jointly on those
        that did.
    progress : callable
        Takes the fraction done.

    Raises
    ------
    DataError
        If the result or a log cannot be used.
    UsageError
        If some of the logs made the map and others did not, and nothing says what holds.
    """
    stored = read_result(path)
    config = config_of(stored.provenance.config, path)
    logs = [read_log(item, config.engine_path().channels, config.policies, auxiliary=True) for item in log_paths]
    frozen = _stands(stored, logs) if freeze_map is None else freeze_map
    found = trace(
        diesel_plant(config.engine),
        config.grid(),
        config.estimate.tolerance,
        _prior(config, stored, frozen),
        logs,
        progress,
    )
    content = json.dumps({"logs": [log.name for log in logs], "map_frozen": frozen, **found.as_json(refined=False)})

    def change(file: h5py.File) -> None:
        if "trace" in file:
            del file["trace"]
        file.create_group("trace").attrs["json"] = content

    update(path, change)
    return found, frozen


def _stands(stored: StoredResult, logs: Sequence[Log]) -> bool:
    made = [any(log.sha256 == own.sha256 for own in stored.logs) for log in logs]
    if all(made):
        return False
    if any(made):
        names = ", ".join(log.name for log, own in zip(logs, made, strict=True) if own)
        raise UsageError(
            f"{stored.path}: made from {names}, but not from the other logs; say --freeze-map or --free-map"
        )
    return True


def _prior(config: Config, stored: StoredResult, frozen: bool) -> MapPrior:
    tolerance = config.estimate.tolerance
    if not frozen:
        return free_map(config.grid(), len(tolerance), config.estimate.prior_map)
    if stored.constants != tuple(tolerance) or not np.isfinite(stored.covariance).all():
        raise DataError(
            f"{stored.path}: map of method '{stored.method}' has no covariance over the engine's constants, which a nominal map "
            f"needs; estimate it with the default method"
        )
    return nominal_map(
        stored.theta,
        stored.covariance,
        stored.sensitivity,
        np.sqrt(config.estimate.constants_variance),
        config.estimate.prior_map,
    )
