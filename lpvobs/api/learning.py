"""The air path of a configuration with what healthy logs show of its engine."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import h5py

from lpvobs.engines.base import AirPath
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import Config
from lpvobs.io.logs.reading import read_log
from lpvobs.io.results.learned import write_learned
from lpvobs.records import Log


def learned_path(config: Config, paths: Sequence[Path]) -> AirPath:
    """Return the air path, with what it learns from those of the logs that can be used; whoever uses them next says why not.

    Logs are read only for an engine that learns.
    """
    air_path = config.engine_path()
    logs = usable_logs(config, paths) if air_path.learns else []
    return air_path.learned_from(logs) if logs else air_path


def usable_logs(config: Config, paths: Sequence[Path]) -> list[Log]:
    """Return the logs that can be read."""
    logs = []
    for path in paths:
        with suppress(DataError):
            logs.append(read_log(path, config.engine_path().channels, config.policies))
    return logs


def engine_writer(config: Config, air_path: AirPath, paths: Sequence[Path]) -> Callable[[h5py.File], None] | None:
    """Return what writes a learned engine and its held-out errors into a result; None for an engine that learns nothing."""
    known, errors = air_path.knowledge(), config.kind.errors
    if known is None or errors is None:
        return None
    logs = usable_logs(config, paths)
    healthy = errors(config.engine, logs)
    balances = config.kind.residual_model(config, air_path, healthy, (), None).balances
    return lambda file: write_learned(file, known, healthy, balances)
