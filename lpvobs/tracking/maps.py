"""Maps of vehicles on any day, alone and as members of their type.

What differs from day to day is judged with errors that are new in every window. Errors that come back at the same operating point
are the same every day: they belong to the map, so its own covariance is wider by `Basis.lasting`. A vehicle's map is one of its
type: the type's mean and how vehicles differ (a level, shapes, a gain, every node) are found from all of them by restricted
likelihood, and what a vehicle has not driven comes from there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array, Item
from lpvobs.tracking.sums import MODES, Basis, VehicleSums
from lpvobs.tracking.timeline import CHANGE, Event, Fleetwide, Timeline

SIZES = (0.0, 0.1, 0.3, 1.0, 3.0)
"""Over `CHANGE`, and over 1 g/s of a node: what is tried of how vehicles differ."""
SWEEPS = 2


@dataclass(frozen=True)
class OverTime:
    """Maps of a vehicle at N days, of the p nodes that it has driven."""

    nodes: NDArray[np.int64]  # (p,) their numbers
    mean: Array  # (N, p) [kg/s]
    covariance: Array  # (N, p, p) [kg^2/s^2] of the errors of each day
    with_last: Array  # (N, p, p) of the errors of each day with those of the last


def alone(
    vehicle: Timeline,
    sums: VehicleSums,
    basis: Basis,
    prior: float,
    story: tuple[Fleetwide, Sequence[Event]],
    day: Array,
) -> OverTime:
    """Return the maps of a vehicle at some days.

    The map of a day is P (r - C m) + Phi c(day), where P, r and C are inverse and right side of map and engine, and their products
    with the modes; c, and m, which has a part of each log's own day beside it, are one Gaussian process.
    """
    p, on = basis.flow.size, sums.columns[:-2]
    nodes = on[on < p]
    M = sums.whole(basis.size) / basis.lasting
    A = M[np.ix_(on, on)] + np.diag(np.where(on < p, prior**-2, 1.0))
    P = np.linalg.inv(A)[: nodes.size]
    C = np.concatenate([CHANGE[:, None] * log.modes[:, on] for log in vehicle.logs]) / basis.lasting
    R, r = vehicle.explained(*story)
    own, answers = basis.modes(basis.flow)[nodes] * CHANGE, P @ C.T
    fixed, last = P @ M[on, -1], day[-1:]
    with_m = answers @ vehicle.prior(*story)  # of the part that all days share

    def of(when: Array) -> tuple[Array, Array]:
        """Return the covariance of the map of a day with m, and that of the process with m."""
        lasting = vehicle.process(*story, when, vehicle.day)
        return own @ lasting - with_m, lasting

    (to_last, last_process), found = of(last), []
    for k in range(day.size):
        to_m, process = of(day[k : k + 1])
        both = []
        for when, other, its in ((day[k : k + 1], to_m, process), (last, to_last, last_process)):
            prior_of = own @ vehicle.process(*story, day[k : k + 1], when) @ own.T - own @ process @ answers.T
            prior_of += answers @ (with_m.T - its.T @ own.T)
            both.append(P[:, : nodes.size] + prior_of - to_m @ R @ other.T)
        found.append((fixed + to_m @ r, *both))
    return OverTime(nodes, *(np.stack(each) for each in zip(*found, strict=True)))


@dataclass(frozen=True)
class TypeMap:
    """The map that vehicles of a kind have in common, and how they differ from it."""

    kind: Annotated[str, Item("1", "kind of engine", name="type")]
    mean: Annotated[Array, Item("kg/s", "map of the type", ("node",), gaps=True)]
    covariance: Annotated[Array, Item("kg^2/s^2", "of its errors", ("node", "other_node"))]
    between: Annotated[Array, Item("kg^2/s^2", "covariance of a vehicle's map about it", ("node", "other_node"))]


def type_map(kind: str, maps: Sequence[OverTime], Phi: Array, prior: float) -> TypeMap:
    """Return the map of a type from the last map of each of its vehicles."""
    seen = [(each.nodes, each.mean[-1], each.covariance[-1]) for each in maps]
    sizes = dict.fromkeys(("level", "shape", "gain", "node"), 1.0)

    def between(sizes: Mapping[str, float]) -> Array:
        modes = CHANGE * np.array([sizes["shape"]] * (MODES - 2) + [sizes["level"], sizes["gain"]])
        return np.asarray((Phi * modes**2) @ Phi.T) + (1e-3 * max(sizes["node"], 0.01)) ** 2 * np.eye(Phi.shape[0])

    for _ in range(SWEEPS if len(seen) > 2 else 0):
        for name in sizes:
            tried = ({**sizes, name: size} for size in SIZES)
            sizes = max(tried, key=lambda sizes: _pooled(seen, between(sizes), prior)[2])
    information, right, _ = _pooled(seen, between(sizes), prior)
    covariance = np.linalg.inv(information)
    return TypeMap(kind, np.asarray(covariance @ right), np.asarray(covariance), between(sizes))


def _pooled(
    seen: Sequence[tuple[NDArray[np.int64], Array, Array]], between: Array, prior: float
) -> tuple[Array, Array, float]:
    """Return information and right side of the type's map, and the logarithm of the restricted likelihood."""
    information, right, total = prior**-2 * np.eye(between.shape[0]), np.zeros(between.shape[0]), 0.0
    for nodes, mean, covariance in seen:
        full = covariance + between[np.ix_(nodes, nodes)]
        inverse = np.linalg.inv(full)
        information[np.ix_(nodes, nodes)] += inverse
        right[nodes] += inverse @ mean
        total -= float(0.5 * mean @ inverse @ mean + np.log(np.diag(np.linalg.cholesky(full))).sum())
    total += float(0.5 * right @ np.linalg.solve(information, right))
    return information, right, total - float(np.log(np.diag(np.linalg.cholesky(information))).sum())
