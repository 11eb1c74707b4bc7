"""What every engine offers, so that gain, observer, tracer and report need not know which one they serve."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

import numpy as np

from lpvobs.engines.channels import Channel, Columns, Pulsation, Recorded, Suspects
from lpvobs.engines.constants import scaled
from lpvobs.engines.curves import Knowledge
from lpvobs.engines.effects import SENSOR
from lpvobs.engines.followers import Follower
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.residual_model import ResidualModel
from lpvobs.engines.unknowns import Caution, Component, ComponentMap, Correction, MeasuredPart, Unknowns
from lpvobs.records import Array, Log


@dataclass(frozen=True)
class MapAxis:
    """One input of the error map."""

    channel: str
    unit: str
    meaning: str


SPEED_AXIS = MapAxis("n_e", "rpm", "engine speed")


@dataclass(frozen=True)
class Trajectory:
    """The LPV system of Eq. (24) along N samples, n states, r outputs; fastest with neighbouring samples side by side."""

    # (N, m) the scheduling parameters in the order of `AirPath.parameter_names` (for the diesel rho_1..rho_5, a_1, a_2)
    parameters: Array
    A: Array  # (N, n, n) [1/s and mixed]
    E: Array  # (N, n) known input of the state equation
    C: Array  # (N, r, n) output matrix; the last row, C_2, carries the map
    y: Array  # (N, r) measured outputs y_m; the last, y_m2, is the mass air flow sensor
    # outputs, from the first on, whose row of C is the same for all samples: they cost the observer less time
    steady: int = 0


@dataclass(frozen=True)
class Balances:
    """Independent estimates of the true flow past the sensor, from everything but the sensor."""

    names: tuple[str, ...]  # B balances
    flow: Array  # (B, N) [kg/s]
    slope: Array  # (B, q, N) [kg/s], derivative of each flow by the relative change of each of q uncertain constants


def trajectory_of(
    path: "AirPath", parameters: Sequence[Array], E: Array, log: Log, outputs: Sequence[str]
) -> Trajectory:
    """Return the system that an air path states along a log of N samples, from parameters of shape (N,) each and E (N, n)."""
    A, C = (np.moveaxis(np.array(rows, dtype=float), -1, 0) for rows in path.system(parameters, outputs))
    y = np.column_stack([log[name] for name in (*outputs, path.sensor)])
    return Trajectory(np.stack(parameters).T, A, E, C, y)


class AirPath(Protocol):
    """An engine's air path: what holds for all engines of its kind, and the numbers of one of them.

    What has a value here is that of an engine whose balances need no correction, and whose constants are all configured.
    """

    name: ClassVar[str]  # which engine this is, as in the configuration
    channels: ClassVar[Mapping[str, Channel]]  # needed channels, the sensor under test among them
    smoothed: ClassVar[tuple[str, ...]]  # measured states and temperatures that enter the scheduling parameters
    # of these, those that go through a wider window, too: a steep relation reads them, or their noise counts
    calmed: ClassVar[tuple[str, ...]] = ()
    followers: ClassVar[Mapping[str, Follower]] = {}  # signals that the corrections read and no sensor shows
    balance_names: ClassVar[tuple[str, ...]]  # those of `balances`
    components: ClassVar[tuple[Component, ...]] = ()  # corrections that parts of the engine may need
    measured_parts: ClassVar[tuple[MeasuredPart, ...]] = ()  # flows inside the engine that a bench may measure
    steep: ClassVar[tuple[str, ...]] = ()  # constants in which the flows are far from linear
    volumes: ClassVar[tuple[str, ...]] = ()  # constants that the balances owe what they store to
    cylinder_number: ClassVar[str] = ""  # the constant that is the number of cylinders; empty for an engine without
    component_maps: ClassVar[Mapping[str, ComponentMap]] = {}  # tables of components that others have, by kind
    # inputs of the map: the fuel axis (p_1 nodes), then the speed axis (p_2 nodes)
    axes: ClassVar[tuple[MapAxis, MapAxis]]
    sensor: ClassVar[str] = SENSOR  # the channel of the sensor under test
    state_names: ClassVar[tuple[str, ...]]  # the states x
    parameter_names: ClassVar[tuple[str, ...]]  # the scheduling parameters
    temperature_names: ClassVar[tuple[str, ...]]  # the temperatures that `rate_bounds` takes
    rate_names: ClassVar[tuple[str, ...]]  # the parameters that it gives
    learns: ClassVar[bool] = False  # whether parts of the engine are known only after a healthy log has shown them
    # channels that the loop can do without: it loses balances with them, and says so
    dispensable: ClassVar[tuple[str, ...]] = ()

    engine: Any  # the configuration's `[engine]`

    def __init__(self, engine: Any) -> None:
        """Take the configuration's `[engine]`."""

    @property
    def noisy(self) -> tuple[str, ...]:
        """The channels whose noise stands on both sides of the rows of a map."""
        return (*self.smoothed, self.sensor)

    @property
    def cylinders(self) -> float:
        """Number of cylinders, each of which fills once in two revolutions; 0 for an engine without."""
        return float(self.engine_constants().get(self.cylinder_number, 0.0))

    def engine_constants(self) -> Mapping[str, float]:
        """Return every constant of the engine by name."""

    @property
    def usual_tolerance(self) -> Mapping[str, float]:
        """The engine constants that a balance depends on, and how well one is known of which nothing is said."""

    def rate_bounds(self, temperatures: Mapping[str, tuple[float, float]]) -> Mapping[str, tuple[float, float]]:
        """Return the range of the parameters that depend on temperatures alone, given the range of those [K]."""

    def trajectory(self, log: Log, outputs: Sequence[str], constant: Mapping[str, float] | None = None) -> Trajectory:
        """Return the LPV system along a log; `outputs` names the measured states, the sensor is added last.

        `constant` holds temperatures that the parameters of `rate_bounds` are computed from instead of the log's.
        """

    @staticmethod
    def system(parameters: Sequence[Any], outputs: Sequence[str]) -> tuple[list[list[Any]], list[list[Any]]]:
        """Return A and C as nested lists for parameters of any number type (floats or exact fractions)."""

    def knowledge(self) -> Knowledge | None:
        """Return what was learned; None for an engine that learns nothing, or has not yet."""
        return None

    def knowing(self, known: Knowledge) -> "AirPath":
        """Return the air path with what was learned before."""
        return self

    def deviating(self, deviation: Mapping[str, float]) -> "AirPath":
        """Return the air path with other unknowns of its residual model, by their relative deviations: constants by default."""
        return type(self)(scaled(self.engine, deviation))

    def as_certified(self, deviation: Mapping[str, float]) -> dict[str, float]:
        """Return the deviations that an observer takes: volumes stay, as its gain is certified, since flows are linear in them."""
        return {name: share for name, share in deviation.items() if name not in self.volumes}

    def learned_from(self, logs: Sequence[Log]) -> "AirPath":
        """Return the air path with what it learns of the engine from healthy logs; itself where all is configured."""
        return self

    def states(self, log: Log) -> Array:
        """Return the states along a log as measured, shape (N, n), computed where no sensor shows them."""

    def balances(self, log: Log, rates: Columns, uncertain: Sequence[str], calm: Columns | None = None) -> Balances:
        """Return the redundant flows along a log, given the time derivative of each smoothed channel, and the calmed ones."""

    def corrections(self, log: Log, rates: Columns) -> tuple[Correction, ...]:
        """Return how each of the components moves the balances along a log."""
        return ()

    def stand_ins(self, log: Log) -> Mapping[str, tuple[str, Array]]:
        """Return for channels that a log may lack what they are supposed to read, in words and along the log, shape (N,)."""
        return {}

    def caution(self, log: Log, noise: Columns, spread: float, learned: bool = False) -> Caution:
        """Return how far the balances can be relied on, by default wholly.

        `noise` is the standard deviation that is left of each calmed channel's noise, `spread` that of the relative constants;
        `learned` says whether a calibration knows the engine.
        """
        shape = (len(self.balance_names), len(log))
        return Caution(np.ones(shape), np.zeros(shape))


