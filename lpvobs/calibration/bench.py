"""Stationary bench points as rows of the linear problem that an estimate solves, with a reference flow in place of the sensor."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lpvobs.engines.base import AirPath
from lpvobs.engines.unknowns import MeasuredPart, Unknowns
from lpvobs.records import Array, Defects, Log

REFERENCE, DEVIATION = "W_reference", "sd_W_reference"
METER = 0.0035
"""Relative standard deviation of a reference meter of which nothing is said: thermal meters state 0.3 to 0.4 %."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of m references, several kinds one after the other: z = J beta + e.

    Attributes
    ----------
    kind : tuple of MeasuredPart
    of : ndarray of int, shape (m,)
        Number of the kind.
    point : ndarray of int, shape (m,)
        Number of the bench point.
    reference, z, error : ndarray, shape (m,)
        [kg/s], the reference flow, what it is beyond the flow of the engine, standard deviation of the reference.
    J : ndarray, shape (m, q)
        [kg/s]
    """

    kind: tuple[MeasuredPart, ...]
    of: Array
    point: Array
    reference: Array
    z: Array
    error: Array
    J: Array


def kinds_of(air_path: AirPath, table: Mapping[str, Array]) -> tuple[MeasuredPart, ...]:
    """Return the kinds of rows that a table gives: every balance, and the parts of which it has a reference."""
    balances = tuple(MeasuredPart(name, REFERENCE, b, {}, METER, 0.0) for b, name in enumerate(air_path.balance_names))
    return balances + tuple(part for part in air_path.measured_parts if part.column in table)


def rows_of(air_path: AirPath, unknowns: Unknowns, table: Mapping[str, Array]) -> Rows:
    """Return the rows of a bench table; `air_path` and `unknowns` are those at the point of linearisation."""
    kinds = kinds_of(air_path, table)
    found: dict[str, list[Array]] = {name: [] for name in ("of", "point", "reference", "z", "error", "J")}
    for number, kind in enumerate(kinds):
        flow, J = _flow(air_path, unknowns, table, kind.balance)
        if kind.without:
            away = {name: np.full(flow.size, value) for name, value in kind.without.items()}
            other, J_other = _flow(air_path, unknowns, {**table, **away}, kind.balance)
            flow, J = other - flow, J_other - J
        reference = table[kind.column]
        error = np.hypot(kind.relative * reference, kind.absolute)
        if kind.column == REFERENCE and DEVIATION in table:
            error = table[DEVIATION]
        on = np.isfinite(reference) & np.isfinite(error) & np.isfinite(flow)
        if kind.without:  # a part that is away already shows nothing
            on &= np.any([table[name] != value for name, value in kind.without.items()], axis=0)
        values = (np.full(flow.size, number), np.arange(flow.size), reference, reference - flow, error, J)
        for name, value in zip(found, values, strict=True):
            found[name].append(value[on])
    return Rows(kinds, **{name: np.concatenate(values) for name, values in found.items()})


def _flow(air_path: AirPath, unknowns: Unknowns, table: Mapping[str, Array], balance: int) -> tuple[Array, Array]:
    """Return the flow of a balance at rest, shape (n,), and how it answers to the unknowns, shape (n, q) [kg/s]."""
    n = table[REFERENCE].size
    channels = {name: table[name] for name in air_path.channels if name in table}
    log = Log("", "", np.arange(float(n)), channels, {}, ((0, n),), np.arange(n), Defects(n))
    still = dict.fromkeys(air_path.smoothed, np.zeros(n))
    found = air_path.balances(log, still, unknowns.constants)
    J = np.zeros((n, unknowns.size))
    J[:, : len(unknowns.constants)] = found.slope[balance].T
    for place, correction in zip(unknowns.places().values(), air_path.corrections(log, still), strict=True):
        if correction.balance == balance:
            J[:, place] = correction.columns(place.stop - place.start)
    return found.flow[balance], J
