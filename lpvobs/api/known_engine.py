"""The engine of a stored result: its configuration, and what a calibration or healthy logs have taught of it."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import h5py

from lpvobs.engines.base import AirPath
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.engines.unknowns import Unknowns
from lpvobs.errors import DataError
from lpvobs.io.configuration.config import Config, config_of
from lpvobs.io.logs.parquet import channel_units
from lpvobs.io.logs.reading import read_log
from lpvobs.io.results.engines import StoredEngine, read_engine, read_engine_before
from lpvobs.io.results.hdf import reading
from lpvobs.io.results.learned import Learning, read_learned, write_learned
from lpvobs.io.results.results import KIND, REMEDY, StoredResult
from lpvobs.records import Log


@dataclass(frozen=True)
class KnownEngine:
    """An engine as a result knows it."""

    config: Config
    air_path: AirPath  # with what was learned
    # how wrong its balances are on an engine in order; None for an engine that learns nothing
    healthy: HealthyErrors | None
    # what a calibration knew before the logs; None where that is the configuration alone
    calibrated: Unknowns | None = None

    def residual_model(self, taught: Collection[str] = ()) -> ResidualModel:
        """Return the engine as the loop sees it; `taught` are the digests of logs that must not be judged by what they taught."""
        model = self.config.kind.residual_model(self.config, self.air_path, self.healthy, taught, self.calibrated)
        return replace(model, units={name: channel.unit for name, channel in self.air_path.channels.items()})

    def read(self, path: Path) -> Log:
        """Return a log that may lack channels that the loop can do without; raises DataError as `read_log` does."""
        there, optional = channel_units(path), self.air_path.dispensable
        needed = {name: item for name, item in self.air_path.channels.items() if name in there or name not in optional}
        return read_log(path, needed, self.config.reading, auxiliary=True)

    def write(self, file: h5py.File) -> None:
        """Write what was learned into another result."""
        if (learning := self.learning()) is not None:
            write_learned(file, learning)

    def learning(self) -> Learning | None:
        """Return what healthy logs have taught, None of an engine that learns nothing."""
        known = self.air_path.knowledge()
        if known is None or self.healthy is None:
            return None
        return Learning(known, self.healthy, self.residual_model().balances)


def known_engine(stored: StoredResult, engine: Path | None = None) -> KnownEngine:
    """Return the engine of a result, or of a calibration in place of that; raises DataError where it lacks what it should know."""
    config = config_of(stored.provenance.config, stored.path)
    air_path = config.engine_path()
    if engine is not None:
        calibrated = read_engine(engine, air_path)
        if calibrated.learned is not None:
            return _knowing(config, calibrated.learned)
        return KnownEngine(config, air_path, None, calibrated.unknowns)
    with reading(stored.path, KIND, REMEDY) as file:
        if not air_path.learns:
            return KnownEngine(config, air_path, None, read_engine_before(file, air_path))
        return _knowing(config, read_learned(file))


def _knowing(config: Config, learning: Learning) -> KnownEngine:
    return KnownEngine(config, config.engine_path().knowing(learning.known), learning.healthy)


def learned_engine(config: Config, logs: Sequence[Log]) -> KnownEngine:
    """Return the engine as healthy logs show it; as configured where there is none, or it learns nothing."""
    air_path, errors = config.engine_path(), config.kind.errors
    if errors is None or not logs:
        return KnownEngine(config, air_path, None)
    return KnownEngine(config, air_path.learned_from(logs), errors(config.engine, logs))


def engine_before(config: Config, paths: Sequence[Path], calibrated: StoredEngine | None = None) -> KnownEngine:
    """Return what is known of the engine before an estimate.

    Without a calibration an engine that learns takes its own logs for healthy; whoever uses them next says which cannot be read.
    """
    if calibrated is not None and calibrated.learned is not None:
        return _knowing(config, calibrated.learned)
    logs = []
    for path in paths if config.kind.air_path.learns else ():
        with suppress(DataError):
            logs.append(read_log(path, config.engine_path().channels, config.reading))
    return learned_engine(config, logs)
