"""Curves and surfaces between nodes: values, the weights of the nodes behind each value, and how rough they are."""

import numpy as np
from numpy.typing import NDArray

from lpvobs.records import Array

Weights = tuple[NDArray[np.int64], Array]
"""Nodes (N, m) that take part in each of N values, and the weight of each, which add up to one."""


def on_line(nodes: Array, x: Array) -> Weights:
    """Return which two of J nodes each of N points lies between, and their weights; outside, the end holds."""
    inside = np.clip(x, nodes[0], nodes[-1])
    low = np.clip(np.searchsorted(nodes, inside, side="right") - 1, 0, nodes.size - 2)
    share = (inside - nodes[low]) / (nodes[low + 1] - nodes[low])
    return np.stack([low, low + 1], axis=1), np.stack([1.0 - share, share], axis=1)


def on_surface(first: Array, second: Array, x: Array, y: Array) -> Weights:
    """Return the same for the four nodes around points of a plane, numbered row by row along the second axis."""
    (i, u), (j, v) = on_line(first, x), on_line(second, y)
    nodes = i[:, :, None] * second.size + j[:, None, :]
    return nodes.reshape(x.size, 4), (u[:, :, None] * v[:, None, :]).reshape(x.size, 4)


def in_space(first: Array, second: Array, third: Array, x: Array, y: Array, z: Array) -> Weights:
    """Return the same for the eight nodes around points of space."""
    (i, u), (j, v) = on_surface(first, second, x, y), on_line(third, z)
    nodes = i[:, :, None] * third.size + j[:, None, :]
    return nodes.reshape(x.size, 8), (u[:, :, None] * v[:, None, :]).reshape(x.size, 8)


def values_at(weights: Weights, values: Array) -> Array:
    """Return the interpolated values, shape (N,)."""
    nodes, share = weights
    return np.asarray(np.einsum("nm,nm->n", values.reshape(-1)[nodes], share))


def roughness(size: int) -> Array:
    """Return second differences along a line of nodes, shape (size - 2, size)."""
    return np.diff(np.eye(size), n=2, axis=0)


def surface_roughness(rows: int, columns: int) -> Array:
    """Return second differences along both axes of a surface, (m, rows * columns)."""
    return np.vstack([np.kron(roughness(rows), np.eye(columns)), np.kron(np.eye(rows), roughness(columns))])


def slopes(rows: int, columns: int) -> Array:
    """Return first differences along both axes; a line has one row."""
    along = np.kron(np.eye(rows), np.diff(np.eye(columns), axis=0))
    across = np.kron(np.diff(np.eye(rows), axis=0), np.eye(columns))
    return np.vstack([along, across])