@dataclass(frozen=True, eq=False)
class Published:
    """A gain as somebody printed it, where it is proven, and what maps came of it."""

    source: str  # where the gain is printed
    # measured states among the outputs, in the order of the columns of L; the sensor comes after them
    outputs: tuple[str, ...]
    L: Array  # (n, r) the gain, [state unit / (output unit s)]
    epsilon: tuple[float, float]  # eps_1, eps_2 of Theorem 1
    # ranges of the scheduling parameters that no temperature gives, in order, by the drive that they were seen on
    bounds: Mapping[str, tuple[tuple[float, float], ...]]
    # a_2, a_1, b_2, b_1, c_2, c_1 of the maps, [kg/s] over the units of the axes, by where they are printed
    surfaces: Mapping[str, tuple[float, ...]]
    remark: str  # what is to be said of these maps beside others
    errors: Mapping[str, float]  # mean relative errors that are printed for maps, by cycle


@dataclass(frozen=True, eq=False)
class EngineKind:
    """All that the rest of the package knows of a kind of engine: its folder exports one of these, the registry lists it."""

    # the LPV system with its channels, states, parameters, balances and map axes, and whether it learns
    air_path: type[AirPath]
    # records of the configuration's tables whose keys are this engine's own: `engine`, and further ones
    tables: Mapping[str, type]
    # under which names foreign recordings hold its channels, beside those that all engines share
    recorded: Callable[[], Mapping[str, Recorded]]
    example: str  # the shipped, commented configuration, a name in `configs`
    # the engine as the closed loop sees it, from the configuration, the air path with what it has learned, the errors
    # of the healthy engine, the digests of the logs that taught it, and what a calibration knows
    residual_model: Callable[[Any, AirPath, HealthyErrors | None, Collection[str], Unknowns | None], ResidualModel]
    # those errors, from the configuration's `[engine]` and healthy logs; for an engine that learns
    errors: Callable[[Any, Sequence[Log]], HealthyErrors] | None = None
    plant: str = ""  # what simulates it, a name in `lpvobs.simulation.parameters`; empty where nothing does
    published: Published | None = None  # a printed gain for it
    # a log by formula, for the self-test: takes the configuration's `[engine]` and the sensor's error [kg/s] as a
    # function of the map's inputs, and returns every channel, `time`, `ref_W_c` and `ref_delta_W_c`
    known_drive: Callable[[Any, Callable[[Array, Array], Array]], Columns] | None = None
    suspects: Suspects = field(default_factory=Suspects)  # what its logs are tried for beyond impossible readings
    pulsation: Pulsation | None = None  # of the sensor under test; None where nothing is known of it
    caveat: str = ""  # what is to be said of every map of it
    # for control units: the numbers by name that `model.c` in the engine's folder reads, from the air path
    in_c: Callable[[Any], Mapping[str, float | Array]] | None = None

    @property
    def name(self) -> str:
        """How configurations, gains and results call it."""
        return self.air_path.name
