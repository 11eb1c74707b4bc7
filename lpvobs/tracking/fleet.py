"""A fleet: what its stored sums say of every vehicle, its trend and changes, its maps, and of the type."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lpvobs.maps.excitation import of_cells, plan
from lpvobs.maps.grid import Grid
from lpvobs.records import Array, Item
from lpvobs.tracking.changes import Detectable, history, power_of
from lpvobs.tracking.maps import OverTime, TypeMap, alone, type_map
from lpvobs.tracking.sums import MODES, Basis, TrackedLog, VehicleSums
from lpvobs.tracking.timeline import START, YEAR, Event, Fleetwide, Story, Timeline, fleetwide, vehicle_of

ROUNDS = 2
"""Between what has happened to each vehicle and the variances of all; a third changes nothing."""
MONTH = YEAR / 12.0
STANDS_OUT = 3.0
"""Standard deviations, of its own errors and of how vehicles differ, beyond which a vehicle is not like its type."""
LEAST = 0.002
"""Of the mean flow: what comes in a year or at once and is less is no news; a hot film repeats its reading no better."""
LACK = 0.02
"""Of a change, standard deviation of what modes cannot say: trends of simulated sensors that drifted by 8 % were 1 to 2 % off."""
UNITS = "kg/s, 1, kg/s"
ASPECTS = ("aspect",)
Aspects = tuple[float, float, float]
"""Level [kg/s], gain, shape [kg/s]."""


@dataclass(frozen=True)
class Standing:
    """How a vehicle stands; the trend is that of its last part, without steps."""

    vehicle: Annotated[str, Item("1", "vehicle")]
    type: Annotated[str, Item("1", "kind of engine")]
    logs: Annotated[int, Item("1", "number of the vehicle's logs")]
    first: Annotated[float, Item("d", "date of the first log, days since 1970-01-01")]
    last: Annotated[float, Item("d", "date of the last log, days since 1970-01-01")]
    verdict: Annotated[str, Item("1", "verdict on the map: steady, drifts, changed, or changed and drifts")]
    trend: Annotated[Aspects, Item(UNITS, "change of the map in a month", ASPECTS)]
    trend_error: Annotated[Aspects, Item(UNITS, "standard error of the trend", ASPECTS)]
    unlike: Annotated[
        float,
        Item("1", "difference between the mean of its map and the mean of its type's map, in standard deviations"),
    ]

    @property
    def stands_out(self) -> bool:
        """Whether it drifts, has changed, or is unlike its type."""
        return self.verdict != "steady" or abs(self.unlike) > STANDS_OUT


@dataclass(frozen=True)
class MapChange:
    """A change of a vehicle's map at once."""

    vehicle: Annotated[str, Item("1", "vehicle")]
    kind: Annotated[str, Item("1", "kind of change: step; or renewal, a step to another trend, as with a new sensor")]
    date: Annotated[float, Item("d", "date of the change, days since 1970-01-01")]
    earliest: Annotated[float, Item("d", "earliest date in the 90 % interval")]
    latest: Annotated[float, Item("d", "latest date in the 90 % interval")]
    size: Annotated[Aspects, Item(UNITS, "change of the map", ASPECTS)]
    size_error: Annotated[Aspects, Item(UNITS, "standard error of the change", ASPECTS)]


@dataclass(frozen=True)
class PeriodMap:
    """The map of a vehicle in a period in which it was driven."""

    vehicle: Annotated[str, Item("1", "vehicle")]
    period: Annotated[str, Item("1", "period")]
    theta: Annotated[Array, Item("kg/s", "error of the mass air flow sensor", ("node",), "delta_W_c", gaps=True)]
    standard_error: Annotated[Array, Item("kg/s", "standard error of delta_W_c", ("node",), gaps=True)]


@dataclass(frozen=True)
class NextCell:
    """A cell that a vehicle should visit next."""

    vehicle: Annotated[str, Item("1", "vehicle")]
    speed: Annotated[float, Item("1", "speed at the middle of the cell, in the unit of the axis")]
    fuel: Annotated[float, Item("1", "fuel at the middle of the cell, in the unit of the axis")]
    seconds: Annotated[float, Item("s", "time to drive in the cell")]


@dataclass(frozen=True)
class Tracked:
    """What is known of a fleet."""

    sizes: Annotated[Fleetwide, Item()]
    types: Annotated[tuple[TypeMap, ...], Item(axes=("type",), name="types")]
    vehicles: Annotated[tuple[Standing, ...], Item(axes=("vehicle",), name="vehicles")]  # by name
    changes: Annotated[tuple[MapChange, ...], Item(axes=("change",), name="changes")]
    maps: Annotated[tuple[PeriodMap, ...], Item(axes=("map",), name="maps")]
    cells: Annotated[tuple[NextCell, ...], Item(axes=("cell",), name="next")]
    power: Annotated[tuple[Detectable, ...], Item(axes=("log_count",), name="power")] = ()  # by number of logs

    def worst_first(self) -> tuple[Standing, ...]:
        """Return the vehicles, those that stand out first, by how far their maps have moved."""
        moved = {each.vehicle: abs(each.trend[0]) * (each.last - each.first) / MONTH for each in self.vehicles}
        for change in self.changes:
            moved[change.vehicle] += abs(change.size[0])
        return tuple(sorted(self.vehicles, key=lambda v: (not v.stands_out, v.verdict == "steady", -moved[v.vehicle])))


