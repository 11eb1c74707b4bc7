"""One vehicle over time: its sums as a Gaussian likelihood of how its map stands on the day of each log.

On the day of log l the map is theta + Phi m_l, theta being the vehicle's map and Phi the modes of `sums`. Map and engine are
the same in all logs; eliminated with their prior, and so the mean of m, they leave for m, stacked over L logs,

    log likelihood = h^T m - m^T G m / 2.

m is a Gaussian process: what differs from day to day (variance by mode), a random walk, and what happens to the vehicle: a trend
from the first log on, a step, a new slope. `Fleetwide` holds the variances, found from all vehicles together.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import Annotated

import numpy as np
import scipy

from lpvobs.records import Array, Item
from lpvobs.tracking.sums import MODES, Basis, TrackedLog, VehicleSums, flow_at_nodes

CHANGE = np.array([1e-3] * (MODES - 1) + [0.05])
"""[kg/s] and of the reading: standard deviation of a change that is worth a name, at once or in a year, before any data. A hot film
is replaced when it reads 5 to 10 % wrong; levels are of the size of the flow's error there at idle."""
YEAR = 365.25
FLAT = 1e-3
"""Information before any log about what all days of a vehicle have in common, beside which one log has about 1e4."""
MOST_VEHICLES = 40
"""By name, that `fleetwide` finds its standard deviations from: more do not move them by the last factor."""


def by_mode(level: float, shape: float, gain: float) -> Array:
    """Return these of every mode, shape (k,)."""
    return np.array([shape] * (MODES - 2) + [level, gain])


@dataclass(frozen=True)
class Fleetwide:
    """Standard deviations that all vehicles share, over those of `CHANGE`."""

    level: Annotated[float, Item("1", "standard deviation of the level between days, in units of 1e-3 kg/s")]
    shape: Annotated[float, Item("1", "standard deviation of each shape between days, in units of 1e-3 kg/s")]
    gain: Annotated[float, Item("1", "standard deviation of the gain between days, in units of 0.05")]
    walk: Annotated[
        float,
        Item(
            "1", "standard deviation of every mode after a year of random walk, in the units of level, shape and gain"
        ),
    ]

    def uneasy(self, factor: float) -> "Fleetwide":
        """Return them for a vehicle whose days differ more than those of others."""
        return replace(self, level=factor * self.level, shape=factor * self.shape, gain=factor * self.gain)

    @property
    def daily(self) -> Array:
        """Variance of every mode between days, shape (k,)."""
        return np.asarray(by_mode(self.level, self.shape, self.gain) ** 2)


@dataclass(frozen=True)
class Event:
    """What happens to a vehicle: a `trend` from the first log, day 0, on, a `step`, or a `renewal`, a step to another slope."""

    kind: str
    day: float = 0.0  # [years]
    earliest: float = 0.0  # 90 % of the evidence lie between
    latest: float = 0.0

    def slopes(self) -> Array:
        """Return the slope of each term at the end."""
        return np.array({"trend": [1.0], "step": [0.0], "renewal": [0.0, 1.0]}[self.kind])


def terms_of(kind: str, since: Array, day: Array) -> Array:
    """Return the terms of events since some days [years] on others, shape (..., N, 1) or (..., N, 2)."""
    after = (day >= since[..., None]).astype(float)
    slope = after * (day - since[..., None])
    return np.stack({"trend": [slope], "step": [after], "renewal": [after, slope]}[kind], axis=-1)


class Driven:
    """Where a vehicle drives, and what level, gain and shape of a change of the map are there."""

    def __init__(self, basis: Basis, sums: VehicleSums):
        p = basis.flow.size
        seen = sums.whole(basis.size)[:p]
        self.flow = flow_at_nodes(seen[:, :p], seen[:, -2], basis.flow)  # (p,) [kg/s]
        self.weight = np.diag(seen) / np.trace(seen[:, :p])
        read = self.flow + basis.error
        x = read - self.weight @ read
        bend = x**2 - self.weight @ x**2 - (self.weight @ x**3) / (self.weight @ x**2) * x
        B = np.column_stack([np.ones(p), x, bend / np.sqrt(self.weight @ bend**2)])
        self.aspects = np.linalg.solve(B.T * self.weight @ B, B.T * self.weight)  # (3, p)
        self.reported = self.aspects @ basis.modes(self.flow) * CHANGE  # (3, k)


