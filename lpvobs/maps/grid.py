"""The grid of the map (Eq. 8) and bilinear interpolation on it (Eq. 10-23, 34-35).

Numbering: theta stacks p_2 blocks, one a speed, each of p_1 values along the fuel axis, so node (i, j) counted from zero is
theta[j p_1 + i]. The printed Eq. (19) and (21) mix p_1 and p_2 and divide by zero in their last rows; the weights here are
derived from Eq. (10)-(13). Outside the grid the map is held (Eq. 12): the same four weights with eta clipped to [0, 1],
of which one or two remain (cases 1 to 3 of Remark 2).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.records import Array


@dataclass(frozen=True)
class Grid:
    """Nodes of a map over the operating point v = (fuel, speed), in the paper (u_delta, n_e)."""

    fuel: Array  # (p_1,) fuel axis, strictly increasing, in the unit of the engine's `axes`
    speed: Array  # (p_2,) speed axis, strictly increasing, [rpm]

    def __post_init__(self) -> None:
        for name, nodes in (("fuel", self.fuel), ("speed", self.speed)):
            usable = nodes.ndim == 1 and nodes.size >= 2 and np.all(np.isfinite(nodes))
            if not (usable and np.all(np.diff(nodes) > 0)):  # Eq. (8)
                raise ValueError(f"axis {name} needs at least two finite, strictly increasing nodes")

    @property
    def shape(self) -> tuple[int, int]:
        """(p_2, p_1): rows are speeds, as maps are stored."""
        return self.speed.size, self.fuel.size

    @property
    def size(self) -> int:
        """The number of nodes, p = p_1 p_2."""
        return self.speed.size * self.fuel.size

    def interpolate(self, theta: Array, fuel: Array, speed: Array) -> Array:
        """Return Psi(v) theta of Eq. (22), (N,), for theta (p,) or (p_2, p_1); NaN where a node that takes part is."""
        return _interpolate(self.fuel, self.speed, np.ascontiguousarray(theta).reshape(-1), fuel, speed)

    def regressors(self, fuel: Array, speed: Array) -> tuple[NDArray[np.int64], Array]:
        """Return the four node numbers and weights Psi_l of Eq. (34), each of shape (N, 4)."""
        found: tuple[NDArray[np.int64], Array] = _regressors(self.fuel, self.speed, fuel, speed)
        return found


@njit(cache=True, inline="always")
def seek(nodes: Array, value: float, i: int) -> int:
    """Return the interval with value in (node_i, node_i+1], looked for from i on: along a drive it is the same one or the next."""
    while i > 0 and value <= nodes[i]:  # Eq. (14), Eq. (15)
        i -= 1
    while i < nodes.size - 2 and value > nodes[i + 1]:  # Eq. (14), Eq. (15)
        i += 1
    return i


@njit(cache=True, inline="always")
def share(nodes: Array, value: float, i: int) -> float:
    """Return eta of Eq. (35) in interval i, clipped outside the grid."""
    eta: float = (value - nodes[i]) / (nodes[i + 1] - nodes[i])  # Eq. (35)
    return min(max(eta, 0.0), 1.0)  # Eq. (12), Eq. (13)


@njit(cache=True)
def reach(nodes: Array, i: int) -> tuple[float, float, float, float]:
    """Return the values (low, high] for which `seek` stays at interval i, its first node, and the reciprocal of its width."""
    low = nodes[i] if i > 0 else -np.inf
    high = nodes[i + 1] if i < nodes.size - 2 else np.inf
    return low, high, nodes[i], 1.0 / (nodes[i + 1] - nodes[i])


@njit(cache=True)
def local(u_nodes: Array, n_nodes: Array, fuel: float, speed: float, nodes: NDArray[np.int64], weights: Array) -> None:
    """Fill the four node numbers and the weights Psi_l of Eq. (34) for one operating point."""
    i, j = seek(u_nodes, fuel, 0), seek(n_nodes, speed, 0)
    eta_1, eta_2 = share(u_nodes, fuel, i), share(n_nodes, speed, j)
    first = j * u_nodes.size + i  # Eq. (23)
    nodes[0], nodes[1] = first, first + 1
    nodes[2], nodes[3] = first + u_nodes.size, first + u_nodes.size + 1
    weights[0], weights[1] = (1.0 - eta_1) * (1.0 - eta_2), eta_1 * (1.0 - eta_2)  # Eq. (34)
    weights[2], weights[3] = (1.0 - eta_1) * eta_2, eta_1 * eta_2  # Eq. (34)


@njit(cache=True)
def _regressors(u_nodes: Array, n_nodes: Array, fuel: Array, speed: Array):  # type: ignore[no-untyped-def]
    nodes = np.empty((fuel.size, 4), dtype=np.int64)
    weights = np.empty((fuel.size, 4))
    for k in range(fuel.size):
        local(u_nodes, n_nodes, fuel[k], speed[k], nodes[k], weights[k])
    return nodes, weights


@njit(cache=True)
def _interpolate(u_nodes: Array, n_nodes: Array, theta: Array, fuel: Array, speed: Array) -> Array:
    nodes, weights = np.empty(4, dtype=np.int64), np.empty(4)
    values = np.empty(fuel.size)
    for k in range(fuel.size):
        local(u_nodes, n_nodes, fuel[k], speed[k], nodes, weights)
        total = 0.0
        for m in range(4):
            if weights[m] != 0.0:  # a node that takes no part may be unknown
                total += weights[m] * theta[nodes[m]]  # Eq. (22)
        values[k] = total
    return values
