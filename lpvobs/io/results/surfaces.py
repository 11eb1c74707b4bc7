"""The error map in a result: its axes, what fills it, and as people and calibration tools want it, values with their covariance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import DataError
from lpvobs.io.results.hdf import Field, reading, text, write_group
from lpvobs.io.results.mapping import Layout, Record, fields, layout_of, read
from lpvobs.maps import joint
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, ESTIMATED, EXTRAPOLATED, SMOOTHED, SUPPORT, Filled
from lpvobs.observer.estimate import NodeMap
from lpvobs.records import Array, Item

Axes = Mapping[str, Item]  # by name: first the fuel axis, then the speed axis
RESULT = ("result", "make a result with `lpvobs estimate`")  # its kind, and what to do where a file is none


def axes_of(file: h5py.File) -> Axes:
    """Return the axes of a result's map."""
    group = file["map"]
    fuel, speed = str(group.attrs["axes"]).split()
    return {name: Item(str(group[name].attrs["units"]), str(group[name].attrs["long_name"])) for name in (fuel, speed)}


def grid_layout(axes: Axes) -> Layout[Grid]:
    """Return how the nodes of a map stand in a group."""
    (fuel, first), (speed, second) = axes.items()
    return Layout(Grid, {"fuel": replace(first, name=fuel), "speed": replace(second, name=speed)})


GROUP = "extrapolation"
OUTER = "share of outer estimated nodes inside their 90 % interval when fitted without them"


def map_layout(record: type[Record], axes: Axes) -> Layout[Record]:
    """Return how a record stands in a group whose axes `fuel` and `speed` have the names of the engine's."""
    names, whole = dict(zip(("fuel", "speed"), axes, strict=True)), layout_of(record)  # type: ignore[arg-type]
    return whole.on(lambda _, own: tuple(names.get(axis, axis) for axis in own))


def write_extrapolation(file: h5py.File, axes: Axes, grid: Grid, fitted: Filled, outer_coverage: float) -> None:
    """Write `/extrapolation` in place of the one that is there."""
    if GROUP in file:
        del file[GROUP]
    fuel, speed = (axis.unit for axis in axes.values())
    powers = [f"/({fuel})^2", f"/({fuel})", f"/({speed})^2", f"/({speed})", f"/({fuel})/({speed})", ""]
    contents = fields(grid_layout(axes), grid) | fields(map_layout(Filled, axes), fitted, {"coefficient": COEFFICIENTS})
    group = write_group(file, GROUP, contents | {"outer_coverage": Field(outer_coverage, Item("1", OUTER))})
    for name in ("coefficients", "coefficients_standard_error"):
        group[name].attrs["coefficient_units"] = text([f"kg/s{power}" for power in powers])


NONE, OLD, LEFT_OUT = 0, 3, 5
ORIGINS = {NONE: "none", **SUPPORT, OLD: "old", LEFT_OUT: "left_out"}


@dataclass(frozen=True)
class SurfaceAxis:
    """Nodes of one input of the map."""

    name: str
    unit: str
    long_name: str
    nodes: Array  # (K,) [unit], strictly increasing


