"""What has happened to a vehicle, found within the model of `timeline`: a trend, steps, a new sensor with a slope of its own.

Every event has Gaussian terms, so what it adds to the evidence is a determinant and a quadratic form of what the rest has left, at
every day at once. A search on the maps of the periods, as change-point libraries do it, would not know that their errors are shared
through the engine, and has no interval of the day. An event counts when it is more probable than not although `SURPRISE` to one
speaks against it beforehand, and against each day alike.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from lpvobs.records import Array
from lpvobs.tracking.sums import MODES
from lpvobs.tracking.timeline import Event, Fleetwide, Story, Timeline

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
        against = sum(_against(each, vehicle.day.size) for each in events) + np.log(factor)
        tried.append((vehicle.evidence(sizes, events) - against, Story(factor, events)))
    return max(tried, key=lambda item: item[0])[1]


def _against(event: Event, places: int) -> float:
    """Return the logarithm of how improbable an event is beforehand."""
    return float(np.log(SURPRISE) + np.log(places) * (event.kind != "trend"))


def _events(vehicle: Timeline, fleet: Fleetwide) -> tuple[Event, ...]:
    events: tuple[Event, ...] = ()
    days = np.unique(vehicle.day)
    middles = 0.5 * (days[1:] + days[:-1])
    while len(events) < MOST_EVENTS:
        explained = vehicle.explained(fleet, events)
        scored = [(_gain(vehicle, explained, move), move) for move in _moves(events, middles)]
        if not scored:
            break
        gain, best = max(scored, key=lambda item: item[0])
        if gain <= 0.0:
            break
        alike = [
            (g, move[-1].day) for g, move in scored if [each.kind for each in move] == [each.kind for each in best]
        ]
        events += (*best[:-1], _with_interval(best[-1], days, np.array(alike)))
    return events


def _moves(events: Sequence[Event], middles: Array) -> Iterator[tuple[Event, ...]]:
    """Yield what may be added: a trend, a step at any day, a renewal at any day with the trend that it ends."""
    before = () if any(each.kind == "trend" for each in events) else (Event("trend"),)
    if before:
        yield before
    for day in middles.tolist():
        if all(each.day != day for each in events):
            yield (Event("step", day),)
            yield (*before, Event("renewal", day))


def _gain(vehicle: Timeline, explained: tuple[Array, Array], added: Sequence[Event]) -> float:
    """Return what events add to the logarithm of the evidence, less what speaks against them beforehand."""
    R, r = explained
    X = np.kron(vehicle.design(added, vehicle.day), np.eye(MODES))
    A, b = np.eye(X.shape[1]) + X.T @ R @ X, X.T @ r
    against = sum(_against(each, vehicle.day.size) for each in added)
    return float(0.5 * b @ np.linalg.solve(A, b) - 0.5 * np.linalg.slogdet(A)[1] - against)


def _with_interval(event: Event, days: Array, alike: Array) -> Event:
    """Return the event with the days between which `HELD` of the evidence lies, one log to either side."""
    if event.kind == "trend":
        return event
    share = np.exp(alike[:, 0] - alike[:, 0].max())
    order = np.argsort(-share, kind="stable")
    enough = int(np.searchsorted(np.cumsum(share[order]), HELD * share.sum())) + 1
    held = alike[order[:enough], 1]
    return replace(event, earliest=float(days[days < held.min()].max()), latest=float(days[days > held.max()].min()))
