"""Units in which a solver can work, read off the problem itself.

In Pa and rad/s the matrix inequality spans ten decades, and solvers then report nonsense. With x = T z, y = S w and
time counted in 1/rate, T and S are chosen such that the couplings, T^-1 A T / rate and S^-1 C T, are as near to one as
they can be: least squares in their logarithms. Any other units of states and outputs shift those logarithms and are
taken back by the same shift, so the balanced matrices, and with them verdict and gain, do not depend on the units that
the problem came in.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array


@dataclass(frozen=True, eq=False)
class BalancedUnits:
    """Balanced units."""

    states: Array  # (n,) diagonal of T
    outputs: Array  # (r,) diagonal of S
    rate: float  # [1/s]
    # (n, n + r) whether state i is tied, over any number of couplings, to state j (first n columns) or to output j - n.
    # Between parts of a system that are not tied there is no common unit; a gain needs no entries there.
    linked: NDArray[np.bool_]


def balance(A: Array, C: Array) -> BalancedUnits:
    """Return balanced units for A, shape (N, n, n), and C, shape (N, r, n)."""
    # Each entry counts with its largest magnitude over the N vertices.
    largest_A, largest_C = np.abs(A).max(axis=0), np.abs(C).max(axis=0)
    n = len(largest_A)
    first = _units(largest_A, largest_C, 1.0)
    rate = _rate(largest_A * first[:n] / first[:n, None])
    units = _units(largest_A, largest_C, rate)
    return BalancedUnits(units[:n], units[n:], rate, _linked(largest_A, largest_C))


def _rate(largest_A: Array) -> float:
    """Return the plant's fastest rate, the Perron root: no units of the states change it; 1/s where there is none."""
    root = float(np.abs(np.linalg.eigvals(largest_A)).max())
    # A chain of integrators has none (nilpotent), and its computed eigenvalues are rounding, enlarged by the n-th root.
    return root if np.linalg.matrix_power(largest_A, len(largest_A)).any() else 1.0


def _units(largest_A: Array, largest_C: Array, rate: float) -> Array:
    """Return the diagonals of T and S, (n + r,), by least squares; of least norm where a scale is free."""
    r, n = largest_C.shape
    couplings = np.vstack((largest_A / rate, largest_C))
    i, j = np.nonzero(couplings)
    nodes = np.eye(n + r)
    # The row of a state with itself is zero: it asks for nothing.
    logarithms = np.linalg.lstsq(nodes[j] - nodes[i], -np.log(couplings[i, j]), rcond=None)[0]
    return np.asarray(np.exp(logarithms))


def _linked(largest_A: Array, largest_C: Array) -> NDArray[np.bool_]:
    r, n = largest_C.shape
    reach = np.eye(n + r, dtype=bool)
    reach[:, :n] |= np.vstack((largest_A, largest_C)) != 0
    return np.linalg.matrix_power(reach | reach.T, n + r)[:n]
