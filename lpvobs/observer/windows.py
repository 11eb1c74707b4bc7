"""A drive in short windows: what each says of the map and of the engine's unknowns, as one row of a linear problem a balance.

Over a window of `LENGTH`, with z_b the mean of the sensor's reading less the flow of balance b,

    z_b = Psi theta + J_b beta + kappa_1 r + kappa_2 r^2 + e_b,

Psi being the mean regressor of the map (Eq. 23), beta the engine's unknowns, J_b how the balance's flow answers to each, taken at
the mean signals of the window, and r the sensor's reading. The sums of products of these rows are all that a log leaves behind:
they hold no weights and no amplitudes, so both can change without the log.

Signals are noisy, and columns and z are made of the same signals and their rates, so their products hold a part that is
noise alone. It is computed from how rough the signals are from sample to sample, and subtracted.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.maps.grid import Grid, local
from lpvobs.maps.quadratic import COEFFICIENTS, scaled_terms
from lpvobs.records import Additive, Array

LENGTH = 0.25  # [s] Of a window: long against sampling, short against what a transient does to the unknowns' slopes
ROWS = 480  # windows that are worked on together, two minutes: with fewer, the calls for each take longer than the work
GROUP = 12
"""Windows, 3 s, over which rows are summed up to see how slow errors are: those of a model last, noise does not."""
LEAST_STAY = 0.02  # [s] A window that holds less of the drive says nothing
SENSOR = 2  # powers of the reading that the sensor's error may follow


@dataclass(frozen=True)
class Columns:
    """Which column is what: the map, the engine's unknowns, powers of the reading, z, the terms of Eq. (37), the flow."""

    nodes: int
    unknowns: int
    balances: int

    @property
    def solved(self) -> int:
        """Number of columns that are solved for."""
        return self.nodes + self.unknowns + SENSOR

    @property
    def sensor(self) -> slice:
        """The columns of the powers of the reading."""
        return slice(self.solved - SENSOR, self.solved)

    @property
    def engine(self) -> slice:
        """The columns of the engine's unknowns."""
        return slice(self.nodes, self.nodes + self.unknowns)

    @property
    def z(self) -> int:
        """The column of z."""
        return self.solved

    @property
    def size(self) -> int:
        """Number of all columns."""
        return self.solved + 2 + len(COEFFICIENTS)

    @property
    def terms(self) -> slice:
        """The columns of the terms; the flow follows them."""
        return slice(self.solved + 1, self.solved + 1 + len(COEFFICIENTS))


@dataclass(frozen=True, eq=False)
class Moments(Additive):
    """Sums of products of rows over windows."""

    products: Array  # (B, B, C, C) of the rows of every two balances; symmetric under exchange of both pairs
    slow: Array  # (B, B, C, C) the same of sums of rows over a `GROUP` of windows over the root of their number
    windows: Array  # (B,) their number where each balance says something
    gram: Array  # (cells, 4, 4) [s], integral of Psi_l^T Psi_l over the stay in each cell, for its excitation


def no_moments(grid: Grid, layout: Columns) -> Moments:
    """Return the sums of no window."""
    B, C = layout.balances, layout.size
    cells = (grid.speed.size - 1) * (grid.fuel.size - 1)
    return Moments(np.zeros((B, B, C, C)), np.zeros((B, B, C, C)), np.zeros(B), np.zeros((cells, 4, 4)))


@dataclass(frozen=True, eq=False)
class Slopes:
    """What mean signals of n windows say beside z."""

    touched: NDArray[np.int64]  # (k,) which of the unknowns any of the windows answers to
    J: Array  # (n, B, k) [kg/s]
    reading: Array  # (n,) [kg/s], of the sensor
    noise: Array  # (n,) [kg/s], standard deviation of its noise in the mean
    weight: Array  # (n, B)
    correction: Array  # (n, B) [kg/s], to be added to z
    # what noise adds to J and z where each of its sources is as large as its standard deviation, with signs that are
    # independent over a few windows
    shaken: tuple[Array, Array]


