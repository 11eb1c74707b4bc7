"""The configuration: one TOML file, read strictly into frozen records."""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, make_dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from lpvobs.engines import base, registry
from lpvobs.engines.channels import Sensor
from lpvobs.errors import UsageError
from lpvobs.io.configuration.strict import convert, parse, read_text
from lpvobs.io.logs.policies import LogPolicies, Reading
from lpvobs.maps.grid import Grid
from lpvobs.observer.ekf import KalmanSettings
from lpvobs.observer.settings import EstimateSettings, PublishedSettings
from lpvobs.simulation import disturbances, parameters, road
from lpvobs.synthesis.region import GainSettings

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
    """A complete configuration; see `configs/diesel.toml` and `configs/liu-ice.toml` for what every key means.

    The tables that are an engine's own have the records that its kind names; `record_of` gives them their types.
    """

    schema: int
    air_path: str
    map: Mapping[str, Axis]
    engine: Any
    gain: GainSettings
    estimate: EstimateSettings
    published: PublishedSettings
    ekf: KalmanSettings
    policies: LogPolicies = field(default_factory=LogPolicies)
    sensors: Mapping[str, Sensor] = field(default_factory=dict)

    simulation: ClassVar[parameters.SimulationParameters | None] = None
    trace: ClassVar[Any] = None

    @property
    def kind(self) -> base.EngineKind:
        """The kind of the configured engine."""
        return registry.ENGINES[self.air_path]

    @property
    def reading(self) -> Reading:
        """How logs are read: defects as the policies say, and what is known of the sensors put right."""
        return Reading(
            **vars(self.policies),
            sensors=self.sensors,
            narrowest=self.estimate.smoothing,
            pulsation=self.kind.pulsation,
        )

    def engine_file(self, path: Path) -> Path | None:
        """Return the calibrated engine that `[engine] file` names, beside the configuration at `path`; None for none."""
        name = getattr(self.engine, "file", "")  # only an engine with corrections has the key
        return path.parent / name if name else None

    def engine_path(self) -> base.AirPath:
        """Return the air path of the configured engine."""
        return self.kind.air_path(self.engine)

    def grid(self) -> Grid:
        """Return the grid of the map, fuel axis first."""
        return Grid(*(self.map[axis.channel].nodes() for axis in self.kind.air_path.axes))


@cache
def record_of(kind: base.EngineKind) -> type[Config]:
    """Return the record of the configuration of a kind of engine: the tables of all, and those of its own."""
    own: dict[str, Any] = dict(kind.tables)
    if kind.plant:
        own["simulation"] = parameters.PLANTS[kind.plant] | None
    tables = [(name, record, _default(record)) for name, record in own.items()]
    said = {"__doc__": f"The configuration of a {kind.name} engine."}
    return make_dataclass(f"{kind.name.capitalize()}Config", tables, bases=(Config,), namespace=said, frozen=True)


def _default(record: Any) -> Any:
    """Return the field of a table that may be left out where every key in it may, or nothing stands for it."""
    if not isinstance(record, type):
        return field(default=None)
    needed = any(item.default is MISSING and item.default_factory is MISSING for item in fields(record))
    return field() if needed else field(default_factory=record)


def load_config(path: Path) -> tuple[Config, str]:
    """Return the configuration in a TOML file, and the file's text; raises UsageError for what cannot be read or cannot be."""
    text = read_text(path)
    return config_of(text, path), text


def config_of(text: str, path: Path) -> Config:
    """Return the configuration in a text, for example the one that a result keeps; `path` names it in errors."""
    document = parse(text, path)
    name = document.get("air_path", registry.usual_engine().name)
    if not isinstance(name, str) or name not in registry.ENGINES:
        raise UsageError(f"{path}: air_path = {name!r}, expected one of {', '.join(map(repr, registry.ENGINES))}")
    kind = registry.ENGINES[name]
    config = convert(path, document, record_of(kind), f"configs/{kind.example}")
    if config.schema != SCHEMA:
        raise UsageError(
            f"{path}: schema = {config.schema}, expected {SCHEMA}; the file is for another version of lpvobs"
        )
    wanted = {axis.channel for axis in config.engine_path().axes}
    if set(config.map) != wanted:
        raise UsageError(f"{path}: [map] has the axes {sorted(config.map)}, expected exactly {sorted(wanted)}")
    _check_names(path, config)
    if (nodes := config.grid().size) > MOST_NODES:
        raise UsageError(f"{path}: [map] has {nodes} nodes, expected at most {MOST_NODES}; choose larger steps")
    return config


