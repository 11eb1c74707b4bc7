"""An engine as the closed loop sees it: residual = what is not known + effects + noise.

What is not known are the map, the engine's constants or learned curves, and levels of the day, each with a prior. The engine
supplies balances, unknowns and effects; how residuals are laid out and weighted are strategies that it names (`lpvobs.discovery`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.blocks import Blocks
from lpvobs.engines.curves import Nodes
from lpvobs.engines.effects import Effect, Signals
from lpvobs.engines.followers import Follower
from lpvobs.engines.healthy import HealthyErrors
from lpvobs.engines.unknowns import matern
from lpvobs.errors import UsageError
from lpvobs.records import Array, Log


@dataclass(frozen=True)
class Level:
    """What differs from one day to another without being a fault: an unknown of its own for every log."""

    name: str  # a balance, whose level it is, or an effect of the catalogue, of which every day has a little
    unit: str
    # standard deviation between days, in the unit of the balance's residual or of the effect's parameter
    deviation: float


@dataclass(frozen=True)
class DayToDay:
    """The configuration's `[trace]`: differences between days that are no fault."""

    # what may differ from one day to another without being a fault, by the name of a balance or of an effect: standard
    # deviations, in the unit of the balance's residual or of the effect's parameter
    levels: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not all(value > 0 for value in self.levels.values()):
            raise ValueError("every standard deviation in [trace.levels] must be above zero")


def levels_of(day: DayToDay, balances: Sequence[str], unit: str, catalogue: Sequence[Effect]) -> tuple[Level, ...]:
    """Return the levels of a configuration; raises UsageError for a name that is neither a balance nor an effect."""
    units = {effect.id: effect.unit for effect in catalogue} | dict.fromkeys(balances, unit)
    unknown = [name for name in day.levels if name not in units]
    if unknown:
        raise UsageError(
            f"[trace.levels]: '{unknown[0]}' is neither a balance nor an effect; expected one of {', '.join(units)}"
        )
    return tuple(Level(name, units[name], value) for name, value in day.levels.items())


FLAT = 1e3  # [1] Multiple of the length of an axis that a curve does not follow