@dataclass(frozen=True)
class Surface:
    """The sensor's error over engine speed and fuel, bilinear between the nodes.

    Examples
    --------
    `surface.mean({"n_e": (1500, 2500)}).ci90`: the 90 % interval of the mean error between 1500 and 2500 rpm, over all fuels.
    """

    x: SurfaceAxis  # engine speed, p2 nodes
    y: SurfaceAxis  # fuel, p1 nodes
    values: Array  # (p2, p1) [unit], NaN where nothing is known
    standard_error: Array  # the same
    covariance: Array  # (p2 p1, p2 p1) [unit^2] of the nodes' errors, speed by speed; neighbours err alike
    origin: NDArray[np.int8]  # (p2, p1) where each value comes from, see ORIGINS
    unit: str  # of the values
    source: str  # group of the result that they are from

    def at(self, points: Sequence[tuple[float, float]]) -> joint.Joint:
        """Return the map at operating points, each a speed and a fuel, with the covariance of their errors.

        Raises DataError where the map has no value, or ends.
        """
        pairs = np.asarray(points, dtype=float)
        if pairs.ndim != 2 or pairs.shape[1] != 2:
            raise DataError(f"points: expected a list of pairs, with {self._ends()}")
        x, y = pairs.T
        weights = joint.at_weights(self.x.nodes, x)[:, :, None] * joint.at_weights(self.y.nodes, y)[:, None, :]
        if not np.all(weights.sum((1, 2)) > 0.0):
            raise DataError(f"points: a point is outside the map; expected {self._ends()}")
        return joint.combined(weights.reshape(x.size, -1), self.values.ravel(), self.covariance)

    def mean(self, region: Mapping[str, tuple[float, float]]) -> joint.Joint:
        """Return the mean over a region: from and to by the name of an axis; an axis without counts whole.

        Raises DataError for another axis, a region that leaves the map, or one with nodes without a value.
        """
        axes = (self.x, self.y)
        if other := sorted(set(region) - {axis.name for axis in axes}):
            raise DataError(f"region: the map has no axis '{other[0]}'; expected {self._ends()}")
        whole = {axis.name: (float(axis.nodes[0]), float(axis.nodes[-1])) for axis in axes} | dict(region)
        along = [joint.mean_weights(axis.nodes, *whole[axis.name]) for axis in axes]
        return joint.combined(np.outer(*along).reshape(1, -1), self.values.ravel(), self.covariance)

    def difference(self, other: "Surface") -> "Surface":
        """Return this map less another one, on the axes of this one; the errors of both count as independent.

        Raises DataError where the other has other inputs, or another unit.
        """
        for mine, its in ((self.x, other.x), (self.y, other.y)):
            if (mine.name, mine.unit, self.unit) != (its.name, its.unit, other.unit):
                raise DataError(
                    f"the maps are not alike: one is in {self.unit} over {mine.name} [{mine.unit}], the other in {other.unit} over "
                    f"{its.name} [{its.unit}]; compare maps of one kind of engine"
                )
        laid = onto(other, self.x.nodes, self.y.nodes)
        covariance = self.covariance + laid.covariance
        both = replace(
            self,
            values=self.values - laid.values,
            standard_error=np.sqrt(np.diag(covariance)).reshape(self.values.shape),
            covariance=covariance,
            origin=np.maximum(self.origin, laid.origin),
            source="difference",
        )
        return both.without((self.origin == NONE) | (laid.origin == NONE), NONE)

    def without(self, nodes: NDArray[np.bool_], why: int) -> "Surface":
        """Return the map without the values at some nodes, a mask of shape (p2, p1), whose origin is `why` from then on."""
        values, error = (np.where(nodes, np.nan, each) for each in (self.values, self.standard_error))
        origin = np.where(nodes, why, self.origin).astype(np.int8)
        return replace(self, values=values, standard_error=error, origin=origin)

    def without_wide(self, most: float) -> "Surface":
        """Return the map without the nodes whose 90 % interval is wider to either side than `most` [unit]."""
        return self.without((self.origin != NONE) & (joint.NORMAL_90 * self.standard_error > most), LEFT_OUT)

    def _ends(self) -> str:
        ends = (f"{axis.name} from {axis.nodes[0]:g} to {axis.nodes[-1]:g} {axis.unit}" for axis in (self.x, self.y))
        return " and ".join(ends)


def read_surface(path: Path, source: str = "") -> Surface:
    """Return `map` or `extrapolation` of a result, by default the latter if there; raises DataError where it is not."""
    with reading(path, *RESULT) as file:
        source = source or ("extrapolation" if "extrapolation" in file else "map")
        if source not in ("map", "extrapolation"):
            raise DataError(f"{path}: a result has no values named '{source}'; expected map or extrapolation")
        if source not in file:
            raise DataError(f"{path}: the result has no group /{source}; run `lpvobs extrapolate {path}` first")
        group, axes = file[source], axes_of(file)
        x, y = surface_axes(axes, read(group, grid_layout(axes)))
        unit, held = str(group["delta_W_c"].attrs["units"]), group if source == "extrapolation" else file["nodes"]
        covariance, layout = held["covariance"][()].astype(float), surface_layout(x.name, y.name, unit, "support")
        return read(group, layout, x=x, y=y, covariance=covariance, unit=unit, source=source)


