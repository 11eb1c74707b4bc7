"""The configuration: one TOML file, read strictly into frozen records.

What the file does not know is refused with the nearest key that exists; what it lacks is named.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lpvobs.discovery.throttled_noise import DayToDay
from lpvobs.engines.base import AirPath
from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.throttled.constants import ThrottledEngine
from lpvobs.engines.throttled.lpv import Throttled
from lpvobs.errors import UsageError
from lpvobs.io.configuration.strict import convert
from lpvobs.io.configuration.strict import parse as _parse
from lpvobs.io.configuration.strict import read_text as _read
from lpvobs.io.logs.reading import LogPolicies
from lpvobs.maps.grid import Grid
from lpvobs.observer.ekf import KalmanSettings
from lpvobs.observer.settings import EstimateSettings, PublishedSettings
from lpvobs.simulation.disturbances import Injected, injected_of
from lpvobs.simulation.parameters import SimulationParameters, Surface
from lpvobs.simulation.road import Auxiliary
from lpvobs.synthesis.settings import GainSettings

Record = TypeVar("Record")
SCHEMA = 1
MOST_NODES = 3000  # the information matrix of more does not fit a small machine


@dataclass(frozen=True)
class Axis:
    """Nodes start, start + step, ..., stop."""

    start: float
    stop: float
    step: float

    def __post_init__(self) -> None:
        if not (np.isfinite([self.start, self.stop, self.step]).all() and self.step > 0 and self.stop > self.start):
            raise ValueError("an axis needs finite start < stop and step > 0")
        intervals = (self.stop - self.start) / self.step
        if intervals > 1000:
            raise ValueError("an axis has at most 1000 intervals")
        if abs(intervals - round(intervals)) > 1e-6:
            raise ValueError(f"step {self.step:g} does not divide the axis from {self.start:g} to {self.stop:g}")

    def nodes(self) -> Any:
        """Return the nodes, shape (intervals + 1,)."""
        intervals = round((self.stop - self.start) / self.step)
        return self.start + (self.stop - self.start) * np.arange(intervals + 1) / intervals


@dataclass(frozen=True)
class Config:
    """A complete configuration; see `configs/diesel.toml` and `configs/liu-ice.toml` for what every key means."""

    schema: int
    air_path: str
    map: Mapping[str, Axis]
    engine: DieselEngine | ThrottledEngine
    gain: GainSettings
    estimate: EstimateSettings
    published: PublishedSettings
    ekf: KalmanSettings
    policies: LogPolicies = field(default_factory=LogPolicies)
    simulation: SimulationParameters | None = None

    def engine_path(self) -> AirPath:
        """Return the air path of the configured engine."""
        return Throttled(self.engine) if isinstance(self.engine, ThrottledEngine) else Diesel(self.engine)

    @property
    def diesel(self) -> DieselEngine:
        """The engine, for what only a diesel can do; raises UsageError for another one."""
        if not isinstance(self.engine, DieselEngine):
            raise UsageError(f"air_path = '{self.air_path}': only a diesel can do this, see configs/diesel.toml")
        return self.engine

    def grid(self) -> Grid:
        """Return the grid of the map, fuel axis first."""
        fuel, speed = (self.map[axis.channel].nodes() for axis in self.engine_path().axes)
        return Grid(fuel, speed)


@dataclass(frozen=True)
class DieselConfig(Config):
    """That of a diesel."""

    engine: DieselEngine


@dataclass(frozen=True)
class ThrottledConfig(Config):
    """That of a throttled engine."""

    engine: ThrottledEngine
    trace: DayToDay = field(default_factory=DayToDay)


KINDS: dict[str, type[Config]] = {Diesel.name: DieselConfig, Throttled.name: ThrottledConfig}
"""The configuration of every air path."""


def load_config(path: Path) -> tuple[Config, str]:
    """Return the configuration in a TOML file, and the file's text.

    Raises
    ------
    UsageError
        If the file cannot be read, has a key that nothing knows, lacks one, or holds an impossible value.
    """
    text = _read(path)
    return config_of(text, path), text


def config_of(text: str, path: Path) -> Config:
    """Return the configuration in a text, for example the one that a result keeps; `path` names it in errors."""
    document = _parse(text, path)
    kind = document.get("air_path", Diesel.name)
    if not isinstance(kind, str) or kind not in KINDS:
        raise UsageError(f"{path}: air_path = {kind!r}, expected one of {', '.join(map(repr, KINDS))}")
    config = _convert(path, document, KINDS[kind])
    if config.schema != SCHEMA:
        raise UsageError(
            f"{path}: schema = {config.schema}, expected {SCHEMA}; this file is for another version of lpvobs"
        )
    wanted = {axis.channel for axis in config.engine_path().axes}
    if set(config.map) != wanted:
        raise UsageError(f"{path}: [map] has {sorted(config.map)}, expected exactly {sorted(wanted)}")
    _check_names(path, config)
    nodes = config.grid().size
    if nodes > MOST_NODES:
        raise UsageError(f"{path}: [map] has {nodes} nodes, expected at most {MOST_NODES}; widen the steps")
    return config


@dataclass(frozen=True)
class Effects:
    """What `simulate --effects` reads: another surface of the sensor's error, what has happened to engine and sensors, a road."""

    surface: Surface | None = None
    auxiliary: Auxiliary | None = None
    injected: tuple[Injected, ...] = ()


