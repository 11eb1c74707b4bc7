"""What has happened to a vehicle, found within the model of `timeline`: a trend, steps, a new sensor with a slope of its own.

Every event has Gaussian terms, so what it adds to the evidence is a determinant and a quadratic form of what the rest has left, at
every day at once. A search on the maps of the periods, as change-point libraries do it, would not know that their errors are shared
through the engine, and has no interval of the day. An event counts when it is more probable than not although `SURPRISE` to one
speaks against it beforehand, and against each day alike.

`power_of` turns this round: how large a change is found nine times out of ten. What an event of size d adds is
`b^T (I + S)^-1 b / 2 - log|I + S| / 2` with `b ~ N(S d, S)`; twice the first term is a weighted sum of noncentral chi-squares, and
its mean and variance tell. It must be found beside days that differ as much as `UNEASY` allows, for else these would explain it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from lpvobs.records import Array, Item
from lpvobs.tracking.sums import MODES
from lpvobs.tracking.timeline import CHANGE, FLAT, MOST_VEHICLES, YEAR, Event, Fleetwide, Story, Timeline, terms_of

SURPRISE = 1000.0
"""To one: one healthy vehicle of a thousand may be accused by chance."""
MOST_EVENTS = 5
HELD = 0.9
UNEASY = (1.0, 2.0, 4.0)
"""Times more than those of other vehicles the days of one may differ: else its scatter would be taken for changes."""


def history(vehicle: Timeline, fleet: Fleetwide) -> Story:
    """Return what has happened to a vehicle, the most evident first, and whether its days differ more than those of others."""
    tried = []
    for factor in UNEASY:
        sizes = fleet.uneasy(factor)
        events = _events(vehicle, sizes)
        against = sum(_improbable(each, vehicle.day.size) for each in events) + np.log(factor)
        tried.append((vehicle.evidence(sizes, events) - against, Story(factor, events)))
    return max(tried, key=lambda item: item[0])[1]


def _improbable(event: Event, places: int) -> float:
    """Return the logarithm of how improbable an event is beforehand."""
    return float(np.log(SURPRISE) + np.log(places) * (event.kind != "trend"))


def _events(vehicle: Timeline, fleet: Fleetwide) -> tuple[Event, ...]:
    events: tuple[Event, ...] = ()
    days = np.unique(vehicle.day)
    middles = 0.5 * (days[1:] + days[:-1])
    while len(events) < MOST_EVENTS:
        free = np.setdiff1d(middles, [each.day for each in events])
        explained = vehicle.explained(fleet, events)
        scored = [(move, _gains(vehicle, explained, *move)) for move in _moves(events, free)]
        if not scored:
            break
        (before, kind, since), gains = max(scored, key=lambda item: item[1].max())
        best = int(np.argmax(gains))
        if gains[best] <= 0.0:
            break
        events += (*before, _with_interval(Event(kind, float(since[best])), days, np.column_stack([gains, since])))
    return events


def _moves(events: Sequence[Event], free: Array) -> Iterator[tuple[tuple[Event, ...], str, Array]]:
    """Yield what may be added: a trend, a step at any free day, a renewal at any free day with the trend that it ends.

    Each has the events that come first, and the kind of the last with the days on which it may be.
    """
    before = () if any(each.kind == "trend" for each in events) else (Event("trend"),)
    if before:
        yield (), "trend", np.zeros(1)
    if free.size:
        yield (), "step", free
        yield before, "renewal", free


def _gains(
    vehicle: Timeline, explained: tuple[Array, Array], before: Sequence[Event], kind: str, since: Array
) -> Array:
    """Return what an event adds on each day to the logarithm of the evidence, less what speaks against it beforehand."""
    L, day = vehicle.day.size, vehicle.day
    R, r = explained[0].reshape(L, MODES, L, MODES), explained[1].reshape(L, MODES)
    first = np.broadcast_to(vehicle.design(before, day), (since.size, L, sum(each.slopes().size for each in before)))
    F = np.concatenate([first, terms_of(kind, since, day)], axis=-1)  # (days, L, terms)
    size = F.shape[2] * MODES
    half = np.tensordot(F, R, (1, 0)).transpose(0, 1, 2, 4, 3).reshape(since.size, -1, L)  # (days, ..., L)
    A = (half @ F).reshape(-1, F.shape[2], MODES, MODES, F.shape[2]).transpose(0, 1, 2, 4, 3)
    A = A.reshape(-1, size, size) + np.eye(size)
    b = np.einsum("mlt,la->mta", F, r).reshape(-1, size, 1)
    root = np.linalg.cholesky(A)
    fit = np.linalg.solve(root, b)[..., 0]
    against = sum(_improbable(each, L) for each in (*before, Event(kind)))
    return np.asarray(0.5 * (fit**2).sum(1) - np.log(np.diagonal(root, axis1=1, axis2=2)).sum(1) - against)


def _with_interval(event: Event, days: Array, alike: Array) -> Event:
    """Return the event with the days between which `HELD` of the evidence lies, one log to either side."""
    if event.kind == "trend":
        return event
    share = np.exp(alike[:, 0] - alike[:, 0].max())
    order = np.argsort(-share, kind="stable")
    enough = int(np.searchsorted(np.cumsum(share[order]), HELD * share.sum())) + 1
    held = alike[order[:enough], 1]
    return replace(event, earliest=float(days[days < held.min()].max()), latest=float(days[days > held.max()].min()))


LOGS = (6, 12, 24, 48)
QUANTILE = 1.2816
"""Of the normal distribution, that nine of ten are below."""


@dataclass(frozen=True)
class Detectable:
    """What is found nine times out of ten in so many logs of a vehicle, as a share of the reading."""

    logs: Annotated[int, Item("1", "number of logs of the vehicle", name="log_count")]
    days: Annotated[float, Item("d", "time between the first and the last log")]
    drift: Annotated[float, Item("1", "smallest trend of the gain that is found, as change in a month")]
    step: Annotated[float, Item("1", "smallest step of the gain that is found, half-way between first and last log")]


def power_of(vehicles: Sequence[Timeline], sizes: Fleetwide) -> tuple[Detectable, ...]:
    """Return what the middle one of the vehicles with so many logs shows in the first of them; nothing where none has."""
    found = []
    for count in LOGS:
        begun = [_first(each, count) for each in vehicles if each.day.size >= count and each.day[count - 1] > 0.0]
        if begun:
            shown = [(each.day[-1] * YEAR, *_least(each, sizes)) for each in begun[:MOST_VEHICLES]]
            found.append(Detectable(count, *np.median(shown, axis=0).tolist()))
    return tuple(found)


def _first(vehicle: Timeline, count: int) -> Timeline:
    """Return a vehicle with its first logs, whose mean is unknown; its map counts as known as it is after all of them."""
    G, common = vehicle.G[: count * MODES, : count * MODES], np.tile(np.eye(MODES), (count, 1))
    onto = np.linalg.solve(common.T @ G @ common + FLAT * np.eye(MODES), common.T @ G)
    G = G - G @ common @ onto
    return replace(vehicle, logs=vehicle.logs[:count], day=vehicle.day[:count], G=G, h=np.zeros(len(G)))


def _least(vehicle: Timeline, sizes: Fleetwide) -> Iterator[float]:
    """Yield the smallest change of the gain that is found nine times out of ten, in a month of a trend, and at once half-way."""
    R, _ = vehicle.explained(sizes.uneasy(UNEASY[-1]), ())
    middle = vehicle.day.size // 2
    half_way = Event("step", float(vehicle.day[middle - 1 : middle + 1].mean()))
    for event, months in ((Event("trend"), 12.0), (half_way, 1.0)):
        X = np.kron(vehicle.design((event,), vehicle.day), np.eye(CHANGE.size))
        s, axes = np.linalg.eigh(X.T @ R @ X)
        s = np.maximum(s, 0.0)
        weights = s / (1.0 + s)
        beyond = 2.0 * _improbable(event, vehicle.day.size) + float(np.log1p(s).sum() - weights.sum())
        rise, spread = (float(weights**k @ (s * axes[-1] ** 2)) for k in (1, 2))  # by the square of the size
        # rise x - beyond = q sqrt(2 |w|^2 + 4 spread x), solved for x
        half = (beyond * rise + 2.0 * QUANTILE**2 * spread) / rise**2
        x = half + np.sqrt(half**2 - (beyond**2 - 2.0 * QUANTILE**2 * float(weights @ weights)) / rise**2)
        yield float(CHANGE[-1] * np.sqrt(x)) / months
