"""Which further bench points would make the flow known best: the greedy A-optimal choice from feasible ones.

What a map owes to its engine is the flow that the balances agree on. Its variance at every feasible point follows from the
covariance of the engine's unknowns, and so does what a measurement at one of them would leave of it, whatever it reads.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lpvobs.calibration.bench import REFERENCE, Rows
from lpvobs.records import Array

NEGLIGIBLE = 1e-5  # share of the flow that no balance is surer than: it keeps matrices regular


def best_points(rows: Rows, covariance: Array, left: Mapping[str, float], count: int) -> tuple[list[int], list[float]]:
    """Return the points worth most, the best first, and the uncertainty before and after each of them."""
    # `rows` are those of feasible points, `covariance` (q, q) is that of the engine's unknowns, `left` by kind of row the
    # share of the flow that no correction follows. The uncertainty is the root mean square over all points, relative to the
    # flow.
    shares = np.array([left.get(kind.name, 0.0) for kind in rows.kind])[rows.of]
    own = (shares * rows.reference) ** 2
    G = rows.J @ covariance @ rows.J.T
    of_point = {point: np.flatnonzero(rows.point == point) for point in np.unique(rows.point).tolist()}
    whole = np.array([kind.column == REFERENCE for kind in rows.kind])[rows.of]
    balances = {point: where[whole[where]] for point, where in of_point.items()}

    def variance(G: Array) -> float:
        return float(np.mean([_relative(G, own, rows.reference, where) for where in balances.values()]))

    chosen: list[int] = []
    told = [variance(G) ** 0.5]
    for _ in range(min(count, len(of_point))):
        after = partial(_measured, G, rows.error**2 + own)
        costs = {point: variance(after(where)) for point, where in of_point.items() if point not in chosen}
        best = min(costs, key=lambda point: costs[point])
        G = after(of_point[best])
        chosen.append(best)
        told.append(variance(G) ** 0.5)
    return chosen, told


def _relative(G: Array, own: Array, flow: Array, where: NDArray[np.int64]) -> float:
    """Return the variance of the best mixture of a point's balances, over the square of the flow."""
    S = G[np.ix_(where, where)] + np.diag(own[where] + (NEGLIGIBLE * flow[where]) ** 2)
    return float(1.0 / np.linalg.inv(S).sum() / flow[where[0]] ** 2)


def _measured(G: Array, noise: Array, where: NDArray[np.int64]) -> Array:
    """Return the covariance of all flows once some of them are measured."""
    gain = np.linalg.solve(G[np.ix_(where, where)] + np.diag(noise[where]), G[where])
    return np.asarray(G - G[:, where] @ gain)
