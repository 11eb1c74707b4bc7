"""The problem that the search solves: signals of all logs, balances, unknowns with their priors, and which places are kept back."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery import thresholds
from lpvobs.discovery.courses import Shape, TracedCourse, state
from lpvobs.discovery.map_prior import MapPrior
from lpvobs.discovery.patterns import Patterns, Seeming, beyond_of
from lpvobs.discovery.places import Places, blocks_of_logs, instants_of, kept_back, starts, stretches
from lpvobs.engines.effects import SENSOR, Effect
from lpvobs.engines.followers import with_followers
from lpvobs.engines.residual_model import Level, ResidualModel
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Log


@dataclass(frozen=True, eq=False)
class Problem(Places):
    """Everything that a search does not change: B balances at K places, q unknowns beside the map."""

    model: ResidualModel
    grid: Grid
    # the number of the log, and the level that differs on its day. These unknowns come after those of the engine, the sizes of
    # the patterns after them
    levels: tuple[tuple[int, Level], ...]
    covariance: Array  # (q, q) prior of the engine's unknowns, the levels of the day and the sizes of the patterns
    prior: MapPrior
    clock: Array  # (K,) [s] on the common clock
    # (K,) rising numbers of the stretches that an onset is sought between; none spans two logs
    block: NDArray[np.int64]
    first: NDArray[np.int64]  # (stretches,) the first place of each
    begins: Array  # (stretches,) [s] beginning of each on the clock
    per_coarse: int  # stretches whose sums are taken as independent
    auxiliary: Mapping[str, Array]  # (K,) the logs' own channels that all of them have
    shown: NDArray[np.bool_]  # (B, K) where each balance counts
    used: NDArray[np.bool_]  # (K,) places that fits and choices see
    judged: NDArray[np.bool_]  # (K,) places for the error before and after alone, at a distance from all that are used
    flow: float  # [kg/s] turns a residual in the model's unit into a flow
    wider: Callable[[], "Problem"]  # the same problem, all of it used, seen through windows `WIDER` times as wide
    # (B, K) added to the residual: the difference between an engine learned without the place and the one in use
    offset: Array
    lasting: Array  # (B, K) variance of a sum of model errors over that of as many independent ones; one where there are none
    patterns: Patterns  # what the errors of a healthy engine may look like
    seeming: Seeming = field(default_factory=Seeming)
    # by channel, the derivatives of what a healthy engine leaves by its value and by its rate, (B, K)
    follows: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    left: Array | None = None  # (B, K) beside a healthy drive, what a healthy engine leaves where nothing changes
    # (q, m) beside a healthy drive, combinations of the engine's unknowns: their sizes are the unknowns then
    modes: Array | None = None
    # (m, B, 2K) beside a healthy drive, derivatives of what a healthy engine leaves by these sizes
    learned: Array | None = None
    # (p, p) [s^2/kg^2] beside a healthy drive, its information on the nodes: an error of the map is in what the drive leaves, too
    of_map: Array | None = None
    # whether an instant that is off by more than `OUTLIER` weighs as if it stood there: beside healthy drives, one moment that
    # none of them showed would weigh as much as many
    bounded: bool = False
    held: "tuple[Term, ...]" = ()  # effects that are accounted for with fixed sizes

    @property
    def K(self) -> int:
        """The number of places."""
        return self.block.size

    @property
    def spacing(self) -> float:
        """The usual time between two places [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def spread(self) -> Array:
        """Standard deviation of every unknown beside the map, shape (q,)."""
        return np.sqrt(np.diag(self.covariance))

    def on_days(self, beta: Array) -> Iterator[tuple[int, Level, float]]:
        """Yield the log, the level and its size, of every level of a day."""
        for (log, level), size in zip(self.levels, beta[len(self.model.names) :], strict=False):
            yield log, level, float(size)

    @cached_property
    def columns(self) -> tuple[NDArray[np.bool_], ...]:
        """Which columns of the signals are of each log, shape (C,) for every log."""
        begins, s = self.clock - self.time, self.signals
        first = [begins[self.of_log == log][0] for log in np.unique(self.of_log)]
        return tuple(np.isclose(s.clock - s.time, begin) for begin in first)

    @cached_property
    def by_reading(self) -> Array:
        """Derivative of the residual by the reading of the sensor, zero where a balance does not count, shape (B, K)."""
        found = self.model.by_reading(self.model.constants, self.signals, self.blocks)
        return np.asarray(np.where(self.shown, found, 0.0))

    @cached_property
    def precision(self) -> Array:
        """Inverse of the prior covariance, shape (q, q)."""
        return np.asarray(np.linalg.inv(self.covariance))

    @cached_property
    def precision_with_map(self) -> Array:
        """The same beside the nodes of the map, which come first, shape (p + q, p + q)."""
        P, S = self.prior.precision, self.prior.sensitivity
        P = P if self.of_map is None else P + self.of_map
        # The map does not depend on the levels of another day.
        S = np.hstack([S, np.zeros((S.shape[0], self.spread.size - S.shape[1]))])
        return np.block([[P, -P @ S], [-S.T @ P, S.T @ P @ S + self.precision]])

    @cached_property
    def catalogue(self) -> tuple[Effect, ...]:
        """The effects that the channels of the logs can show."""
        return tuple(e for e in self.model.catalogue if all(channel in self.signals.value for channel in e.needs))

    @property
    def measured(self) -> tuple[str, ...]:
        """The signals that sensors show."""
        return tuple(name for name in self.signals.value if name not in self.model.followers)

    @property
    def carriers(self) -> tuple[Effect, ...]:
        """Those that a logged channel may drive."""
        return tuple(effect for effect in self.catalogue if effect.id in self.model.carriers)

    @property
    def data(self) -> float:
        """The number of independent residuals that fits and choices see."""
        return float(((self.shown & self.used) / self.lasting).sum())

    @property
    def coarse_blocks(self) -> float:
        """The number of stretches whose sums are taken as independent, without those kept back."""
        return float(self.first.size / self.per_coarse * self.used.mean())

    @property
    def coarse(self) -> NDArray[np.int64]:
        """The number of the block of every place whose sums are taken as independent, shape (K,)."""
        return self.block // self.per_coarse

    def by_coarse(self, values: Array) -> Array:
        """Return sums over these blocks of values by stretch."""
        return np.asarray(np.add.reduceat(values, np.arange(0, values.size, self.per_coarse)))

    def absorbs(self, effect: Effect) -> bool:
        """Return whether the map takes up an effect that acts all the time."""
        return self.prior.free and effect.in_map

    def with_all(self) -> "Problem":
        """Return the same with nothing kept back."""
        return replace(self, used=np.ones(self.K, dtype=bool))

    def known_as(self, term: "Term") -> tuple[str, ...]:
        """Return the effects that tell what a healthy engine seems to have of a term: itself, most often.

        Of what follows one input it is the effect that does so, and the shape beside that. What healthy drives do not show is
        known by its place alone.
        """
        names = term.effect.known_as or (term.effect.id,)
        return names if all(name in self.seeming.effects for name in names) else (term.effect.place,)

    def seems(self, term: "Term", information: float, name: str = "") -> float:
        """Return the variance of the size that a healthy engine seems to have of an effect, over that of noise, 1/information.

        `name` is one that the term is known as, the first one by itself. It is at most the multiple of noise that it is on healthy
        drives: what they leave is an error of the balances, and a drive that tells more of an effect is thrown off less by it.
        """
        name = name or self.known_as(term)[0]
        in_place = self.seeming.places.get(term.effect.place, self.seeming.common)
        most = self.seeming.effects.get(name, in_place) * self.data
        size = (self.seeming.whole if term.whole else self.seeming.late).get(name)
        if size is None:
            return most
        share = max(float(np.mean(term.acts(self.clock))), 1.0 / self.K)
        return float(beyond_of(*map(np.asarray, (information, size, share, most))))

    def over_columns(self, values: Array) -> Array:
        """Return values at places, shape (K,), for every column of the signals; a sample has that of its block."""
        if self.blocks is None:
            return np.tile(values, 2)
        place = np.searchsorted(self.blocks.edges[1], self.blocks.clock, side="left")
        return np.asarray(values[np.minimum(place, self.K - 1)])

    def over_all(self, name: str, usual: float = np.nan) -> Array:
        """Return a channel of the engine, or one of the logs' own, by column of the signals; a usual value where logs lack it."""
        if name in self.signals.value:
            return self.signals[name]
        values = self.auxiliary.get(name, np.full(self.K, np.nan))
        return self.over_columns(np.where(np.isfinite(values), values, usual))

    def inputs(self) -> dict[str, Array]:
        """Return every channel but the sensor under test, at the places."""
        return {name: self.along(name) for name in self.measured if name != SENSOR}

    def channel(self, name: str) -> Array:
        """Return a channel of the engine, or one of the logs' own, at the places, shape (K,)."""
        return self.auxiliary[name] if name in self.auxiliary else self.along(name)

    def state(self, name: str, tau: float) -> Array:
        """Return the first-order response to a channel at the places, at rest in the beginning of every log, shape (K,)."""
        x, logs = self.channel(name), np.unique(self.of_log)
        return np.concatenate([state(self.clock[on], x[on], tau) for on in (self.of_log == i for i in logs)])

    def share(self, course: TracedCourse) -> Array:
        """Return the share of a course at the places, shape (K,)."""
        if course.in_time:
            return course.share(self.clock, self.channel, float(self.clock[-1]))
        x, logs = self.channel(course.input), (self.of_log == i for i in np.unique(self.of_log))
        return np.concatenate([course.share(self.clock[on], {course.input: x[on]}.__getitem__, np.inf) for on in logs])

    def mean(self, values: Array) -> Array:
        """Return values by column of the signals at the places: means over blocks, or of both views, shape (K,)."""
        return self.blocks.mean(values) if self.blocks is not None else 0.5 * (values[: self.K] + values[self.K :])

    def along(self, channel: str) -> Array:
        """Return a channel at the places, shape (K,)."""
        values = self.signals[channel]
        return self.blocks.mean(values) if self.blocks is not None else values[: self.K]


@dataclass(frozen=True)
class Term:
    """An effect with the size and the interval of the clock that it has in a model, and places it is confined to, (K,)."""

    effect: Effect
    size: float
    begin: float = -np.inf
    end: float = np.inf
    only: NDArray[np.bool_] | None = field(default=None, compare=False)
    course: TracedCourse | None = None  # what `only` or the effect already contain
    curve: Shape | None = field(default=None, compare=False)  # what the effect already contains

    @property
    def whole(self) -> bool:
        """Whether it neither begins nor ends inside the logs, whatever its course."""
        return not (np.isfinite(self.begin) or np.isfinite(self.end))

    @property
    def edges(self) -> tuple[float, ...]:
        """When it begins and ends on the clock, infinite where it does not; of an effect that comes and goes every time."""
        return (self.begin, self.end, *(np.ravel(self.course.intervals) if self.course else ()))

    def acts(self, clock: Array) -> NDArray[np.bool_]:
        """Return at which places it acts, shape (K,)."""
        on = (clock >= self.begin) & (clock < self.end)
        return np.asarray(on if self.only is None else on & self.only, dtype=bool)


def are_apart(one: Term, other: Term) -> bool:
    """Return whether two terms act at different times, farther apart than the error of an onset."""
    return bool(one.end + thresholds.STRETCH < other.begin or other.end + thresholds.STRETCH < one.begin)


def lay_out(
    model: ResidualModel,
    grid: Grid,
    prior: MapPrior,
    logs: Sequence[Log],
    wide: float = 1.0,
    spacing: float = thresholds.SPACING,
) -> Problem:
    """Return the problem of one or more logs; raises DataError if a log has no stretch that is long enough.

    Instants are `spacing` [s] apart, through windows `wide` times as wide as usual.
    """
    model = replace(model, units={name: unit for log in logs for name, unit in log.units.items()} | dict(model.units))
    logs = [with_followers(model.followers, log) for log in logs]
    places = blocks_of_logs(model, logs, wide) if model.blocks else instants_of(model, logs, wide, spacing)
    if not (model.blocks or prior.free):
        s = places.signals
        nodes, weights = grid.regressors(s[model.fuel], s[model.speed])
        places = replace(places, signals=replace(s, error=np.einsum("km,km->k", weights, prior.mean[nodes])))
    length = max(
        thresholds.BLOCK,
        np.ceil(places.time.size * places.step / thresholds.MOST_BLOCKS / thresholds.BLOCK) * thresholds.BLOCK,
    )
    block = stretches(places, length)
    first = np.flatnonzero(np.diff(block, prepend=-1))
    used, judged = kept_back(places)
    times = [log.time[0] + places.time[places.of_log == i] for i, log in enumerate(logs)]
    common = set.intersection(*(set(log.auxiliary) for log in logs))
    clock = places.time + starts(logs)[places.of_log]
    levels = tuple((i, level) for i in range(len(logs)) for level in model.levels)
    deviations = [level.deviation for _, level in levels]
    shown = model.shown(places.signals, places.blocks)
    return Problem(
        model=model,
        grid=grid,
        levels=levels,
        covariance=scipy.linalg.block_diag(model.covariance, np.diag(np.square(deviations))),
        prior=prior,
        **vars(places),
        clock=clock,
        block=block,
        first=first,
        begins=clock[first],
        per_coarse=max(1, round(thresholds.COARSE / length)),
        auxiliary={
            name: np.concatenate([_steadied(log, name, time) for log, time in zip(logs, times, strict=True)])
            for name in sorted(common)
            if all(_usable(log.auxiliary[name]) for log in logs)
        },
        shown=shown,
        used=used,
        judged=judged,
        flow=1.0 if model.unit == "kg/s" else float(np.mean(np.maximum(places.signals[SENSOR], 0.0))),
        wider=lambda: lay_out(model, grid, prior, logs, thresholds.WIDER, spacing).with_all(),
        lasting=np.ones(shown.shape),
        patterns=Patterns((np.zeros((0, shown.shape[1])),) * len(shown)),
        offset=np.zeros(shown.shape) if model.beyond is None else model.beyond(logs, places.signals, places.blocks),
    )


def _usable(values: Array) -> bool:
    known = np.isfinite(values)
    return bool(known.mean() > 0.95 and np.ptp(values[known]) > 0)


def _steadied(log: Log, name: str, time: Array) -> Array:
    known = np.isfinite(log.auxiliary[name])
    at, values = log.time[known], log.auxiliary[name][known]
    if np.unique(values).size <= thresholds.MOST_LEVELS:  # a switch has no value between its levels
        return np.asarray(values[np.clip(np.searchsorted(at, time, side="right") - 1, 0, at.size - 1)])
    return np.interp(time, at, values)