def read_readings(path: Path, surface: Surface) -> Surface:
    """Return the mean reading around each node of a result [kg/s], on the axes of a surface; nothing where nobody drove."""
    with reading(path, *RESULT) as file:
        if "readings" not in file:
            raise DataError(
                f"{path}: has no /readings, so errors cannot be given as a share of the flow; run `lpvobs estimate` again"
            )
        own = read_surface(path, "map")
        values = file["readings/reading"][()].astype(float)
    known = np.where(np.isfinite(values), ESTIMATED, NONE).astype(np.int8)
    return onto(replace(own, values=np.nan_to_num(values), origin=known), surface.x.nodes, surface.y.nodes)


def mean_flow(path: Path) -> float:
    """Return the mean reading of all logs behind a result [kg/s]; raises DataError if the file is no result."""
    with reading(path, *RESULT) as file:
        logs = [(int(log.attrs["samples"]), float(log["mean_flow"][()])) for log in file["logs"].values()]
    if not logs:
        raise DataError(f"{path}: the result names no log; make it again with `lpvobs estimate`")
    return sum(samples * flow for samples, flow in logs) / sum(samples for samples, _ in logs)


def surface_axes(axes: Axes, grid: Grid) -> tuple[SurfaceAxis, SurfaceAxis]:
    """Return the axes of a surface on the nodes of a grid: speed, then fuel."""
    nodes = zip(axes.items(), (grid.fuel, grid.speed), strict=True)
    y, x = (SurfaceAxis(name, item.unit, item.meaning, each) for (name, item), each in nodes)
    return x, y


def surface_layout(x: str, y: str, unit: str, origin: str) -> Layout[Surface]:
    """Return how a surface stands in a group on axes of these names, where each value comes from under the name `origin`."""
    said, both = layout_of(NodeMap).items, (x, y)
    items = {
        "values": replace(said["theta"], unit=unit, axes=both),
        "standard_error": replace(said["standard_error"], unit=unit, axes=both),
        "origin": replace(said["supported"], name=origin, axes=both, meanings=ORIGINS),
    }
    return Layout(Surface, items)


def onto(surface: Surface, x: Array, y: Array) -> Surface:
    """Return a surface at other nodes x and y, shapes (p2',) and (p1',) in the units of its axes, bilinear as the map itself."""
    # A node counts as estimated only if every node that it leans on is; outside the surface nothing is known.
    weight_x, weight_y = joint.at_weights(surface.x.nodes, x), joint.at_weights(surface.y.nodes, y)
    inside = np.outer(weight_x.sum(axis=1) > 0, weight_y.sum(axis=1) > 0)

    def touched(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which new nodes lean on an old one of the mask."""
        return np.asarray((weight_x > 0).astype(float) @ mask.astype(float) @ (weight_y > 0).T > 0)

    origin = np.full(inside.shape, ESTIMATED)
    for code in (SMOOTHED, EXTRAPOLATED):
        origin[touched(surface.origin == code)] = code
    known = surface.origin != NONE
    weights = np.kron(weight_x, weight_y)
    covariance = weights @ surface.covariance @ weights.T
    laid = replace(
        surface,
        x=replace(surface.x, nodes=x),
        y=replace(surface.y, nodes=y),
        values=weight_x @ np.where(known, surface.values, 0.0) @ weight_y.T,
        standard_error=np.sqrt(np.diag(covariance)).reshape(inside.shape),
        covariance=covariance,
        origin=origin,
    )
    return laid.without(touched(~known) | ~inside, NONE)


def keep_old(surface: Surface, old: Array | None, only_estimated: bool) -> Surface:
    """Return the surface with old values, (p2, p1) or none, where it has none; if asked, also where it is not estimated."""
    kept = surface.origin != ESTIMATED if only_estimated else np.isin(surface.origin, (NONE, LEFT_OUT))
    if old is None:
        return surface.without(kept & (surface.origin != LEFT_OUT), NONE)
    return replace(surface.without(kept, OLD), values=np.where(kept, old, surface.values))
