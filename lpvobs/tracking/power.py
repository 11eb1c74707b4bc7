"""What a fleet's own sums can show: the drift and the step that are found nine times out of ten, by the number of logs.

A vehicle of usual logs at the usual pace is put together from the mean products of all logs. What an event adds to the evidence is
`b^T (I + S)^-1 b / 2 - log|I + S| / 2` with `b ~ N(S d, S)` for an event of size d, so twice the first term is a weighted sum of
noncentral chi-squares; its mean and variance say how large a change of the gain must be. It must be found beside days that differ
as much as `UNEASY` allows, for else these would explain it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from lpvobs.records import Item
from lpvobs.tracking.changes import UNEASY, improbable
from lpvobs.tracking.sums import Basis, TrackedLog, VehicleSums
from lpvobs.tracking.timeline import CHANGE, Event, Fleetwide, Timeline, vehicle_of

LOGS = (6, 12, 24, 48)
QUANTILE = 1.2816
"""Of the normal distribution, that nine of ten are below."""


@dataclass(frozen=True)
class Detectable:
    """What is found nine times out of ten in so many logs of a vehicle, as a share of the reading."""

    logs: Annotated[int, Item("1", "logs of a vehicle", name="log_count")]
    days: Annotated[float, Item("d", "between the first and the last, at the usual pace of the fleet")]
    drift: Annotated[float, Item("1", "change of the gain in a month, as a trend from the first log on")]
    step: Annotated[float, Item("1", "change of the gain at once, half-way")]


def power_of(
    sums: Sequence[VehicleSums], logs: Sequence[Sequence[TrackedLog]], basis: Basis, prior: float, sizes: Fleetwide
) -> tuple[Detectable, ...]:
    """Return what is found by number of logs; nothing where no vehicle has two logs on different days."""
    every = [log for its in logs for log in its]
    apart = np.concatenate([np.diff(sorted(log.date for log in its)) for its in logs])
    if not apart.any():
        return ()
    pace = float(apart.mean())
    usual = replace(
        every[0], modes=np.mean([log.modes for log in every], axis=0), own=np.mean([log.own for log in every], axis=0)
    )
    mean = np.sum([each.whole(basis.size) for each in sums], axis=0) / len(every)
    on = np.flatnonzero(np.diag(mean))
    found = []
    for count in LOGS:
        own = replace(sums[0], columns=on, products=count * mean[np.ix_(on, on)])
        vehicle = vehicle_of(own, [replace(usual, date=pace * i) for i in range(count)], basis, prior)
        middle = float(vehicle.day[count // 2 - 1 : count // 2 + 1].mean())
        drift, step = (_least(vehicle, sizes, Event(*each)) for each in (("trend",), ("step", middle)))
        found.append(Detectable(count, pace * (count - 1), drift / 12.0, step))
    return tuple(found)


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
