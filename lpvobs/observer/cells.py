"""What a drive leaves behind in each cell of the map: sums that do not depend on what is concluded from them later.

Everything that the default method needs of a log is a sum over its samples that knows the cell but neither the map nor the weights
of the balances: weights and densities are the same all over a cell, so they multiply the sums afterwards, and a residual about a
map over a visit to a cell is the integral of z less that of Psi times the four nodes. One pass over the log, in the order of time,
fills them; memory does not grow with the log, and since each sample is added to what stood there before, cutting the log into
pieces changes no bit.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lpvobs.maps.grid import Grid, seek, share
from lpvobs.maps.quadratic import COEFFICIENTS
from lpvobs.records import Array

LONGEST_VISIT = 2.0
"""[s]; a longer stay in a cell counts as several visits."""


class CellSums(NamedTuple):
    """Sums over the samples of a log in each cell, cells numbered row by row; B balances, q constants, four nodes.

    Integrals are sums of a value times the time that its sample stands for; z is sensor minus balance [kg/s].

    Attributes
    ----------
    gram : ndarray, shape (cells, 4, 4)
        [s], integral of Psi^T Psi.
    right : ndarray, shape (cells, B, 4)
        Integral of z Psi.
    slope : ndarray, shape (cells, B, q, 4)
        Integral of the slope of each balance by each constant times Psi.
    terms : ndarray, shape (cells, 6, 4)
        Integral of the terms of Eq. (37) times Psi.
    visit_power : ndarray, shape (cells, B, B)
        Over visits, the products of the integrals of z.
    visit_cross : ndarray, shape (cells, B, 4)
        Over visits, integral of z times integral of Psi.
    visit_gram : ndarray, shape (cells, 4, 4)
        Over visits, the products of the integrals of Psi.
    visits : ndarray, shape (cells,)
        Number of visits.
    """

    gram: Array
    right: Array
    slope: Array
    terms: Array
    visit_power: Array
    visit_cross: Array
    visit_gram: Array
    visits: Array


class Visit(NamedTuple):
    """The visit that has not ended yet.

    Attributes
    ----------
    cell : ndarray of int, shape (1,)
        -1 for none.
    stay : ndarray, shape (1,)
        [s]
    z : ndarray, shape (B,)
        Integral of each balance's z, [kg].
    weights : ndarray, shape (4,)
        Integral of Psi, [s].
    """

    cell: NDArray[np.int64]
    stay: Array
    z: Array
    weights: Array


def no_sums(grid: Grid, balances: int, constants: int) -> CellSums:
    """Return the sums of no samples at all."""
    cells = (grid.speed.size - 1) * (grid.fuel.size - 1)
    shapes = (
        (4, 4), (balances, 4), (balances, constants, 4), (len(COEFFICIENTS), 4), (balances, balances), (balances, 4), (4, 4), (),
    )  # fmt: skip
    return CellSums(*(np.zeros((cells, *shape)) for shape in shapes))


def no_visit(balances: int) -> Visit:
    """Return that no cell is being visited."""
    return Visit(np.full(1, -1, dtype=np.int64), np.zeros(1), np.zeros(balances), np.zeros(4))


def add(
    sums: CellSums,
    visit: Visit,
    grid: Grid,
    operating_point: tuple[Array, Array],
    steps: Array,
    z: Array,
    slope: Array,
    terms: Array,
) -> None:
    """Add N samples of one segment to the sums, in place.

    Parameters
    ----------
    sums : CellSums
    visit : Visit
        As the last sample of the segment left it.
    grid : Grid
    operating_point : tuple of two ndarrays, shape (N,)
        Fuel and speed.
    steps : ndarray, shape (N,)
        [s], the time that each sample stands for.
    z : ndarray, shape (B, N)
        [kg/s], sensor minus balance.
    slope : ndarray, shape (B, q, N)
        [kg/s], of each balance by each relative constant.
    terms : ndarray, shape (N, 6)
        Terms of Eq. (37).
    """
    _add(sums, visit, grid.fuel, grid.speed, *operating_point, steps, z, slope, terms, LONGEST_VISIT)


@njit(cache=True)
def end_visit(sums: CellSums, visit: Visit) -> None:
    """Add the visit to the sums and forget it; at the end of every segment."""
    c = visit.cell[0]
    if c < 0:
        return
    for a in range(visit.z.size):
        for b in range(visit.z.size):
            sums.visit_power[c, a, b] += visit.z[a] * visit.z[b]
        for m in range(4):
            sums.visit_cross[c, a, m] += visit.z[a] * visit.weights[m]
    for m in range(4):
        for o in range(4):
            sums.visit_gram[c, m, o] += visit.weights[m] * visit.weights[o]
    sums.visits[c] += 1.0
    visit.cell[0] = -1
    visit.stay[0] = 0.0
    visit.z[:] = 0.0
    visit.weights[:] = 0.0


@njit(cache=True)
def _add(  # type: ignore[no-untyped-def] # noqa: PLR0912 rows of views would cost more than the sums
    sums, visit, u_nodes, n_nodes, fuel, speed, steps, z, slope, terms, longest
):
    B, q, N = slope.shape
    psi, part = np.empty(4), np.empty(4)
    i, j = 0, 0
    for k in range(N):
        h = steps[k]
        i, j = seek(u_nodes, fuel[k], i), seek(n_nodes, speed[k], j)
        eta_1, eta_2 = share(u_nodes, fuel[k], i), share(n_nodes, speed[k], j)
        psi[0], psi[1] = (1.0 - eta_1) * (1.0 - eta_2), eta_1 * (1.0 - eta_2)
        psi[2], psi[3] = (1.0 - eta_1) * eta_2, eta_1 * eta_2
        c = j * (u_nodes.size - 1) + i
        if visit.cell[0] != c:
            end_visit(sums, visit)
            visit.cell[0] = c
        for m in range(4):
            part[m] = h * psi[m]
            visit.weights[m] += part[m]
        for a in range(4):
            for m in range(4):
                sums.gram[c, a, m] += psi[a] * part[m]  # Eq. (29)
        for b in range(B):
            for m in range(4):
                sums.right[c, b, m] += z[b, k] * part[m]
            for y in range(q):
                if slope[b, y, k] != 0.0:  # most balances do not depend on most constants
                    for m in range(4):
                        sums.slope[c, b, y, m] += slope[b, y, k] * part[m]
            visit.z[b] += h * z[b, k]
        for y in range(terms.shape[1]):
            for m in range(4):
                sums.terms[c, y, m] += terms[k, y] * part[m]
        visit.stay[0] += h
        if visit.stay[0] >= longest:
            end_visit(sums, visit)
