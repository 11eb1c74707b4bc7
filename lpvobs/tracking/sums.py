"""The sums of logs as tracking keeps them: weighed once, small, added up by vehicle.

A log leaves sums without weights (`observer.parts`). With the weights of the first logs, and the engine's unknowns in coordinates
that a drive can tell, they become one matrix of products over the columns

    nodes of the map | engine | flow | z.

A map changes as a whole by few modes: the six terms of Eq. (37), a level and five shapes, and the reading, which is a gain. All are
maps themselves, so that nothing but a difference between days can tell of them; the flow at a node is that of the log, for boost
differs from drive to drive. Their products stay with each log, which has its day; all else adds up over a vehicle's logs.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.unknowns import Unknowns
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, terms_at_nodes
from lpvobs.observer.information import Solution
from lpvobs.observer.parts import LogInformation
from lpvobs.observer.windows import Columns, Moments
from lpvobs.records import Array, Item

MODES = len(COEFFICIENTS) + 1
"""Number of the modes: Eq. (37), and in proportion to the flow."""
TOLD = 1e-4
"""A direction of the engine's unknowns counts if it moves the rows by more than this share of their noise, squared and summed."""
BALANCES, UNKNOWNS = ("balance", "other_balance"), ("unknown", "coordinate")
LEAST_SHARE = 0.01
"""Of what the usual node has seen, from which a node tells its flow itself."""


@dataclass(frozen=True)
class Basis:
    """How the rows of logs are weighed, and what of the engine counts; found once, from the first logs."""

    weights: Annotated[
        Array, Item("s/kg^2", "inverse covariance of the errors that are independent between windows", BALANCES)
    ]
    engine: Annotated[
        Array, Item("1", "transformation from coordinates with prior N(0, 1) to the engine's unknowns", UNKNOWNS)
    ]
    mean: Annotated[Array, Item("1", "prior mean of the engine's unknowns", ("unknown",))]
    flow: Annotated[Array, Item("kg/s", "air flow at the nodes", ("node",))]
    error: Annotated[Array, Item("kg/s", "error of the mass air flow sensor at the nodes", ("node",))]
    terms: Annotated[Array, Item("1", "terms of Eq. (37) at the nodes", ("node", "term"))]
    lasting: Annotated[
        float,
        Item("1", "ratio of the variance of all errors to the variance of errors that are independent between windows"),
    ]

    # what the engine's formulas left at the nodes where the air flow was known is no part of the map
    left: Annotated[Array, Item("kg/s", "flow left at the nodes when the air flow was known", ("node",))]
    response: Annotated[Array, Item("kg/s", "change of it with each coordinate", ("node", "coordinate"))]

    @property
    def size(self) -> int:
        """Number of nodes and coordinates of the engine."""
        return len(self.flow) + len(self.engine.T)

    def digest(self) -> str:
        """Return a digest of all of it."""
        return hashlib.sha256(b"".join(np.asarray(each).tobytes() for each in vars(self).values())).hexdigest()

    def modes(self, flow: Array) -> Array:
        """Return the maps of which a change is made, shape (p, k), with a flow at the nodes."""
        return np.column_stack([self.terms, flow + self.error])

    @property
    def layout(self) -> Columns:
        """The columns of the sums."""
        return Columns(self.flow.size, self.mean.size, len(self.weights))

    def columns(self) -> Array:
        """Return what every column of the sums is in columns of tracking, shape (C, p + r + 2)."""
        layout, p = self.layout, self.flow.size
        found = np.zeros((layout.size, self.size + 2))
        unknowns = slice(p, p + layout.unknowns)
        found[:p, :p], found[:p, p:-2], found[:p, -1] = np.eye(p), self.response, -self.left
        found[unknowns, p:-2], found[unknowns, -1] = self.engine, -self.mean
        found[layout.terms.stop, -2] = found[layout.z, -1] = 1.0
        return found


@dataclass(frozen=True)
class TrackedLog:
    """What tracking keeps of a log."""

    sha256: Annotated[str, Item("1", "SHA-256 of the log", name="log")]
    name: Annotated[str, Item("1", "name of the log's file")]
    vehicle: Annotated[str, Item("1", "vehicle of the log")]
    date: Annotated[float, Item("d", "date of the log, days since 1970-01-01")]
    duration: Annotated[float, Item("s", "duration of the log without gaps")]
    modes: Annotated[Array, Item("1", "sums of weighted products of the modes with all columns", ("mode", "summed"))]
    own: Annotated[Array, Item("1", "sums of weighted products of the modes with each other", ("mode", "other_mode"))]


@dataclass(frozen=True)
class VehicleSums:
    """The sums of the logs of a vehicle, in the columns that they touch."""

    vehicle: str
    kind: str  # of engine: vehicles of a kind have a map in common
    columns: Annotated[
        NDArray[np.int64], Item("1", "numbers of the columns that are not zero in the logs", name="column")
    ]
    products: Annotated[Array, Item("1", "sums of weighted products of columns", ("column", "other_column"))]
    gram: Annotated[
        Array, Item("s", "integral of Psi_l^T Psi_l over the stay in each cell", ("cell", "corner", "other_corner"))
    ]

    def whole(self, size: int) -> Array:
        """Return the products over all columns, which are `size` and two."""
        full = np.zeros((size + 2, size + 2))
        full[np.ix_(self.columns, self.columns)] = self.products
        return full

    def plus(self, other: "VehicleSums") -> "VehicleSums":
        """Return the sums of both."""
        columns = np.union1d(self.columns, other.columns)
        both = [np.searchsorted(columns, each.columns) for each in (self, other)]
        products = np.zeros((columns.size, columns.size))
        for at, each in zip(both, (self, other), strict=True):
            products[np.ix_(at, at)] += each.products
        return VehicleSums(self.vehicle, self.kind, columns, products, self.gram + other.gram)


