"""Maps of vehicles on any day, alone and as members of their type.

What differs from day to day is judged with errors that are new in every window. Errors that come back at the same operating point
are the same every day: they belong to the map, so its own covariance is wider by `Basis.lasting`. A vehicle's map is one of its
type: the type's mean and how vehicles differ (a level, shapes, a gain, every node) are found from all of them by restricted
likelihood, and what a vehicle has not driven comes from there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.maps.quadratic import NODES
from lpvobs.observer.prior import swept
from lpvobs.records import Array, Item
from lpvobs.tracking.sums import MODES
from lpvobs.tracking.timeline import CHANGE, Event, Fleetwide, Timeline, by_mode

SIZES = (0.0, 0.1, 0.3, 1.0, 3.0)
"""Over `CHANGE`, and over `NODE`: what is tried of how vehicles differ."""
NODE, LEAST = 1e-3, 0.01
"""[kg/s] of a node by itself, and the least share of it: vehicles of a kind are never alike to a bit."""


@dataclass(frozen=True)
class OverTime:
    """Maps of a vehicle at N days, of the p nodes that it has driven; days differ by k modes, so their covariances do."""

    nodes: NDArray[np.int64]  # (p,) their numbers
    mean: Array  # (N, p) [kg/s]
    last: Array  # (p, p) [kg^2/s^2] of the errors of the last day
    variance: Array  # (N, p) [kg^2/s^2] of the errors of each day
    modes: Array  # (p, k) [kg/s]
    # (N, k, p) [kg/s]: `modes` times this is what the covariance of each day with the last has beyond `last`
    beyond: Array


def alone(vehicle: Timeline, story: tuple[Fleetwide, Sequence[Event]], day: Array) -> OverTime:
    """Return the maps of a vehicle at some days.

    The map of a day is P (r - C m) + Phi c(day), where P, r and C are inverse and right side of map and engine, and their products
    with the modes; c, and m, which has a part of each log's own day beside it, are one Gaussian process. With S = P + B W^T,
    W = P C^T K, B = P C^T - W R and L the covariance of c(day) with m, the covariance of two days is
    S + Phi (Q - L R L'^T) Phi^T - Phi L B^T - B L'^T Phi^T.
    """
    basis, on = vehicle.basis, vehicle.sums.columns[:-2]
    nodes = on[on < basis.flow.size]
    M = vehicle.sums.products / basis.lasting
    A = M[:-2, :-2] + np.diag(np.where(on < basis.flow.size, vehicle.prior_map**-2, 1.0))
    P = scipy.linalg.solve(A, np.eye(on.size, nodes.size), assume_a="pos").T  # the nodes are the first columns
    C = np.concatenate([CHANGE[:, None] * log.modes[:, on] for log in vehicle.logs]) / basis.lasting
    R, r = vehicle.explained(*story)
    modes, answers = basis.modes(basis.flow)[nodes] * CHANGE, P @ C.T
    W = answers @ vehicle.prior(*story)
    B = answers - W @ R
    S = P[:, : nodes.size] + B @ W.T
    over_time, k = vehicle.over_time(*story, day, day), np.eye(MODES)
    L = vehicle.process(*story, day, vehicle.day).reshape(day.size, MODES, -1)
    LR, LB = L @ R, L @ B.T  # (N, k, m), (N, k, p)

    def between(one: int, other: int) -> Array:
        return np.asarray(over_time[one, other] * k - LR[one] @ L[other].T)

    beyond = np.stack([(between(i, -1) - between(-1, -1)) @ modes.T - LB[i] + LB[-1] for i in range(day.size)])
    own = [np.sum(modes @ between(i, i) * modes, 1) - 2.0 * np.sum(modes * LB[i].T, 1) for i in range(day.size)]
    across = modes @ LB[-1]
    last = S + modes @ between(-1, -1) @ modes.T - across - across.T
    mean = P @ M[:-2, -1] - W @ r + (L @ r) @ modes.T
    return OverTime(nodes, mean, 0.5 * (last + last.T), np.diag(S) + np.stack(own), modes, beyond)


@dataclass(frozen=True)
class TypeMap:
    """The map that vehicles of a kind have in common, and how they differ from it."""

    kind: Annotated[str, Item("1", "kind of engine", name="type")]
    mean: Annotated[Array, Item("kg/s", "map of the type", ("node",), gaps=True)]
    covariance: Annotated[Array, Item("kg^2/s^2", "covariance of the errors of the type's map", NODES)]
    between: Annotated[
        Array, Item("kg^2/s^2", "covariance of the differences between a vehicle's map and the type's map", NODES)
    ]


def type_map(kind: str, maps: Sequence[OverTime], Phi: Array, prior: float) -> TypeMap:
    """Return the map of a type from the last map of each of its vehicles."""
    pools = cache(partial(_Pool, maps, Phi, prior))

    def pooled(level: float, shape: float, gain: float, node: float) -> tuple[Array, float, tuple[Array, Array, float]]:
        d, own = CHANGE * by_mode(level, shape, gain), NODE * max(node, LEAST)
        return d, own, pools(own).with_modes(d)

    sizes = swept([1.0] * 4, [SIZES] * 4 if len(maps) > 2 else (), lambda sizes: -pooled(*sizes)[2][2])
    d, own, (information, right, _) = pooled(*sizes)
    covariance, modes = np.linalg.inv(information), Phi * d
    between = modes @ modes.T + own**2 * np.eye(len(Phi))
    return TypeMap(kind, np.asarray(covariance @ right), np.asarray(covariance), np.asarray(between))


class _Pool:
    """Vehicles whose nodes differ by `node` [kg/s] each, all put together; modes come on top by the matrix inversion lemma."""

    def __init__(self, maps: Sequence[OverTime], Phi: Array, prior: float, node: float):
        self.node, p = node, len(Phi)
        self.information, self.right, self.likelihood = prior**-2 * np.eye(p), np.zeros(p), 0.0
        across = np.zeros((len(maps), p, MODES))
        inner, weighed = np.zeros((len(maps), MODES, MODES)), np.zeros((len(maps), MODES))
        for each, its, own, right in zip(maps, across, inner, weighed, strict=True):
            on, mean = each.nodes, each.mean[-1]
            root = scipy.linalg.cho_factor(each.last + node**2 * np.eye(on.size), lower=True)
            inverse = scipy.linalg.cho_solve(root, np.eye(on.size))
            self.information[np.ix_(on, on)] += inverse
            self.right[on] += inverse @ mean
            self.likelihood -= float(0.5 * mean @ inverse @ mean + np.log(np.diag(root[0])).sum())
            its[on] = inverse @ Phi[on]
            own[:], right[:] = Phi[on].T @ its[on], its[on].T @ mean
        self.members = across.transpose(0, 2, 1), inner, weighed[..., None]

    def with_modes(self, d: Array) -> tuple[Array, Array, float]:
        """Return information and right side of the type's map, and the logarithm of the restricted likelihood."""
        across, inner, weighed = self.members
        roots = np.linalg.cholesky(np.eye(MODES) + d[:, None] * inner * d)
        solved = np.linalg.solve(roots, d[:, None] * np.concatenate([across, weighed], axis=2))
        Z, fits = solved[..., :-1].reshape(-1, len(self.right)), solved[..., -1].ravel()
        information, right = self.information - Z.T @ Z, self.right - Z.T @ fits
        root = np.linalg.cholesky(information)
        fit = scipy.linalg.solve_triangular(root, right, lower=True)
        determinants = float(sum(np.log(np.einsum("...ii->...i", each)).sum() for each in (roots, root)))
        return information, right, self.likelihood + 0.5 * float(fits @ fits + fit @ fit) - determinants