@dataclass(frozen=True)
class Fleet:
    """All that the vehicles of a fleet share."""

    grid: Grid
    least: float  # [s] of excitation from which a node counts as driven
    periods: Mapping[str, str]  # by the digest of a log
    sizes: Fleetwide

    def at(self, story: Story) -> tuple[Fleetwide, tuple[Event, ...]]:
        """Return how much the days of a vehicle differ, and what has happened to it."""
        return self.sizes.uneasy(story.factor), story.events

    def sizes_of(self, vehicle: Timeline, story: Story) -> list[tuple[Aspects, Aspects]]:
        """Return level, gain and shape of the change in a month, then of each event at once, with their standard errors."""
        R, r, reported = *vehicle.explained(*self.at(story)), vehicle.driven.reported
        events, design = story.events, vehicle.design(story.events, vehicle.day)
        first = np.cumsum([0, *(each.slopes().size for each in events)])
        slopes = np.concatenate([each.slopes() for each in events]) / 12.0
        found = []
        for of in (slopes, *np.eye(first[-1])[first[:-1]]):
            across = np.kron((design @ of)[None], reported)
            covariance = (of @ of) * reported @ reported.T - across @ R @ across.T
            error = np.sqrt(np.maximum(np.diag(covariance), 0.0) + (LACK * (across @ r)) ** 2)
            found.append(((*(across @ r).tolist(),), (*error.tolist(),)))
        return found

    def worth_a_name(self, vehicle: Timeline, story: Story) -> Story:
        """Return a story without events that are small, however sure they are."""
        if not story.events:
            return story
        _, *sizes = self.sizes_of(vehicle, story)
        least = LEAST * vehicle.driven.weight @ vehicle.driven.flow
        large = [max(abs(size[0]), abs(size[2])) > least for size, _ in sizes]
        return replace(story, events=tuple(compress(story.events, large)))

    def part(self, vehicle: Timeline, story: Story, unlike: float) -> tuple[Standing, list[MapChange]]:
        """Return how a vehicle stands and has changed."""
        name, events = vehicle.sums.vehicle, story.events
        kinds = {each.kind for each in events}
        with_trend = story if "trend" in kinds else replace(story, events=(*events, Event("trend")))
        trend, *changes = self.sizes_of(vehicle, with_trend)
        begin, last = (vehicle.logs[i].date for i in (0, -1))
        found = []
        for each, size in zip(events, changes, strict=False):
            if each.kind != "trend":
                date, earliest, latest = (begin + YEAR * day for day in (each.day, each.earliest, each.latest))
                found.append(MapChange(name, each.kind, date, earliest, latest, *size))
        words = ["changed"] * bool(kinds - {"trend"}) + ["drifts"] * ("trend" in kinds and "renewal" not in kinds)
        verdict = " and ".join(words) or "steady"
        return Standing(name, vehicle.sums.kind, len(vehicle.logs), begin, last, verdict, *trend, unlike), found

    def middles(self, vehicle: Timeline, names: Sequence[str]) -> Array:
        """Return the middle of each of some periods in which a vehicle was driven, shape (N,), in its days."""
        periods = np.array([self.periods[log.sha256] for log in vehicle.logs])
        return np.array([vehicle.day[periods == name].mean() for name in names])

    def as_member(self, vehicle: Timeline, own: OverTime, kind: TypeMap) -> tuple[Array, Array, float]:
        """Return maps and their standard errors at all nodes, shape (N, p), and how unlike the type the last one is."""
        on, last = own.nodes, own.last
        mean, covariance, onto = self._with_type(own, kind)
        moved, added = covariance[np.ix_(on, on)] - last, mean[on] - own.mean[-1]
        values, errors = (np.tile(each, (own.mean.shape[0], 1)) for each in (mean, np.sqrt(np.diag(covariance))))
        values[:-1, on] = own.mean[:-1] + added + onto @ added @ own.modes.T
        across = onto @ moved  # (N - 1, k, p)
        spread = np.einsum("pa,nab,pb->np", own.modes, across @ onto.transpose(0, 2, 1), own.modes)
        spread += np.diag(moved) + 2.0 * np.einsum("pa,nap->np", own.modes, across)
        errors[:-1, on] = np.sqrt(own.variance[:-1] + spread)
        away, w = own.mean[-1] - kind.mean[on], vehicle.driven.weight[on]
        apart = last + (kind.between + kind.covariance)[np.ix_(on, on)]
        return values, errors, float(w @ away / np.sqrt(w @ apart @ w))

    def _with_type(self, own: OverTime, kind: TypeMap) -> tuple[Array, Array, Array]:
        """Return the last map with its covariance at all nodes, and what moves the modes of earlier days with it, (N - 1, k, p).

        What the type adds to the last map, it adds to all: 1 + modes onto.
        """
        on, apart = own.nodes, kind.between + kind.covariance
        away = np.column_stack([own.mean[-1] - kind.mean[on], apart[on]])
        gain = np.linalg.solve(own.last + apart[np.ix_(on, on)], away)
        mean, covariance = kind.mean + apart[:, on] @ gain[:, 0], apart - apart[:, on] @ gain[:, 1:]
        return mean, covariance, own.beyond[:-1] @ np.linalg.inv(own.last)

    def moved(self, vehicle: Timeline, pair: Sequence[str], kind: TypeMap) -> tuple[NDArray[np.int64], Array, Array]:
        """Return p nodes that drives inform, a vehicle's maps there in two periods, and the covariance of their difference.

        Shapes are (p,), (2, p) and (p, p). With `alone`, c(b) - c(a) has the covariance
        K(b, b) - 2 K(b, a) + K(a, a) - (L(b) - L(a)) R (L(b) - L(a))^T, and moves with what the type says of the last map.
        """
        story = self.worth_a_name(vehicle, history(vehicle, self.sizes))
        at, last = self.at(story), self.periods[vehicle.logs[-1].sha256]
        day = self.middles(vehicle, (*pair, last))
        own = alone(vehicle, at, day)
        known = of_cells(self.grid, vehicle.sums.gram).nodes()[own.nodes] >= self.least
        on, Phi = own.nodes[known], own.modes[known]
        values = self.as_member(vehicle, own, kind)[0][:2, on]
        _, covariance, onto = self._with_type(own, kind)
        K = vehicle.over_time(*at, day[:2], day[:2])
        L = vehicle.process(*at, day[:2], vehicle.day).reshape(2, MODES, -1)
        L, onto = L[1] - L[0], onto[1] - onto[0]
        told = onto @ (covariance[np.ix_(own.nodes, own.nodes)] - own.last) @ onto.T
        modes = (K[0, 0] - 2.0 * K[0, 1] + K[1, 1]) * np.eye(MODES) - L @ vehicle.explained(*at)[0] @ L.T + told
        lack = LACK * (values[1] - values[0])
        return on, values, Phi @ modes @ Phi.T + np.outer(lack, lack)

    def visit(self, vehicle: Timeline, error: Array) -> Iterator[NextCell]:
        """Yield what a vehicle should drive next."""
        seen = of_cells(self.grid, vehicle.sums.gram)
        supported = (seen.nodes() >= self.least).reshape(self.grid.shape)
        found = plan(self.grid, supported, seen.cells(), np.diag(error**2), error.reshape(self.grid.shape))
        if found is None:
            return
        for j, i in found.cells:
            speed, fuel = (float(axis[k : k + 2].mean()) for axis, k in ((self.grid.speed, j), (self.grid.fuel, i)))
            yield NextCell(vehicle.sums.vehicle, speed, fuel, float(found.time[j, i]))