@dataclass(frozen=True)
class DatedEffect:
    """An effect that `refine` found on logs of a vehicle."""

    vehicle: Annotated[str, Item("1", "vehicle")]
    id: Annotated[str, Item("1", "effect", name="effect")]
    parameter: Annotated[str, Item("1", "parameter")]
    unit: Annotated[str, Item("1", "unit of the parameter")]
    value: Annotated[float, Item("1", "value of the parameter")]
    low: Annotated[float, Item("1", "lower end of the 90 % interval", gaps=True)]
    high: Annotated[float, Item("1", "upper end of the 90 % interval", gaps=True)]
    absent: Annotated[
        float, Item("d", "date of the last log without the effect before it appears, days since 1970-01-01", gaps=True)
    ]
    first: Annotated[float, Item("d", "date of the first log with the effect, days since 1970-01-01")]
    last: Annotated[float, Item("d", "date of the last log with the effect, days since 1970-01-01")]


@dataclass(frozen=True)
class KeptLog:
    """What tracking keeps of a log, and what is added to the sums of its vehicle."""

    log: TrackedLog
    sums: VehicleSums


def basis_of(grid: Grid, solutions: Sequence[Solution], totals: Sequence[Moments], unknowns: Unknowns) -> Basis:
    """Return how rows are weighed after the first logs of some vehicles, each solved by itself."""
    fast = np.mean([each.fast for each in solutions], axis=0)
    weights, own = np.linalg.inv(fast), solutions[0].layout.engine
    seen = sum(np.einsum("ab,abij->ij", weights, total.products[:, :, own, own]) for total in totals)
    amplitudes = np.exp(np.mean(np.log([each.scales.amplitudes for each in solutions]), axis=0))
    covariance = unknowns.scaled(amplitudes.tolist())
    root = np.linalg.cholesky(covariance + np.diag(1e-9 * np.diag(covariance) + 1e-18))
    told, axes = np.linalg.eigh(root.T @ seen @ root)
    p, terms = grid.size, terms_at_nodes(grid)
    both = zip(solutions, totals, strict=True)
    lasting = float(np.mean([np.trace(as_if_new(each, total) @ weights) for each, total in both])) / weights.shape[0]
    seen = sum(np.einsum("ab,abij->ij", weights, total.products[:, :, :p]) for total in totals)
    error = np.mean([each.theta for each in solutions], axis=0)
    normal, rights = terms.T @ seen[:, :p] @ terms, (seen[:, -1], seen[:, :p] @ error)
    flow, error = (terms @ np.linalg.lstsq(normal, terms.T @ right, rcond=None)[0] for right in rights)
    flow = flow_at_nodes(seen[:, :p], seen[:, -1], flow)
    engine, left = root @ axes[:, told > TOLD][:, ::-1], unknowns.at_nodes
    known = (np.zeros(p), np.zeros((p, unknowns.size))) if left is None else (left.mean, left.response)
    lasting = max(lasting, 1.0)
    return Basis(weights, engine, unknowns.mean, flow, error, terms, lasting, known[0], known[1] @ engine)


def as_if_new(solution: Solution, total: Moments) -> Array:
    """Return S of errors that would widen the usual node as much if those that repeat averaged out, too, shape (B, B) [kg^2/s]."""
    stay = np.einsum("aaii->ai", total.products[:, :, : solution.layout.nodes, : solution.layout.nodes])
    usual = stay.sum(axis=1) / np.maximum(np.count_nonzero(stay > 0.0, axis=1), 1)
    return np.asarray(solution.errors.S + np.diag(usual * solution.errors.repeated**2))


def flow_at_nodes(products: Array, with_flow: Array, usual: Array) -> Array:
    """Return the flow at the nodes, shape (p,) [kg/s], from products of nodes with nodes and with the flow.

    Where hardly anybody drove it is the usual one.
    """
    stay = np.diag(products)[np.diag(products) > 0.0].mean()
    beyond = np.linalg.solve(products + LEAST_SHARE * stay * np.eye(usual.size), with_flow - products @ usual)
    return np.asarray(np.maximum(usual + beyond, 0.0))


def weighed(part: LogInformation, basis: Basis) -> Array:
    """Return the products of a log over the columns of tracking."""
    normal = np.tensordot(basis.weights, part.products)
    onto = basis.columns()[part.columns]
    there = np.flatnonzero(onto.any(axis=0))
    nodes = int(np.searchsorted(part.columns, basis.flow.size))  # they stay as they are, and come first on both sides
    rest = onto[nodes:, there[nodes:]]
    across = normal[:, nodes:] @ rest
    inner = np.block([[normal[:nodes, :nodes], across[:nodes]], [across[:nodes].T, rest.T @ across[nodes:]]])
    products = np.zeros((onto.shape[1], onto.shape[1]))
    products[np.ix_(there, there)] = inner
    return products


def kept(
    part: LogInformation, products: Array, basis: Basis, origin: tuple[str, str, str, float], cells: int
) -> KeptLog:
    """Return what stays of a log, with its name, vehicle, kind and date as its origin says."""
    name, vehicle, kind, date = origin
    p = basis.flow.size
    maps = basis.modes(flow_at_nodes(products[:p, :p], products[:p, -2], basis.flow))
    modes = maps.T @ products[:p]
    log = TrackedLog(part.run.sha256, name, vehicle, date, part.run.duration, modes, modes[:, :p] @ maps)
    gram = np.zeros((cells, 4, 4))
    gram[part.cells] = part.gram
    columns = np.flatnonzero(np.diag(products))
    return KeptLog(log, VehicleSums(vehicle, kind, columns, products[np.ix_(columns, columns)], gram))