class Windows:
    """Rows of a log as they are completed, added up; `slopes` takes the stay (n,) [s] and mean signals (n, s) of windows."""

    def __init__(self, grid: Grid, layout: Columns, slopes: Callable[[Array, Array], Slopes]):
        self.grid, self.layout, self.slopes = grid, layout, slopes
        self.total, self.started = no_moments(grid, layout), float("nan")
        self.blocks: dict[int, tuple[Array, Array]] = {}

    def add(self, time: Array, steps: Array, point: tuple[Array, Array], z: Array, signals: Array) -> None:
        """Add N samples, later than any before; z has shape (B, N), signals (s, N); a balance that is NaN says nothing."""
        if np.isnan(self.started):
            self.started = float(time[0])
        window = np.floor((time - self.started) / LENGTH).astype(np.int64)
        block = window // ROWS
        values = np.column_stack([np.ones(time.size), scaled_terms(self.grid, *point), z.T, signals.T])
        for number in block[np.flatnonzero(np.diff(block, prepend=-1))].tolist():
            self._complete(number)
            part = slice(*np.searchsorted(block, (number, number + 1)))
            new = np.zeros((ROWS, self.grid.size)), np.zeros((ROWS, values.shape[1]))
            Psi, sums = self.blocks.setdefault(number, new)
            (fuel, speed), row = (axis[part] for axis in point), window[part] - number * ROWS
            nodes = self.grid.fuel, self.grid.speed
            _add(Psi, sums, self.total.gram, *nodes, row, steps[part], fuel, speed, values[part])

    def moments(self) -> Moments:
        """Return the sums over the whole log."""
        self._complete(None)
        _mirror(self.total.products)
        _mirror(self.total.slow)
        return self.total

    def _complete(self, begun: int | None) -> None:
        """Add the blocks of windows before the one that has begun."""
        for number in [number for number in self.blocks if number != begun]:
            Psi, sums = self.blocks.pop(number)
            on = np.flatnonzero(sums[:, 0] >= LEAST_STAY)
            if on.size:
                stay = sums[on, :1]
                self._add_block(on // GROUP, stay[:, 0], Psi[on] / stay, sums[on, 1:] / stay)

    def _add_block(self, group: NDArray[np.int64], stay: Array, Psi: Array, means: Array) -> None:
        """Add n windows: their stay [s], mean Psi (n, p), and means (n, 6 + B + s) of terms, z [kg/s] and signals."""
        terms, z, signals = np.split(means, np.cumsum((len(COEFFICIENTS), self.layout.balances)), axis=1)
        found, layout, total = self.slopes(stay, signals), self.layout, self.total
        z = z + found.correction
        known = [z, found.reading[:, None], found.J.sum(axis=2), terms.sum(axis=1)[:, None]]
        says = np.logical_and.reduce([np.isfinite(each) for each in np.broadcast_arrays(*known)])
        says &= found.weight > 0.0
        total.windows[:] += says.sum(axis=0)
        weight = np.sqrt(stay[:, None] * found.weight) * says
        nodes, own = np.flatnonzero(Psi.any(axis=0)), layout.nodes + found.touched
        columns = np.concatenate((nodes, own, np.arange(layout.engine.stop, layout.size)))
        Psi, powers = np.ascontiguousarray(Psi[:, nodes]), found.reading[:, None] ** np.arange(1, SENSOR + 1)
        _add_rows(total.products, total.slow, columns, group, weight, Psi, found.J, powers, z, terms, found.reading)
        # a slope counts once more as far as it is trusted
        self._subtract(own, *found.shaken, np.sqrt(stay[:, None]) * found.weight * says)
        noise = np.nan_to_num(found.noise)[:, None]  # the same in every balance
        moved = np.arange(1, SENSOR + 1) * np.nan_to_num(found.reading)[:, None] ** np.arange(SENSOR) * noise
        in_powers = np.broadcast_to(moved[:, None], (*z.shape, SENSOR))
        self._subtract(np.arange(layout.engine.stop, layout.solved), in_powers, np.broadcast_to(noise, z.shape), weight)

    def _subtract(self, own: NDArray[np.int64], columns: Array, z: Array, counted: Array) -> None:
        """Take what noise makes of the products of columns and z out of all sums; it is independent from window to window."""
        for a in range(self.layout.balances):
            for b in range(a, self.layout.balances):
                both = counted[:, a] * counted[:, b]
                left, right = columns[:, a].T @ (both * z[:, b]), (both * z[:, a]) @ columns[:, b]
                for sums, count in ((self.total.products, 1), (self.total.slow, GROUP)):
                    sums[a, b, own, self.layout.z] -= left / count
                    sums[a, b, self.layout.z, own] -= right / count


def _mirror(products: Array) -> None:
    """Fill what is below the diagonal of the products of two balances from what is above it."""
    for a, own in enumerate(products):
        own[a] = np.triu(own[a]) + np.triu(own[a], 1).T
        for b in range(a):
            own[b] = products[b, a].T


@njit(cache=True)
def _add_rows(products, slow, columns, group, weight, Psi, J, powers, z, terms, reading):  # type: ignore[no-untyped-def]
    """Add the products of the rows of n windows in some columns, and those of sums of rows over a group."""
    n, B = z.shape
    p, q, k = Psi.shape[1], J.shape[2], powers.shape[1]
    columns = columns.astype(np.uintp)  # no negative ones, for which each access would look
    at, value = np.empty((B, columns.size), dtype=np.uintp), np.empty((B, columns.size))
    count = np.zeros(B, dtype=np.int64)
    rest, summed = np.zeros(columns.size - p - q), np.zeros((B, columns.size))
    for r in range(n):
        for b in range(B):
            rest[:k], rest[k], rest[k + 1 : -1], rest[-1] = powers[r], z[r, b], terms[r], reading[r] - z[r, b]
            count[b], w, first = 0, weight[r, b], 0
            for part in (Psi[r], J[r, b], rest):
                if w != 0.0:
                    count[b] = _list(part, w, columns[first:], at[b], value[b], count[b], summed[b, first:])
                first += part.size
        _add_products(products, count, at, value)
        if r == n - 1 or group[r + 1] != group[r]:
            summed /= np.sqrt(GROUP)
            for b in range(B):
                count[b] = _list(summed[b], 1.0, columns, at[b], value[b], 0, rest[:0])
            _add_products(slow, count, at, value)
            summed[:] = 0.0


@njit(cache=True)
def _list(given, w, columns, at, value, count, summed):  # type: ignore[no-untyped-def]
    """List w times what is not zero, behind the first `count`, add it to `summed`, and return how many are listed."""
    for i in range(given.size):
        if given[i] != 0.0:
            at[count], value[count] = columns[i], w * given[i]
            if summed.size:
                summed[i] += value[count]
            count += 1
    return count


@njit(cache=True)
def _add_products(products, count, at, value):  # type: ignore[no-untyped-def]
    """Add the products of the rows of every balance, as listed, with those of later ones, and half of those with itself."""
    for a in range(count.size):
        for b in range(a, count.size):
            for k in range(count[a]):
                row, x = products[a, b, at[a, k]], value[a, k]
                for m in range(k if a == b else 0, count[b]):
                    row[at[b, m]] += x * value[b, m]


@njit(cache=True)
def _add(Psi, sums, gram, u_nodes, n_nodes, row, steps, fuel, speed, values):  # type: ignore[no-untyped-def]
    """Add to the integrals of Psi and of values in each window, and to the Gram matrix of each cell."""
    p_1 = u_nodes.size
    nodes, weights = np.empty(4, dtype=np.int64), np.empty(4)
    for k in range(row.size):
        r, h = row[k], steps[k]
        local(u_nodes, n_nodes, fuel[k], speed[k], nodes, weights)
        cell = nodes[0] - nodes[0] // p_1
        for a in range(4):
            Psi[r, nodes[a]] += h * weights[a]
            for b in range(4):
                gram[cell, a, b] += h * weights[a] * weights[b]  # Eq. (29)
        for i in range(values.shape[1]):
            sums[r, i] += h * values[k, i]
