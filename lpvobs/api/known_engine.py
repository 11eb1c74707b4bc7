"""The engine of a stored result: its configuration, and what a calibration or healthy logs have taught of it."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import h5py

from lpvobs.api.files import File, as_path, usable
from lpvobs.engines import base, unknowns
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.io.configuration.config import Config, config_of
from lpvobs.io.logs import parquet, reading
from lpvobs.io.results import engines, hdf, results
from lpvobs.io.safety.atomic import file_digest
from lpvobs.records import Log


@dataclass(frozen=True)
class KnownEngine:
    """An engine as a result knows it."""

    config: Config
    air_path: base.AirPath  # with what was learned
    # how wrong its balances are on an engine in order; None for an engine that learns nothing
    healthy: HealthyErrors | None
    # what a calibration knew before the logs; None where that is the configuration alone
    calibrated: unknowns.Unknowns | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)  # digest of the calibrated engine by the name of its file

    def residual_model(self, taught: Collection[str] = ()) -> ResidualModel:
        """Return the engine as the loop sees it; `taught` are the digests of logs that must not be judged by what they taught."""
        model = self.config.kind.residual_model(self.config, self.air_path, self.healthy, taught, self.calibrated)
        return replace(model, units={name: channel.unit for name, channel in self.air_path.channels.items()})

    def read(self, path: Path) -> Log:
        """Return a log that may lack channels that the loop can do without; raises DataError as `read_log` does."""
        there, optional = parquet.channel_units(path), self.air_path.dispensable
        needed = {name: item for name, item in self.air_path.channels.items() if name in there or name not in optional}
        return reading.read_log(path, needed, self.config.reading, auxiliary=True)

    def write(self, file: h5py.File) -> None:
        """Write what was learned into another result."""
        if (learning := self.learning()) is not None:
            engines.write_learned(file, learning)

    def learning(self) -> engines.Learning | None:
        """Return what healthy logs have taught, None of an engine that learns nothing."""
        known = self.air_path.knowledge()
        if known is None or self.healthy is None:
            return None
        return engines.Learning(known, self.healthy, self.residual_model().balances)


def stored_config(path: Path, kind: str, remedy: str) -> Config:
    """Return the configuration that a gain, an engine or a result was made with; raises DataError if the file is none of that."""
    with hdf.reading(path, kind, remedy) as file:
        return config_of(str(file["provenance"].attrs["config"]), path)


def known_engine(stored: results.StoredResult, engine: File | None = None) -> KnownEngine:
    """Return the engine of a result, or of a calibration in place of that; raises DataError where it lacks what it should know."""
    config = config_of(stored.provenance.config, stored.path)
    if engine is not None:
        return engine_before(config, (), engine)
    air_path = config.engine_path()
    with hdf.reading(stored.path, results.KIND, results.REMEDY) as file:
        if air_path.learns:
            learning = engines.read_learned(file)
            return KnownEngine(config, air_path.knowing(learning.known), learning.healthy)
        before = file.get(engines.BEFORE)
        return KnownEngine(config, air_path, None, None if before is None else engines.read_unknowns(before, air_path))


def learned_engine(config: Config, logs: Sequence[Log]) -> KnownEngine:
    """Return the engine as healthy logs show it; as configured where there is none, or it learns nothing."""
    air_path, errors = config.engine_path(), config.kind.errors
    if errors is None or not logs:
        return KnownEngine(config, air_path, None)
    return KnownEngine(config, air_path.learned_from(logs), errors(config.engine, logs))


def engine_before(config: Config, paths: Sequence[Path], engine: File | None = None) -> KnownEngine:
    """Return what is known of the engine before an estimate; without a calibration one that learns takes its logs for healthy."""
    air_path = config.engine_path()
    if engine is not None:
        path = as_path(engine)
        stored, inputs = engines.read_engine(path, air_path), {path.name: file_digest(path)}
        if stored.learned is None:
            return KnownEngine(config, air_path, None, stored.unknowns, inputs)
        return KnownEngine(config, air_path.knowing(stored.learned.known), stored.learned.healthy, inputs=inputs)
    read = partial(reading.read_log, channels=air_path.channels, policies=config.reading)
    logs, _ = usable(paths if air_path.learns else (), read, one=False)  # whoever uses them next says which cannot be
    return learned_engine(config, [*logs.values()])