def load_effects(path: Path) -> tuple[Effects, str]:
    """Return the effects in a TOML file, and the file's text; raises as `load_config` does."""
    text = _read(path)
    document = _parse(text, path)
    if not document:
        raise UsageError(
            f"{path}: holds neither [surface], [[effect]] nor [auxiliary]; see configs/effects for examples"
        )
    listed = document.pop("effect", [])
    if not (isinstance(listed, list) and all(isinstance(table, dict) for table in listed)):
        raise UsageError(f"{path}: 'effect' is no list of tables; write each one under its own [[effect]]")
    effects = tuple(_effect(path, place, table) for place, table in enumerate(listed))
    tables = convert(path, document, _Surroundings, "configs/effects/road.toml")
    return Effects(tables.surface, tables.auxiliary, effects), text


@dataclass(frozen=True)
class _Surroundings:
    """The tables of an effects file whose keys are fixed; those of an effect depend on its identifier."""

    surface: Surface | None = None
    auxiliary: Auxiliary | None = None


def _effect(path: Path, place: int, table: Mapping[str, Any]) -> Injected:
    try:
        return injected_of(table)
    except UsageError as error:
        raise UsageError(f"{path}: effect[{place}]: {error}") from None


def _check_names(path: Path, config: Config) -> None:
    """Refuse names that the engine does not have, in the tables whose keys are free."""
    air_path = config.engine_path()
    states, rates = air_path.state_names, air_path.temperature_names
    rho = [name for name in air_path.parameter_names if name not in air_path.rate_names]
    sums = [name for pair in config.gain.nonnegative_sums for name in pair]
    for table, found, known in (
        (
            "estimate.tolerance",
            config.estimate.tolerance,
            tuple(dict.fromkeys((*air_path.engine_constants(), *air_path.balance_constants))),
        ),
        ("gain.outputs", config.gain.outputs, states),
        ("gain.bounds", config.gain.bounds, rho),
        ("gain.nonnegative_sums", sums, air_path.parameter_names),
        ("gain.temperatures", config.gain.temperatures, rates),
        ("published.temperatures", config.published.temperatures, rates),
        ("ekf.process_noise", config.ekf.process_noise, states),
        ("ekf.measurement_noise", config.ekf.measurement_noise, (*states, air_path.sensor)),
    ):
        for name in found:
            if name not in known:
                raise UsageError(f"{path}: {table}: '{name}' is unknown; expected some of {', '.join(known)}")
    for table, found, needed in (
        ("gain.temperatures", config.gain.temperatures, rates),
        ("published.temperatures", config.published.temperatures, rates),
        ("ekf.process_noise", config.ekf.process_noise, states),
        ("ekf.measurement_noise", config.ekf.measurement_noise, (*config.gain.outputs, air_path.sensor)),
    ):
        for name in needed:
            if name not in found:
                raise UsageError(f"{path}: {table}: '{name}' is missing; give all of {', '.join(needed)}")
    if len(set(config.gain.outputs)) < len(config.gain.outputs):
        raise UsageError(f"{path}: gain.outputs: {', '.join(config.gain.outputs)} has a name twice; name each once")


def _convert(path: Path, document: Mapping[str, Any], record: type[Record]) -> Record:
    return convert(path, document, record, "configs/diesel.toml")