@dataclass(frozen=True, eq=False)
class Timeline:
    """The likelihood of a vehicle with L logs, and what it is made of; days in years since the first log, modes in `CHANGE`."""

    sums: VehicleSums  # of its logs
    basis: Basis
    prior_map: float  # [kg/s], standard deviation of a node before any log
    logs: tuple[TrackedLog, ...]  # by date
    day: Array  # (L,)
    G: Array  # (L k, L k)
    h: Array  # (L k,)

    @cached_property
    def driven(self) -> Driven:
        """Where it drives."""
        return Driven(self.basis, self.sums)

    def design(self, events: Sequence[Event], day: Array) -> Array:
        """Return what each term of the events is on some days, shape (N, terms)."""
        terms = (terms_of(event.kind, np.array(event.day), day) for event in events)
        return np.column_stack([np.zeros((day.size, 0)), *terms])

    def over_time(self, fleet: Fleetwide, events: Sequence[Event], day: Array, other: Array) -> Array:
        """Return the covariance between days of all that lasts in a mode, shape (N, M)."""
        walked = fleet.walk**2 * np.minimum.outer(day, other)
        return np.asarray(walked + self.design(events, day) @ self.design(events, other).T)

    def process(self, fleet: Fleetwide, events: Sequence[Event], day: Array, other: Array) -> Array:
        """Return it for all modes, shape (N k, M k)."""
        return np.asarray(np.kron(self.over_time(fleet, events, day, other), np.eye(MODES)))

    def prior(self, fleet: Fleetwide, events: Sequence[Event]) -> Array:
        """Return the covariance of m."""
        return self.process(fleet, events, self.day, self.day) + np.diag(np.tile(fleet.daily, self.day.size))

    def evidence(self, fleet: Fleetwide, events: Sequence[Event] = ()) -> float:
        """Return the logarithm of the marginal likelihood, up to what no prior changes.

        With K = F F^T and C C^T = I + F^T G F it is |C^-1 F^T h|^2 / 2 - log|C|.
        """
        root, size, turned = self._factored(fleet, (*events,))
        fit = scipy.linalg.solve_triangular(root, size * turned[:, -1], lower=True, check_finite=False)
        return float(0.5 * fit @ fit - np.log(np.diag(root)).sum())

    def explained(self, fleet: Fleetwide, events: Sequence[Event]) -> tuple[Array, Array]:
        """Return information and right side for what comes on top of a prior: R = (I + G K)^-1 G and (I + G K)^-1 h.

        With Y = C^-1 F^T G and y = C^-1 F^T h they are G - Y^T Y and h - Y^T y.
        """
        root, size, turned = self._factored(fleet, (*events,))
        found = scipy.linalg.solve_triangular(root, size[:, None] * turned, lower=True, check_finite=False)
        Y = found[:, :-1]
        return self.G - Y.T @ Y, self.h - Y.T @ found[:, -1]

    @lru_cache(maxsize=1)  # noqa: B019 what an event explains and its evidence are asked for one after the other
    def _factored(self, fleet: Fleetwide, events: tuple[Event, ...]) -> tuple[Array, Array, Array]:
        """Return C, by mode the diagonal of D in F = V D, and V^T G and V^T h beside each other; see `_turned`."""
        variances, turned, inner = self._turned(fleet.uneasy(0.0), events)  # which leaves the walk
        size = np.sqrt(np.add.outer(fleet.daily, variances)).ravel()
        root = np.linalg.cholesky(np.eye(size.size) + size[:, None] * inner * size)
        return np.asarray(root), size, turned

    @lru_cache(maxsize=MOST_VEHICLES)  # noqa: B019 the search asks all vehicles in turn about the same events and walk
    def _turned(self, walk: Fleetwide, events: tuple[Event, ...]) -> tuple[Array, Array, Array]:
        """Return the variances of what lasts along its axes V, (L,), V^T G and V^T h beside each other, and V^T G V, by mode.

        What lasts is the same in all modes, and what passes turns with it, so the axes stay while its sizes change.
        """
        L, k = self.day.size, MODES
        variances, V = np.linalg.eigh(self.over_time(walk, events, self.day, self.day))
        rows = (V.T @ self.G.reshape(L, -1)).reshape(L, k, L, k)
        inner = (V.T @ rows.transpose(2, 0, 1, 3).reshape(L, -1)).reshape(L, L, k, k).transpose(2, 1, 3, 0)
        right = (V.T @ self.h.reshape(L, k)).T.reshape(-1, 1)
        turned = np.concatenate([rows.transpose(1, 0, 2, 3).reshape(self.G.shape), right], axis=1)
        return np.maximum(variances, 0.0), turned, inner.reshape(self.G.shape)


