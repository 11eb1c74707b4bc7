"""Curves and surfaces between nodes: values, weights and roughness; and what an engine has learned of them from healthy logs.

What is learned has a form that files can hold without knowing the engine.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lpvobs.compiled import njit
from lpvobs.records import Array


@dataclass(frozen=True)
class Nodes:
    """An input of a learned curve: its nodes, with unit and meaning."""

    values: Array
    unit: str
    meaning: str


def nodes(unit: str, meaning: str, *values: float) -> Nodes:
    """Return an input with these nodes."""
    return Nodes(np.array(values, dtype=float), unit, meaning)


@dataclass(frozen=True)
class LearnedCurve:
    """A curve or surface between nodes."""

    axes: Mapping[str, Nodes]  # by name, in the order of the axes of `values`
    name: str  # of the values, like unit and meaning
    unit: str
    meaning: str
    values: Array  # at the nodes
    relative_error: Array  # their standard errors over them


@dataclass(frozen=True)
class LearnedNumber:
    """A single number, with unit and meaning."""

    value: float
    unit: str
    meaning: str


def spans(sizes: Mapping[str, int], begin: int = 0) -> dict[str, slice]:
    """Return where values stand that follow one another, by name, given how many of each there are."""
    found = {}
    for name, size in sizes.items():
        found[name] = slice(begin, begin + size)
        begin += size
    return found


@dataclass(frozen=True)
class Knowledge:
    """All that was learned."""

    curves: Mapping[str, LearnedCurve]  # by component
    numbers: Mapping[str, LearnedNumber]
    # (m, m) of the relative deviations of all nodes of the curves, row by row, then of some of the numbers
    covariance: Array
    sources: tuple[str, ...]  # names of the logs

    def __getitem__(self, number: str) -> float:
        """Return one of the numbers."""
        return self.numbers[number].value

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all nodes of the curves, in the order of the covariance."""
        return tuple(f"{name} {i}" for name, curve in self.curves.items() for i in range(curve.values.size))

    def places(self) -> Mapping[str, slice]:
        """Return where each curve stands in the covariance."""
        return spans({name: curve.values.size for name, curve in self.curves.items()})

    def moved(self, deviation: Array) -> "Knowledge":
        """Return other curves, by the relative deviation of each of their nodes, shape (m - l,); the l numbers stay."""
        kept = {name: np.maximum(1.0 + deviation[at], 0.05) for name, at in self.places().items()}
        curves = {n: replace(c, values=c.values * kept[n].reshape(c.values.shape)) for n, c in self.curves.items()}
        return replace(self, curves=curves)

    def digest(self) -> str:
        """Return the SHA-256 of all values and their covariance."""
        single = np.array([number.value for number in self.numbers.values()])
        arrays = (*(curve.values for curve in self.curves.values()), single, self.covariance)
        return hashlib.sha256(b"".join(values.tobytes() for values in arrays)).hexdigest()


Weights = tuple[NDArray[np.int64], Array]
"""Nodes (N, m) that take part in each of N values, and the weight of each, which add up to one."""


@dataclass(frozen=True, eq=False)
class Points:
    """N points of a line, a plane or a space, between nodes along every axis; outside, the end holds."""

    nodes: tuple[Array, ...]  # of each axis
    at: tuple[Array, ...]  # of each axis, (N,)

    @cached_property
    def weights(self) -> Weights:
        """The nodes that take part at every point, numbered row by row along the last axis, and their weights."""
        return (on_line, on_surface, in_space)[len(self.nodes) - 1](*self.nodes, *self.at)

    def interpolated(self, values: Array) -> Array:
        """Return the interpolated values, shape (N,), of values at the nodes; the sum over `weights`, without storing them."""
        nodes = tuple(np.array(each, dtype=float) for each in self.nodes)  # of one type for the compiler
        return np.asarray(_between(nodes, np.stack(self.at), np.ascontiguousarray(values).reshape(-1)))


@njit(cache=True)
def _below(nodes, x, low):  # type: ignore[no-untyped-def]
    """Return the node below a point, sought from another one, and the share of the way to the next node."""
    inside = np.minimum(np.maximum(x, nodes[0]), nodes[-1])  # as numbers that are none stay none
    while low < nodes.size - 2 and nodes[low + 1] <= inside:
        low += 1
    while low > 0 and nodes[low] > inside:
        low -= 1
    return low, (inside - nodes[low]) / (nodes[low + 1] - nodes[low])


@njit(cache=True)
def _between(nodes, at, values):  # type: ignore[no-untyped-def]
    """Return the values at points, shape (axes, N), between the corners of their cells."""
    axes, out = len(nodes), np.zeros(at.shape[1])
    low, share = np.zeros(axes, np.int64), np.zeros(axes)
    for k in range(at.shape[1]):
        for a in range(axes):
            low[a], share[a] = _below(nodes[a], at[a, k], low[a])
        for corner in range(1 << axes):
            node, weight = 0, 1.0
            for a in range(axes):
                above = (corner >> a) & 1
                node = node * nodes[a].size + low[a] + above
                weight *= share[a] if above else 1.0 - share[a]
            out[k] += weight * values[node]
    return out


@njit(cache=True)
def on_line(nodes: Array, x: Array) -> Weights:
    """Return which two of J nodes each of N points lies between, and their weights; outside, the end holds."""
    found, shares = np.empty((x.size, 2), np.int64), np.empty((x.size, 2))
    low = 0  # from one sample to the next, a signal seldom moves farther than the next nodes
    for k in range(x.size):
        low, share = _below(nodes, x[k], low)
        found[k, 0], found[k, 1] = low, low + 1
        shares[k, 0], shares[k, 1] = 1.0 - share, share
    return found, shares


@njit(cache=True)
def on_surface(first: Array, second: Array, x: Array, y: Array) -> Weights:
    """Return the same for the four nodes around points of a plane, numbered row by row along the second axis."""
    return _crossed(on_line(first, x), on_line(second, y), second.size)


@njit(cache=True)
def in_space(first: Array, second: Array, third: Array, x: Array, y: Array, z: Array) -> Weights:
    """Return the same for the eight nodes around points of space."""
    return _crossed(on_surface(first, second, x, y), on_line(third, z), third.size)


@njit(cache=True)
def _crossed(rows: Weights, columns: Weights, size: int) -> Weights:
    """Return nodes and weights of a product of axes; the last one has so many nodes."""
    (i, u), (j, v) = rows, columns
    a, b = i.shape[1], j.shape[1]
    found, shares = np.empty((len(i), a * b), np.int64), np.empty((len(i), a * b))
    for k in range(len(i)):
        for m in range(a):
            for n in range(b):
                found[k, m * b + n] = i[k, m] * size + j[k, n]
                shares[k, m * b + n] = u[k, m] * v[k, n]
    return found, shares


def values_at(weights: Weights, values: Array) -> Array:
    """Return the interpolated values, shape (N,)."""
    return np.asarray(_values_at(*weights, np.ascontiguousarray(values).reshape(-1)))


@njit(cache=True)
def _values_at(nodes, shares, values):  # type: ignore[no-untyped-def]
    out = np.zeros(len(nodes))
    for k in range(len(nodes)):
        for m in range(nodes.shape[1]):
            out[k] += shares[k, m] * values[nodes[k, m]]
    return out


def differences(order: int, rows: int, columns: int) -> Array:
    """Return first or second differences along both axes of a surface, (m, rows * columns); a line has one row."""
    across, along = (np.diff(np.eye(size), n=order, axis=0) for size in (rows, columns))
    return np.vstack([np.kron(across, np.eye(columns)), np.kron(np.eye(rows), along)])
