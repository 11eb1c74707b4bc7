"""`trace` and `refine`: what the model lacks, from a stored result and logs, and the model that has it."""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from lpvobs.discovery.catalogue import diesel_plant
from lpvobs.discovery.closing import Refinement, nominal_map, refine
from lpvobs.discovery.outcome import Trace
from lpvobs.discovery.problem import MapPrior, free_map
from lpvobs.errors import DataError, UsageError
from lpvobs.io.atomic import replacing
from lpvobs.io.config import Config, config_of
from lpvobs.io.hdf import changing, reading
from lpvobs.io.logs import read_log
from lpvobs.io.results import KIND, REMEDY, StoredResult, read_result, update
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
    closed = _close(path, log_paths, freeze_map, progress)
    found = closed.refinement.trace
    content = closed.content(refined=False)

    def change(file: h5py.File) -> None:
        if "trace" in file:
            del file["trace"]
        file.create_group("trace").attrs["json"] = content

    update(path, change)
    return found, closed.frozen


def refine_result(
    path: Path, log_paths: Sequence[Path], out: Path, freeze_map: bool | None, progress: Callable[[float], None]
) -> tuple[Trace, bool]:
    """Add the effects that the logs prove to a stored model, estimate again, write the refined model.

    Without a finding the model of before is written, byte for byte. Parameters and errors as for `trace_result`; DataError also
    for a result that has been refined already: its effects are stored, but not yet part of the model that is traced.
    """
    closed = _close(path, log_paths, freeze_map, progress)
    refinement, stored = closed.refinement, closed.stored
    found = refinement.trace
    content = closed.content(refined=True)

    def change(file: h5py.File) -> None:
        error = np.sqrt(np.maximum(np.diag(refinement.covariance), 0.0)).reshape(stored.grid.shape)
        file["map/delta_W_c"][()] = np.where(stored.supported, refinement.theta, np.nan)
        file["map/standard_error"][()] = np.where(stored.supported, error, np.nan)
        file["nodes/covariance"][()] = refinement.covariance
        file["nodes/noise"][()] = refinement.covariance
        for group in ("extrapolation", "metrics", "trace", "refinement"):
            if group in file:
                del file[group]
        file.create_group("metrics")
        file.create_group("refinement").attrs["json"] = content

    if found.findings:
        with changing(path, out) as file:
            change(file)
    else:
        with replacing(out) as temporary:
            shutil.copyfile(path, temporary)
    return found, closed.frozen


@dataclass(frozen=True)
class _Closed:
    """The closed loop on logs: the stored model, what came of it, and whether the map stood."""

    stored: StoredResult
    logs: tuple[str, ...]
    refinement: Refinement
    frozen: bool

    def content(self, refined: bool) -> str:
        """Return the contract's object as JSON text."""
        head = {"logs": list(self.logs), "map_frozen": self.frozen}
        return json.dumps(head | self.refinement.trace.as_json(refined=refined))


def _close(
    path: Path, log_paths: Sequence[Path], freeze_map: bool | None, progress: Callable[[float], None]
) -> _Closed:
    stored = read_result(path)
    with reading(path, KIND, REMEDY) as file:
        if "refinement" in file:
            raise DataError(f"{path}: has been refined already; trace or refine the result that it was made from")
    config = config_of(stored.provenance.config, path)
    logs = [read_log(item, config.engine_path().channels, config.policies, auxiliary=True) for item in log_paths]
    frozen = _stands(stored, logs) if freeze_map is None else freeze_map
    prior, tolerance = _prior(config, stored, frozen), config.estimate.tolerance
    refinement = refine(diesel_plant(config.engine), config.grid(), tolerance, prior, logs, progress)
    return _Closed(stored, tuple(log.name for log in logs), refinement, frozen)


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
    owed = config.estimate.limited_to(config.engine_path().balance_constants).tolerance
    if stored.constants != tuple(owed) or not np.isfinite(stored.covariance).all():
        raise DataError(
            f"{stored.path}: map of method '{stored.method}' has no covariance over the engine's constants, which a nominal map "
            f"needs; estimate it with the default method"
        )
    sensitivity = np.zeros(
        (len(tolerance), *stored.grid.shape)
    )  # the map owes nothing to constants of the exhaust side
    sensitivity[[name in owed for name in tolerance]] = stored.sensitivity
    return nominal_map(
        stored.theta,
        stored.covariance,
        sensitivity,
        np.sqrt(config.estimate.constants_variance),
        config.estimate.prior_map,
    )
