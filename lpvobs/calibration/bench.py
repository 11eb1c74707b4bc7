"""Bench points and tables of components as rows of the problem that an estimate solves, a known flow in place of the sensor.

And which further points would make the flow known best: the greedy A-optimal choice from feasible ones. What a map owes to its
engine is the flow that the balances agree on. Its variance at every feasible point follows from the covariance of the engine's
unknowns, and so does what a measurement at one of them would leave of it, whatever it reads.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.base import AirPath
from lpvobs.engines.unknowns import TABLE_FLOW, MeasuredPart, Unknowns
from lpvobs.observer.parts import log_of
from lpvobs.records import Array

STEP = 1e-5  # relative step of the difference quotients by constants
REFERENCE, DEVIATION = "W_reference", "sd_W_reference"
METER = 0.0035
"""Relative standard deviation of a reference meter of which nothing is said: thermal meters state 0.3 to 0.4 %."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of m references, several kinds one after the other: z = J beta + e."""

    kind: tuple[MeasuredPart, ...]
    of: Array  # (m,) number of the kind
    point: Array  # (m,) number of the bench point
    reference: Array  # (m,) [kg/s], the reference flow
    z: Array  # (m,) [kg/s], what it is beyond the flow of the engine
    error: Array  # (m,) [kg/s], its standard deviation
    shared: Array  # (m, tables) [kg/s], what all points of a component's table are off by together
    J: Array  # (m, q) [kg/s]

    def measured(self) -> "Rows":
        """Return those of bench points, without tables of components."""
        own = np.array([kind.column != TABLE_FLOW for kind in self.kind])[self.of]
        return replace(self, **{name: value[own] for name, value in vars(self).items() if name != "kind"})


@dataclass(frozen=True, eq=False)
class Table:
    """Points with the columns that the engine needs, and the flows that they tell."""

    columns: Mapping[str, Array]
    kinds: tuple[MeasuredPart, ...]
    # share of the flow that all points of a component's table may be off by together, and each of them once more: somebody has
    # smoothed it, and its shape is no surer than its level
    tolerance: float = 0.0
    flow: Callable[[Any, Mapping[str, Array]], Array] | None = None  # as `ComponentMap.flow`


def bench_table(air_path: AirPath, columns: Mapping[str, Array]) -> Table:
    """Return bench points: every balance has the reference flow, and so have the parts that were measured."""
    balances = tuple(MeasuredPart(name, REFERENCE, b, {}, METER, 0.0) for b, name in enumerate(air_path.balance_names))
    return Table(columns, balances + tuple(part for part in air_path.measured_parts if part.column in columns))


def rows_of(air_path: AirPath, unknowns: Unknowns, tables: Sequence[Table]) -> Rows:
    """Return the rows of tables; `air_path` and `unknowns` are those at the point of linearisation."""
    found: dict[str, list[Array]] = {name: [] for name in ("of", "point", "reference", "z", "error", "J", "shared")}
    kinds: list[MeasuredPart] = []
    first = 0
    for number, table in enumerate(tables):
        for kind in table.kinds:
            flow, J = _flow(air_path, unknowns, table, kind.balance)
            if kind.without:
                away = {name: np.full(flow.size, value) for name, value in kind.without.items()}
                apart = replace(table, columns={**table.columns, **away})
                other, J_other = _flow(air_path, unknowns, apart, kind.balance if kind.away is None else kind.away)
                flow, J = other - flow, J_other - J
            reference = table.columns[kind.column]
            error = np.hypot(np.hypot(kind.relative, table.tolerance) * reference, kind.absolute)
            if kind.column == REFERENCE and DEVIATION in table.columns:
                error = table.columns[DEVIATION]
            on = np.isfinite(reference) & np.isfinite(error) & np.isfinite(flow)
            if kind.without:  # a part that is away already shows nothing
                on &= np.any([table.columns[name] != value for name, value in kind.without.items()], axis=0)
            of, point = np.full(flow.size, len(kinds)), first + np.arange(flow.size)
            shared = np.outer(table.tolerance * reference, np.arange(len(tables)) == number)
            values = (of, point, reference, reference - flow, error, J, shared)
            for name, value in zip(found, values, strict=True):
                found[name].append(value[on])
            kinds.append(kind)
        first += flow.size
    return Rows(tuple(kinds), **{name: np.concatenate(values) for name, values in found.items()})


def _flow(air_path: AirPath, unknowns: Unknowns, table: Table, balance: int) -> tuple[Array, Array]:
    """Return the flow of a balance at rest, or the table's own, (n,), and how it answers to the unknowns, (n, q) [kg/s]."""
    n = next(iter(table.columns.values())).size
    J = np.zeros((n, unknowns.size))
    if table.flow is not None:
        flow = table.flow(air_path.engine, table.columns)
        for i, name in enumerate(unknowns.constants):
            J[:, i] = (table.flow(air_path.deviating({name: STEP}).engine, table.columns) - flow) / STEP
        return flow, J
    channels = {name: table.columns[name] for name in air_path.channels if name in table.columns}
    log = log_of(np.arange(float(n)), channels)
    still = dict.fromkeys(air_path.smoothed, np.zeros(n))
    found = air_path.balances(log, still, unknowns.constants)
    J[:, : len(unknowns.constants)] = found.slope[balance].T
    for place, correction in zip(unknowns.places().values(), air_path.corrections(log, still), strict=True):
        if correction.balance is not None and balance in correction.on(len(found.flow)):
            J[:, place] = correction.columns(place.stop - place.start)
    return found.flow[balance], J


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
