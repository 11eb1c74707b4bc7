"""Bench points and tables of components as rows of the problem that an estimate solves, a known flow in place of the sensor."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

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
    kinds, found = list[MeasuredPart](), list[list[Array]]()
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
            found.append([value[on] for value in (of, point, reference, reference - flow, error, shared, J)])
            kinds.append(kind)
        first += flow.size
    return Rows(tuple(kinds), *map(np.concatenate, zip(*found, strict=True)))


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