def vehicle_of(sums: VehicleSums, logs: Iterable[TrackedLog], basis: Basis, prior_map: float) -> Timeline:
    """Return the likelihood of a vehicle over time, from its sums and its own of the logs of a fleet."""
    own = (log for log in logs if log.vehicle == sums.vehicle)
    by_date = sorted(own, key=lambda log: (log.date, log.sha256))
    on = sums.columns[:-2]
    A = sums.products[:-2, :-2] + np.diag(np.where(on < basis.flow.size, prior_map**-2, 1.0))
    modes = CHANGE[:, None] * np.stack([log.modes for log in by_date])
    across = modes[:, :, on].reshape(-1, on.size)
    right = np.column_stack([across.T, sums.products[:-2, -1]])
    found = scipy.linalg.solve_triangular(np.linalg.cholesky(A), right, lower=True, check_finite=False)
    G = -found[:, :-1].T @ found[:, :-1]
    for i, log in enumerate(by_date):
        at = slice(i * MODES, (i + 1) * MODES)
        G[at, at] += CHANGE[:, None] * log.own * CHANGE
    h = modes[:, :, -1].ravel() - found[:, :-1].T @ found[:, -1]
    day = np.array([log.date for log in by_date])
    common = np.tile(np.eye(MODES), (day.size, 1))  # is the vehicle's map
    onto = np.linalg.solve(common.T @ G @ common + FLAT * np.eye(MODES), common.T @ np.column_stack([G, h]))
    G, h = G - G @ common @ onto[:, :-1], h - G @ common @ onto[:, -1]
    return Timeline(sums, basis, prior_map, tuple(by_date), (day - day[0]) / YEAR, 0.5 * (G + G.T), h)


START = Fleetwide(level=0.03, shape=0.03, gain=0.03, walk=0.03)
FACTORS = (3.0, 3.0, 1.7, 1.3)
"""By which the standard deviations are moved up and down, one after the other, as long as the likelihood grows."""
LEAST = 1e-3
"""Below it a standard deviation is none."""


@dataclass(frozen=True)
class Story:
    """What has happened to a vehicle, and how much more than those of others its days differ."""

    factor: float = 1.0
    events: tuple[Event, ...] = ()


def fleetwide(start: Fleetwide, vehicles: Mapping[Timeline, Story]) -> Fleetwide:
    """Return the standard deviations of the largest marginal likelihood, given what has happened to each vehicle."""
    by_name = sorted(vehicles, key=lambda each: each.sums.vehicle)
    chosen = [each for each in by_name if each.day.size > 2][:MOST_VEHICLES]

    @cache
    def likelihood(sizes: Fleetwide) -> float:
        return sum(each.evidence(sizes.uneasy(vehicles[each].factor), vehicles[each].events) for each in chosen)

    best, height = start, likelihood(start)
    for factor in FACTORS:
        for name in vars(start):
            for by in (factor, 1.0 / factor):
                tried = replace(best, **{name: max(getattr(best, name) * by, LEAST)})
                if (reached := likelihood(tried)) > height:
                    best, height = tried, reached
                    break
    return best
