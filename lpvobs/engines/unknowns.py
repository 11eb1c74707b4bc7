"""What is not exactly known of an engine, with its prior: constants, and corrections of its components.

A correction is a factor or a flow over the component's own inputs: a sum of hat functions between nodes, as in `engines.curves`,
whose values at the nodes are correlated over a length of each axis (Matern 3/2). One without axes is a single number.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.engines.constants import Within
from lpvobs.engines.curves import Nodes, Points, spans
from lpvobs.records import Array, Item

NEGLIGIBLE = 1e-3
"""Standard deviation below which a mode of the corrections is left out: it moves no flow by more than a thousandth."""


@dataclass(frozen=True, eq=False)
class Component:
    """A correction that a component of the engine may need."""

    name: str
    unit: str
    meaning: str
    deviation: float  # standard deviation of the correction before any data, at amplitude one
    # components of a group share the amplitude that is found from the data; empty where the deviation is what it is
    group: str = ""
    axes: Mapping[str, Nodes] = field(default_factory=dict)  # inputs by name; none for a single number
    lengths: tuple[float, ...] = ()  # over which values are correlated, in the unit of each axis

    @cached_property
    def size(self) -> int:
        """Number of its values."""
        return int(np.prod([axis.values.size for axis in self.axes.values()], dtype=int))

    def names(self) -> tuple[str, ...]:
        """Return a name for each value: that of the component, with the numbers of its nodes."""
        shape = [axis.values.size for axis in self.axes.values()]
        return tuple(self.name + "".join(f"[{i}]" for i in place) for place in np.ndindex(*shape))

    def correlation(self) -> Array:
        """Return the correlation of its values, shape (size, size)."""
        return matern([axis.values for axis in self.axes.values()], self.lengths)


def matern(axes: Sequence[Array], lengths: Sequence[float]) -> Array:
    """Return the correlation of values at all nodes of some axes, row by row: the product of Matern 3/2 over the axes."""
    total = np.ones((1, 1))
    for nodes, length in zip(axes, lengths, strict=True):
        away = np.sqrt(3.0) * np.abs(nodes[:, None] - nodes) / length
        total = np.kron(total, (1.0 + away) * np.exp(-away))
    return total


def places_of(components: Sequence[Component], begin: int = 0) -> dict[str, slice]:
    """Return where the values of each component stand, one after the other."""
    return spans({component.name: component.size for component in components}, begin)


@dataclass(frozen=True)
class Correction:
    """How a component's correction moves a balance at n places."""

    balance: int | tuple[int, ...] | None  # or several; None for every balance: what the sensor itself does
    scale: Array  # (n,) [kg/s per unit of the component], what a correction of one adds to the flow
    points: Points | None = None  # the places between the nodes; None for a single number

    def on(self, count: int) -> list[int]:
        """Return which of so many balances it moves."""
        if self.balance is None:
            return list(range(count))
        return [self.balance] if isinstance(self.balance, int) else list(self.balance)

    def columns(self, size: int) -> Array:
        """Return the derivative of the flow by each value, shape (n, size) [kg/s]."""
        full = np.zeros((self.scale.size, size))
        self.fill(full, np.arange(size))
        return full

    def moved_by(self, values: Array) -> Array:
        """Return the change of the flow by values of shape (size,), shape (n,) [kg/s]."""
        return self.scale * (values[0] if self.points is None else self.points.interpolated(values))

    def fill(self, full: Array, at: NDArray[np.int64]) -> None:
        """Put those that are not zero into an array (n, ...), where `at` (size,) has the column of each value."""
        if self.points is None:
            full[:, at[0]] = self.scale
        else:
            nodes, share = self.points.weights
            full[np.arange(self.scale.size)[:, None], at[nodes]] = share * self.scale[:, None]


@dataclass(frozen=True)
class MeasuredPart:
    """A flow that a bench may measure: that of a balance, or a part of it."""

    name: str
    column: str  # of a bench table
    balance: int  # whose flow it is, or which it lowers as a part
    without: Mapping[str, float]  # values of channels at which the part is away; empty for the whole balance
    relative: float  # standard deviation of its measurement, over the flow
    absolute: float  # [kg/s], added to it
    away: int | None = None  # the balance whose flow it is without the part; None: the same


TABLE_FLOW = "flow"  # the column of a component's points that has the flow


@dataclass(frozen=True)
class ComponentMap:
    """A table of one component, as its supplier or the control unit has it."""

    # the columns that it may have, in one form or another, each with what its numbers can be
    forms: tuple[Mapping[str, Within], ...]
    tolerance: float  # share of the flow that it may be off, where the file says nothing
    part: MeasuredPart  # the flow that it states, in the column `TABLE_FLOW` of its points
    # channels at its points and that flow, from the configuration's `[engine]` and the columns
    points: Callable[[Any, Mapping[str, Array]], Mapping[str, Array]]
    # the flow at such points, from the configuration's `[engine]`; None where it is that of a balance
    flow: Callable[[Any, Mapping[str, Array]], Array] | None = None
    constants: tuple[str, ...] = ()  # that it tells of, and no balance depends on


@dataclass(frozen=True)
class Caution:
    """How much balances can be relied on at n places."""

    # (B, n) weight of the balance, up to 1; 0: it is not used; less where noise or an unknown constant moves a flow by more
    # than its slope
    trust: Array
    bias: Array  # (B, n) [kg/s], mean error that the noise of the signals makes in the flow, by its curvature


