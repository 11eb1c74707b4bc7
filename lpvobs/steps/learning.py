"""The air path of a configuration with what healthy logs show of its engine."""

from collections.abc import Sequence
from pathlib import Path

from lpvobs.airpath.base import AirPath
from lpvobs.errors import DataError
from lpvobs.io.config import Config
from lpvobs.io.logs import read_log
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
        try:
            logs.append(read_log(path, config.engine_path().channels, config.policies))
        except DataError:
            continue
    return logs
