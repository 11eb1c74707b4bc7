"""The error map as calibration tools want it: values on two axes, read from a result and laid onto other axes."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.io.results.axes import LONG_NAME, ORIGIN, axes_of
from lpvobs.io.results.hdf import reading
from lpvobs.io.results.mapping import Layout, read
from lpvobs.records import Array, Item

NONE, ESTIMATED, EXTRAPOLATED, OLD = 0, 1, 2, 3
ORIGINS = {NONE: "none", ESTIMATED: "estimated", EXTRAPOLATED: "extrapolated", OLD: "old"}

SNAP = 1e-6
"""Share of a cell by which an axis of rounded numbers may miss the node that it means."""


@dataclass(frozen=True)
class SurfaceAxis:
    """Nodes of one input of the map."""

    name: str
    unit: str
    long_name: str
    nodes: Array  # (K,) [unit], strictly increasing


@dataclass(frozen=True)
class Surface:
    """The sensor's error over engine speed and fuel."""

    x: SurfaceAxis  # engine speed, p2 nodes
    y: SurfaceAxis  # fuel, p1 nodes
    values: Array  # (p2, p1) [unit], NaN where nothing is known
    standard_error: Array  # the same
    origin: NDArray[np.int8]  # (p2, p1) where each value comes from, see ORIGINS
    unit: str  # of the values
    source: str  # group of the result that they are from


def read_surface(path: Path, source: str = "") -> Surface:
    """Return the map of a result, or its extrapolation.

    `source` is `map` or `extrapolation`; empty: the extrapolation if there is one. Raises DataError if the file is no result,
    or lacks what is asked for.
    """
    with reading(path, "result", "make it with `lpvobs estimate`") as file:
        source = source or ("extrapolation" if "extrapolation" in file else "map")
        if source not in file:
            raise DataError(f"{path}: has no /{source}; run `lpvobs extrapolate {path}` first")
        group, (fuel, speed) = file[source], axes_of(file).items()
        x, y = (
            read(group, axis_layout(name, item), name=name, unit=item.unit, long_name=item.meaning)
            for name, item in (speed, fuel)
        )
        unit = str(group["delta_W_c"].attrs["units"])
        return read(group, surface_layout(x.name, y.name, unit, "support"), x=x, y=y, unit=unit, source=source)


def axis_layout(name: str, item: Item) -> Layout[SurfaceAxis]:
    """Return how an axis stands in a group."""
    return Layout(SurfaceAxis, {"nodes": replace(item, name=name)})


def surface_layout(x: str, y: str, unit: str, origin: str) -> Layout[Surface]:
    """Return how a surface stands in a group on axes of these names, where each value comes from under the name `origin`."""
    both = (x, y)
    return Layout(
        Surface,
        {
            "values": Item(unit, LONG_NAME, both, "delta_W_c", gaps=True),
            "standard_error": Item(unit, "standard error of delta_W_c", both, gaps=True),
            "origin": Item("1", ORIGIN, both, origin, meanings=ORIGINS),
        },
    )


def onto(surface: Surface, x: Array, y: Array) -> Surface:
    """Return a surface at the nodes of other axes, bilinear as the map itself.

    A node counts as estimated only if every node that it leans on is; outside the surface nothing is known. The standard error
    is the weighted mean of those leaned on, an upper bound whatever their correlation. The nodes x and y, shapes (p2',) and
    (p1',), are in the units of the surface's axes.
    """
    weight_x, weight_y = _weights(surface.x.nodes, x), _weights(surface.y.nodes, y)
    inside = np.outer(weight_x.sum(axis=1) > 0, weight_y.sum(axis=1) > 0)

    def touched(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which new nodes lean on an old one of the mask."""
        return np.asarray((weight_x > 0).astype(float) @ mask.astype(float) @ (weight_y > 0).T > 0)

    unknown = touched(surface.origin == NONE) | ~inside
    origin = np.where(unknown, NONE, np.where(touched(surface.origin == EXTRAPOLATED), EXTRAPOLATED, ESTIMATED))
    known = surface.origin != NONE
    values, error = (
        np.where(unknown, np.nan, weight_x @ np.where(known, item, 0.0) @ weight_y.T)
        for item in (surface.values, surface.standard_error)
    )
    return replace(
        surface,
        x=replace(surface.x, nodes=x),
        y=replace(surface.y, nodes=y),
        values=values,
        standard_error=error,
        origin=origin.astype(np.int8),
    )


def _weights(nodes: Array, at: Array) -> Array:
    """Return how much each node counts at each place, shape (len(at), len(nodes)); a row of zeros outside."""
    cell = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, nodes.size - 2)
    share = (at - nodes[cell]) / (nodes[cell + 1] - nodes[cell])
    inside = (share >= -SNAP) & (share <= 1 + SNAP)
    share = np.where(np.abs(share) <= SNAP, 0.0, np.where(np.abs(share - 1) <= SNAP, 1.0, share))
    weights = np.zeros((at.size, nodes.size))
    rows = np.arange(at.size)
    weights[rows, cell] = np.where(inside, 1 - share, 0.0)
    weights[rows, cell + 1] += np.where(inside, share, 0.0)
    return weights


def keep_old(surface: Surface, old: Array | None, only_estimated: bool) -> Surface:
    """Return the surface with old values, shape (p2, p1), where it has none; if asked, also where it is not estimated.

    Without old values such nodes are empty.
    """
    kept = surface.origin != ESTIMATED if only_estimated else surface.origin == NONE
    values = np.where(kept, np.nan if old is None else old, surface.values)
    return replace(
        surface,
        values=values,
        standard_error=np.where(kept, np.nan, surface.standard_error),
        origin=np.where(kept, NONE if old is None else OLD, surface.origin).astype(np.int8),
    )