@dataclass(frozen=True, eq=False)
class LeftAtNodes:
    """What the formulas of an engine leave at the nodes of the map where the air flow was known: a map of their own errors.

    A later map is compared with it, and both have it from the same formulas, so what those lack is in neither.
    """

    fuel: Annotated[Array, Item("1", "nodes of the map over fuel, in the unit of its axis", ("fuel_node",))]
    speed: Annotated[Array, Item("1", "nodes of the map over speed, in the unit of its axis", ("speed_node",))]
    mean: Annotated[Array, Item("kg/s", "flow left at the nodes of the map, the engine as its mean has it", ("node",))]
    response: Annotated[
        Array, Item("kg/s", "change of it with each unknown, the others being known", ("node", "unknown"))
    ]
    covariance: Annotated[
        Array, Item("kg^2/s^2", "covariance of it where all unknowns are known", ("node", "other_node"))
    ]


@dataclass(frozen=True)
class Unknowns:
    """The unknowns of an engine with their prior."""

    # their relative deviations, from the configured values or from where the engine is linearised, come first
    constants: tuple[str, ...]
    components: tuple[Component, ...]  # whose values follow
    mean: Array  # (q,)
    covariance: Array  # (q, q) at amplitude one of every group
    learned: bool = False  # whether a calibration has found them: amplitudes are part of the covariance then
    at_nodes: LeftAtNodes | None = None  # where logs of known air flow have taught them

    @property
    def names(self) -> tuple[str, ...]:
        """Of all q unknowns."""
        return self.constants + tuple(name for component in self.components for name in component.names())

    @property
    def size(self) -> int:
        """Their number q."""
        return self.mean.size

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The names of the m coordinates of `reduction`."""
        modes = self.reduction.shape[1] - len(self.constants)
        return self.constants + tuple(f"corrections[{i}]" for i in range(modes))

    @cached_property
    def reduction(self) -> Array:
        """What every coordinate moves, shape (q, m): a constant, or a mode of the corrections that a calibration left uncertain."""
        n = len(self.constants)
        if not (self.learned and self.components):
            return np.eye(self.size)[:, :n]
        variance, modes = np.linalg.eigh(self.covariance[n:, n:])
        modes = modes[:, variance > NEGLIGIBLE**2][:, ::-1]
        largest = np.take_along_axis(modes, np.abs(modes).argmax(axis=0)[None], axis=0)  # libraries differ in the sign
        return np.asarray(scipy.linalg.block_diag(np.eye(n), modes * np.sign(largest)))

    def reduced(self, covariance: Array) -> Array:
        """Return a covariance of all unknowns as one of the coordinates, shape (m, m)."""
        return np.asarray(self.reduction.T @ covariance @ self.reduction)

    def deviation(self) -> dict[str, float]:
        """Return the mean of every constant."""
        return dict(zip(self.constants, self.mean.tolist(), strict=False))

    def places(self) -> dict[str, slice]:
        """Return where the values of each component stand."""
        return places_of(self.components, len(self.constants))

    def groups(self) -> tuple[str, ...]:
        """Return the groups whose amplitude is found from the data."""
        if self.learned:
            return ()
        return tuple(dict.fromkeys(component.group for component in self.components if component.group))

    def seen_from(self, point: Mapping[str, float]) -> "Unknowns":
        """Return the unknowns as they are seen from an engine whose constants deviate from the configured ones."""
        mean = self.mean.copy()
        for i, name in enumerate(self.constants):
            mean[i] = (1.0 + mean[i]) / (1.0 + point.get(name, 0.0)) - 1.0
        return replace(self, mean=mean)

    def scaled(self, amplitudes: Sequence[float]) -> Array:
        """Return the covariance at amplitudes of the groups, shape (q, q)."""
        by_group = dict(zip(self.groups(), amplitudes, strict=True))
        own = (np.full(component.size, by_group.get(component.group, 1.0)) for component in self.components)
        factor = np.concatenate([np.ones(len(self.constants)), *own])
        return self.covariance * np.outer(factor, factor)


@dataclass(frozen=True, eq=False)
class LoopUnknowns:
    """What is not known of an engine around the point where it is linearised, in the closed loop."""

    names: tuple[str, ...]  # q: constants, then m modes of the corrections
    covariance: Array  # (q, q)
    values: Array  # (v,) of the corrections there; none where nothing is known beyond the configuration
    modes: Array  # (v, m)


def loop_unknowns(tolerance: Mapping[str, float], known: Unknowns | None) -> LoopUnknowns:
    """Return constants within a tolerance, as if uniform, or as a calibration knows them, with the corrections of components."""
    known = known or Unknowns((), (), np.zeros(0), np.zeros((0, 0)))
    n = len(known.constants)
    others = {name: share for name, share in tolerance.items() if name not in known.constants}
    seen = np.concatenate([1.0 + known.mean[:n], np.ones(known.reduction.shape[1] - n)])
    own = known.reduced(known.covariance) / np.outer(seen, seen)
    covariance = scipy.linalg.block_diag(_uniform(others), own)
    return LoopUnknowns((*others, *known.coordinates), covariance, known.mean[n:], known.reduction[n:, n:])


def _uniform(tolerance: Mapping[str, float]) -> Array:
    return np.diag(np.array(list(tolerance.values())) ** 2 / 3.0)


def unknowns_of(tolerance: Mapping[str, float], components: Sequence[Component]) -> Unknowns:
    """Return the unknowns before any data: constants as if uniform within their tolerance, corrections of mean zero."""
    own = (component.deviation**2 * component.correlation() for component in components)
    covariance = scipy.linalg.block_diag(_uniform(tolerance), *own)
    return Unknowns(tuple(tolerance), tuple(components), np.zeros(len(covariance)), covariance)
