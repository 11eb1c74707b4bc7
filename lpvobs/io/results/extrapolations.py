"""The error map in a result: its axes, the fuel axis, then the speed axis; and the filled map with its quadratic."""

import math
from collections.abc import Mapping
from dataclasses import replace

import h5py

from lpvobs.io.results.hdf import Field, text, write_group
from lpvobs.io.results.mapping import Layout, fields, layout_of, read
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, Filled
from lpvobs.records import Item

Axes = Mapping[str, Item]
"""By name: first the fuel axis, then the speed axis."""
LONG_NAME = "error of the mass air flow sensor, reading minus truth"
ORIGIN = "where the value comes from"


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


def quadratic_layout(axes: Axes) -> Layout[Filled]:
    """Return how a filled map stands in a group, and Eq. (37) with it."""
    return layout_of(Filled, dict(zip(("fuel", "speed"), axes, strict=True)))


def write_extrapolation(file: h5py.File, axes: Axes, grid: Grid, fitted: Filled, outer_coverage: float) -> None:
    """Write `/extrapolation` in place of the one that is there."""
    if GROUP in file:
        del file[GROUP]
    fuel, speed = (axis.unit for axis in axes.values())
    powers = [f"/({fuel})^2", f"/({fuel})", f"/({speed})^2", f"/({speed})", f"/({fuel})/({speed})", ""]
    contents = fields(grid_layout(axes), grid) | fields(quadratic_layout(axes), fitted, {"coefficient": COEFFICIENTS})
    group = write_group(file, GROUP, contents | {"outer_coverage": Field(outer_coverage, "1", OUTER)})
    for name in ("coefficients", "coefficients_standard_error"):
        group[name].attrs["coefficient_units"] = text([f"kg/s{power}" for power in powers])


def read_extrapolation(file: h5py.File, axes: Axes) -> tuple[Filled | None, float]:
    """Return what `/extrapolation` holds, and how often it is right at outer nodes; None and NaN where it is not there."""
    if GROUP not in file:
        return None, math.nan
    return read(file[GROUP], quadratic_layout(axes)), float(file[GROUP]["outer_coverage"][()])