@dataclass(frozen=True)
class ComponentCurve:
    """A component that may be wrong as a curve: a factor over two of its inputs."""

    id: str  # as in the contract
    carrier: Effect  # the factor, which takes a size per column
    deviation: float  # standard deviation of the factor before any data
    axes: Mapping[str, Nodes]  # both inputs by name, with nodes
    lengths: tuple[float, float]  # over which values are correlated, in the unit of each axis
    # inputs that are no channels, by name: functions of the engine's constants and the channels
    computed: Mapping[str, Callable[[Any, Mapping[str, Array]], Array]] = field(default_factory=dict)

    def inputs(self, constants: Any, x: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the inputs, each of the shape of the channels x."""
        first, second = (self.computed[name](constants, x) if name in self.computed else x[name] for name in self.axes)
        return first, second

    def correlations(self) -> tuple[Array, Array]:
        """Return the correlation of the values at the nodes: of a curve over the first input alone, and of a surface."""
        (along, across), nodes = self.lengths, [axis.values for axis in self.axes.values()]
        return matern(nodes, (along, FLAT * across)), matern(nodes, self.lengths)


@dataclass(frozen=True)
class ResidualModel:
    """The balances of one engine and all that may move them, at K places: instants seen twice (2K columns), or `blocks`."""

    balances: tuple[str, ...]  # B balances
    unit: str  # of the residual: `kg/s`, or `1` for residuals relative to the flow
    channels: tuple[str, ...]  # those that the balances are computed from, the sensor among them
    moving: tuple[str, ...]  # those whose fast changes blur the balances
    fuel: str  # channels of the map's axes
    speed: str
    lacks: tuple[float, ...]  # l sizes of an engine in order
    constants: Any  # the engine's, at the prior mean
    names: tuple[str, ...]  # q unknowns of the engine: relative deviations of constants, or of nodes of learned curves
    covariance: Array  # (q, q) their prior
    with_unknowns: Callable[[Array], Any]  # the constants from deviations of shape (q,)
    # what is left of each balance, shape (B, 2K) or (B, K), from constants, signals and blocks
    imbalances: Callable[[Any, Signals, Blocks | None], Array]
    # derivative of the imbalances by the reading of the sensor, shape (B, K), from constants, signals and blocks
    by_reading: Callable[[Any, Signals, Blocks | None], Array]
    # which balances count where, shape (B, K), from signals and blocks: a channel may be missing, a condition not met
    shown: Callable[[Signals, Blocks | None], NDArray[np.bool_]]
    # what sizes of the engine's lacks add to the flow of each of `LPV` balances, shape (b, N) [kg/s], and to the state
    # equation, shape (n, N), from constants and signals of N samples
    further: Callable[[Any, Signals], tuple[Array, Array]]
    # in the order in which effects are undone: what came last on its way into the log comes first
    catalogue: tuple[Effect, ...]
    # effects of the catalogue that a logged channel may drive; their `apply` takes a size per column, too
    carriers: tuple[str, ...]
    # Whether places are blocks of seconds. Where curves are learned, what is left is model error that lasts for
    # seconds, and a sample says little that its neighbour does not; where constants are known, noise is left, and an
    # instant counts.
    blocks: bool = False
    curves: tuple[ComponentCurve, ...] = ()  # components that may be wrong as a curve
    levels: tuple[Level, ...] = ()
    # derivatives of the imbalances by the last m of the unknowns, shape (m, B, 2K) or (m, B, K), from constants, signals
    # and blocks; difference quotients give the others
    by_unknowns: Callable[[Any, Signals, Blocks | None], Array] | None = None
    adding: int = 0  # how many of the last unknowns are modes of corrections: changes of them add up, others multiply
    # further standard deviation of the residual, shape (B, K), from constants, signals and blocks
    blur: Callable[[Any, Signals, Blocks | None], Array] | None = None
    # what an engine that was learned without each place in turn says beyond this one, shape (B, K), from logs, signals
    # and blocks: what a log has taught fits it better than any other log
    beyond: Callable[[Sequence[Log], Signals, Blocks | None], Array] | None = None
    # how wrong the balances of a healthy engine are, held out; None weights a residual by its own scatter
    healthy: HealthyErrors | None = None
    # how what a healthy engine leaves, shape (B, C), changes with what the engine lacks, from constants, signals and that
    left_with: Callable[[Any, Signals, Array], Array] | None = None
    # signals that the balances read and no sensor shows
    followers: Mapping[str, Follower] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)  # of the channels, and of those that logs have beside them

    @property
    def signals(self) -> tuple[str, ...]:
        """All that the balances are computed from."""
        return (*self.channels, *self.followers)

    @property
    def spread(self) -> Array:
        """Standard deviation of every unknown of the engine, shape (q,)."""
        return np.sqrt(np.diag(self.covariance))

    def effect(self, name: str) -> Effect | None:
        """Return an effect of the catalogue by its identifier, None where there is none."""
        return next((effect for effect in self.catalogue if effect.id == name), None)

    def curve(self, name: str) -> ComponentCurve | None:
        """Return the curve of a component by its identifier, None where there is none."""
        return next((curve for curve in self.curves if curve.id == name), None)

    def restarted(self, deviation: Mapping[str, float], covariance: Array) -> "ResidualModel":
        """Return the model around other values of its unknowns: relative deviations, and their covariance around there, (q, q)."""
        return self.moved(np.array([deviation.get(name, 0.0) for name in self.names]), covariance)

    def moved(self, deviation: Array, covariance: Array) -> "ResidualModel":
        """Return the same from deviations of all unknowns, (q,)."""
        at = self.with_unknowns
        further = {"constants": at(deviation), "with_unknowns": lambda beta: at(self.both(deviation, beta))}
        return replace(self, covariance=covariance, **further)

    def both(self, first: Array, second: Array) -> Array:
        """Return the deviation of the unknowns after two of them, the second counted from the first, shape (q,)."""
        multiplied = (1.0 + first) * (1.0 + second) - 1.0
        return np.where(np.arange(first.size) < first.size - self.adding, multiplied, first + second)
