"""The filled map and its quadratic in a result, in HDF5."""

import math
from dataclasses import dataclass

import h5py

from lpvobs.io.results.axes import Axes, grid_layout
from lpvobs.io.results.hdf import text, write_group
from lpvobs.io.results.mapping import Item, Layout, fields, read
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, QuadraticFit

GROUP = "extrapolation"


@dataclass(frozen=True)
class _Coverage:
    outer_coverage: float


COVERAGE = Layout(
    _Coverage,
    {
        "outer_coverage": Item(
            "1", "share of outer estimated nodes inside their 90 % interval when fitted without them", gaps=True
        )
    },
)


def quadratic_layout(axes: Axes) -> Layout[QuadraticFit]:
    """Return how Eq. (37) stands in a group, and the map that is filled by it."""
    both = tuple(axes)[::-1]
    return Layout(
        QuadraticFit,
        {
            "coefficients": Item("1", "coefficients of Eq. (37), units in coefficient_units", ("coefficient",)),
            "coefficients_standard_error": Item(
                "1", "standard errors of the coefficients", ("coefficient",), of="standard_error"
            ),
            "delta_W_c": Item("kg/s", "sensor error, every node filled", both),
            "standard_error": Item(
                "kg/s", "standard error; of prediction where extrapolated", both, of="map_standard_error"
            ),
            "support": Item("1", "where the value comes from", both, meanings={1: "estimated", 2: "extrapolated"}),
            "lack_of_fit": Item("kg/s", "standard deviation of the surface around the quadratic"),
            "nodes": Item("1", "nodes that the quadratic was fitted to"),
        },
        {"coefficient": "coefficient of Eq. (37)"},
    )


def write_extrapolation(file: h5py.File, axes: Axes, grid: Grid, fitted: QuadraticFit, outer_coverage: float) -> None:
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
    contents |= fields(COVERAGE, _Coverage(outer_coverage))
    group = write_group(file, GROUP, contents)
    for name in ("coefficients", "coefficients_standard_error"):
        group[name].attrs["coefficient_units"] = units


def read_extrapolation(file: h5py.File, axes: Axes) -> QuadraticFit | None:
    """Return what `/extrapolation` holds, None where it is not there."""
    return read(file[GROUP], quadratic_layout(axes)) if GROUP in file else None


def read_outer_coverage(file: h5py.File) -> float:
    """Return how often the quadratic holds at outer nodes, NaN where there is none."""
    return read(file[GROUP], COVERAGE).outer_coverage if GROUP in file else math.nan
