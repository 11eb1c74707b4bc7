"""What a fleet's own sums can show: the drift and the step that are found nine times out of ten, by the number of logs.

What an event adds to the evidence is `b^T (I + S)^-1 b / 2 - log|I + S| / 2` with `b ~ N(S d, S)` for an event of size d, so twice
the first term is a weighted sum of noncentral chi-squares; its mean and variance say how large a change of the gain must be. It
must be found beside days that differ as much as `UNEASY` allows, for else these would explain it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from lpvobs.records import Item
from lpvobs.tracking.changes import UNEASY, improbable
from lpvobs.tracking.sums import MODES
from lpvobs.tracking.timeline import CHANGE, FLAT, MOST_VEHICLES, YEAR, Event, Fleetwide, Timeline

LOGS = (6, 12, 24, 48)
QUANTILE = 1.2816
"""Of the normal distribution, that nine of ten are below."""


@dataclass(frozen=True)
class Detectable:
    """What is found nine times out of ten in so many logs of a vehicle, as a share of the reading."""

    logs: Annotated[int, Item("1", "logs of a vehicle", name="log_count")]
    days: Annotated[float, Item("d", "between the first and the last")]
    drift: Annotated[float, Item("1", "change of the gain in a month, as a trend from the first log on")]
    step: Annotated[float, Item("1", "change of the gain at once, half-way")]


def power_of(vehicles: Sequence[Timeline], sizes: Fleetwide) -> tuple[Detectable, ...]:
    """Return what the middle one of the vehicles with so many logs shows in the first of them; nothing where none has."""
    found = []
    for count in LOGS:
        begun = [_first(each, count) for each in vehicles if each.day.size >= count and each.day[count - 1] > 0.0]
        if begun:
            shown = [
                (each.day[-1] * YEAR, _least(each, sizes, Event("trend")) / 12.0, _least(each, sizes, _halfway(each)))
                for each in begun[:MOST_VEHICLES]
            ]
            found.append(Detectable(count, *np.median(shown, axis=0).tolist()))
    return tuple(found)


def _first(vehicle: Timeline, count: int) -> Timeline:
    """Return a vehicle with its first logs, whose mean is unknown; its map counts as known as it is after all of them."""
    G, common = vehicle.G[: count * MODES, : count * MODES], np.tile(np.eye(MODES), (count, 1))
    onto = np.linalg.solve(common.T @ G @ common + FLAT * np.eye(MODES), common.T @ G)
    G = G - G @ common @ onto
    return replace(vehicle, logs=vehicle.logs[:count], day=vehicle.day[:count], G=G, h=np.zeros(len(G)))


def _halfway(vehicle: Timeline) -> Event:
    middle = vehicle.day.size // 2
    return Event("step", float(vehicle.day[middle - 1 : middle + 1].mean()))


def _least(vehicle: Timeline, sizes: Fleetwide, event: Event) -> float:
    """Return the smallest change of the gain by an event that is found nine times out of ten."""
    R, _ = vehicle.explained(sizes.uneasy(UNEASY[-1]), ())
    X = np.kron(vehicle.design((event,), vehicle.day), np.eye(CHANGE.size))
    s, axes = np.linalg.eigh(X.T @ R @ X)
    s = np.maximum(s, 0.0)
    weights = s / (1.0 + s)
    beyond = 2.0 * improbable(event, vehicle.day.size) + float(np.log1p(s).sum() - weights.sum())
    rise, spread = (float(weights**k @ (s * axes[-1] ** 2)) for k in (1, 2))  # by the square of the size
    # rise x - beyond = q sqrt(2 |w|^2 + 4 spread x), solved for x
    half = (beyond * rise + 2.0 * QUANTILE**2 * spread) / rise**2
    x = half + np.sqrt(half**2 - (beyond**2 - 2.0 * QUANTILE**2 * float(weights @ weights)) / rise**2)
    return float(CHANGE[-1] * np.sqrt(x))