def track(
    grid: Grid,
    basis: Basis,
    sums: Sequence[VehicleSums],
    logs: Sequence[TrackedLog],
    periods: Mapping[str, str],
    prior: float,
    least: float,
) -> Tracked:
    """Return what is known of a fleet from its stored sums; `periods` are by the digest of a log, `prior` as in `Timeline`."""
    vehicles = [vehicle_of(each, logs, basis, prior) for each in sums]
    fleet = Fleet(grid, least, periods, START)
    for last in range(ROUNDS + 1):
        found = {vehicle: history(vehicle, fleet.sizes) for vehicle in vehicles}
        stories = {vehicle: fleet.worth_a_name(vehicle, story) for vehicle, story in found.items()}
        sizes = fleet.sizes if last == ROUNDS else fleetwide(fleet.sizes, stories)
        if sizes == fleet.sizes:
            break
        fleet = replace(fleet, sizes=sizes)
    driven_in = {vehicle: list(dict.fromkeys(periods[log.sha256] for log in vehicle.logs)) for vehicle in vehicles}
    own, types = {}, {}
    for vehicle, names in driven_in.items():
        own[vehicle] = alone(vehicle, fleet.at(stories[vehicle]), fleet.middles(vehicle, names))
    for kind in sorted({each.kind for each in sums}):
        members = [maps for vehicle, maps in own.items() if vehicle.sums.kind == kind]
        types[kind] = type_map(kind, members, basis.modes(basis.flow), prior)
    standings, changes, maps, cells = list[Standing](), list[MapChange](), list[PeriodMap](), list[NextCell]()
    for vehicle, over_time in own.items():
        values, errors, unlike = fleet.as_member(vehicle, over_time, types[vehicle.sums.kind])
        standing, changed = fleet.part(vehicle, stories[vehicle], unlike)
        standings.append(standing)
        changes += changed
        maps += map(partial(PeriodMap, vehicle.sums.vehicle), driven_in[vehicle], values, errors)
        cells += fleet.visit(vehicle, errors[-1])
    told = (tuple(standings), tuple(changes), tuple(maps), tuple(cells))
    return Tracked(fleet.sizes, tuple(types.values()), *told, power_of(vehicles, fleet.sizes))