@dataclass(frozen=True)
class _Surroundings:
    """The tables of an effects file whose keys are fixed; those of an effect depend on its identifier."""

    surface: parameters.ErrorSurface | None = None
    auxiliary: road.Auxiliary | None = None


@dataclass(frozen=True)
class Effects(_Surroundings):
    """What `simulate --effects` reads: another surface of the sensor's error, what has happened to engine and sensors, a road."""

    injected: tuple[disturbances.Injected, ...] = ()


def load_effects(path: Path) -> Effects:
    """Return the effects in a TOML file; raises as `load_config` does."""
    document = parse(read_text(path), path)
    if not document:
        raise UsageError(
            f"{path}: expected a table [surface], [[effect]] or [auxiliary], but the file has none of them; see the "
            "examples in configs/effects"
        )
    listed = document.pop("effect", [])
    if not (isinstance(listed, list) and all(isinstance(table, dict) for table in listed)):
        raise UsageError(f"{path}: 'effect' is not a list of tables; write each effect under its own [[effect]]")
    effects: list[disturbances.Injected] = []
    for table in listed:
        try:
            effects.append(disturbances.injected_of(table))
        except UsageError as error:
            raise UsageError(f"{path}: effect[{len(effects)}]: {error}") from None
    tables = convert(path, document, _Surroundings, "configs/effects/road.toml")
    return Effects(**vars(tables), injected=tuple(effects))


def _check_names(path: Path, config: Config) -> None:
    """Refuse names that the engine does not have, in the tables whose keys are free."""
    air_path = config.engine_path()
    states, rates = air_path.state_names, air_path.temperature_names
    rho = [name for name in air_path.parameter_names if name not in air_path.rate_names]
    gain, channels, sensor = config.gain, tuple(air_path.channels), air_path.sensor
    sums = [name for pair in gain.nonnegative_sums for name in pair]
    constants = tuple(dict.fromkeys((*air_path.engine_constants(), *air_path.usual_tolerance)))
    for table, found, known, needed in (
        ("estimate.tolerance", config.estimate.tolerance, constants, ()),
        ("gain.outputs", gain.outputs, states, ()),
        ("gain.bounds", gain.bounds, rho, ()),
        ("gain.nonnegative_sums", sums, air_path.parameter_names, ()),
        ("gain.temperatures", gain.temperatures, rates, rates),
        ("published.temperatures", config.published.temperatures, rates, rates),
        ("ekf.process_noise", config.ekf.process_noise, states, states),
        ("ekf.measurement_noise", config.ekf.measurement_noise, (*states, sensor), (*gain.outputs, sensor)),
        ("policies.limits", config.policies.limits, channels, ()),
        ("sensors", config.sensors, channels, ()),
    ):
        for name in found:
            if name not in known:
                raise UsageError(f"{path}: {table}: the name '{name}' is unknown; known names: {', '.join(known)}")
        for name in needed:
            if name not in found:
                raise UsageError(
                    f"{path}: {table}: the name '{name}' is missing; give a value for all of {', '.join(needed)}"
                )
    for name, known_of in config.sensors.items():
        if known_of.pulsation and (name != sensor or config.kind.pulsation is None):
            raise UsageError(
                f"{path}: sensors.{name}.pulsation = {known_of.pulsation:g}: the tool has no model of pulsation for this "
                "sensor; delete the key"
            )
    if len(config.published.x_0) != len(states):
        raise UsageError(
            f"{path}: published.x_0 has {len(config.published.x_0)} values, expected one value for each of {', '.join(states)}"
        )
    if len(set(gain.outputs)) < len(gain.outputs):
        raise UsageError(f"{path}: gain.outputs lists a state twice ({', '.join(gain.outputs)}); list each state once")
