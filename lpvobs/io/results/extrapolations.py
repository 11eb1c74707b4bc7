"""The filled map and its quadratic in a result, in HDF5."""

import math

import h5py

from lpvobs.io.results.axes import Axes, grid_layout
from lpvobs.io.results.hdf import Field, text, write_group
from lpvobs.io.results.mapping import Item, Layout, fields, read
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, Filled

GROUP = "extrapolation"
SUPPORT = {1: "estimated", 2: "extrapolated", 4: "smoothed"}
OUTER = "share of outer estimated nodes inside their 90 % interval when fitted without them"


def quadratic_layout(axes: Axes) -> Layout[Filled]:
    """Return how a filled map stands in a group, and Eq. (37) with it."""
    both = tuple(axes)[::-1]
    return Layout(
        Filled,
        {
            "coefficients": Item("1", "coefficients of Eq. (37), units in coefficient_units", ("coefficient",)),
            "coefficients_standard_error": Item(
                "1", "standard errors of the coefficients", ("coefficient",), of="standard_error"
            ),
            "delta_W_c": Item("kg/s", "sensor error, every node filled", both),
            "standard_error": Item(
                "kg/s", "standard error; of prediction where extrapolated", both, of="map_standard_error"
            ),
            "support": Item("1", "where the value comes from", both, meanings=SUPPORT),
            "covariance": Item("kg^2/s^2", "covariance of the nodes' errors", ("node", "other_node"), stored="f4"),
            "lack_of_fit": Item("kg/s", "standard deviation of the surface around the quadratic"),
            "lengths": Item("1", "over which the scatter is correlated, in the units of the axes", ("axis",)),
            "nodes": Item("1", "estimated nodes behind it"),
        },
        {
            "coefficient": "coefficient of Eq. (37)",
            "axis": "fuel, then speed",
            "node": "node in the order of Eq. (23): speed by speed",
            "other_node": "node in the order of Eq. (23): speed by speed",
        },
        ("method",),
    )


def write_extrapolation(file: h5py.File, axes: Axes, grid: Grid, fitted: Filled, outer_coverage: float) -> None:
    """Write `/extrapolation` in place of the one that is there."""
    if GROUP in file:
        del file[GROUP]
    fuel, speed = (axis.units for axis in axes.values())
    units = text(
        [
            f"kg/s/({fuel})^2",
            f"kg/s/({fuel})",
            f"kg/s/({speed})^2",
            f"kg/s/({speed})",
            f"kg/s/({fuel})/({speed})",
            "kg/s",
        ]
    )
    contents = fields(grid_layout(axes), grid) | fields(quadratic_layout(axes), fitted, {"coefficient": COEFFICIENTS})
    group = write_group(file, GROUP, contents | {"outer_coverage": Field(outer_coverage, "1", OUTER)})
    for name in ("coefficients", "coefficients_standard_error"):
        group[name].attrs["coefficient_units"] = units


def read_extrapolation(file: h5py.File, axes: Axes) -> tuple[Filled | None, float]:
    """Return what `/extrapolation` holds, and how often it is right at outer nodes; None and NaN where it is not there."""
    if GROUP not in file:
        return None, math.nan
    return read(file[GROUP], quadratic_layout(axes)), float(file[GROUP]["outer_coverage"][()])
