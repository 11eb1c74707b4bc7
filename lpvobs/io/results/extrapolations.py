"""The filled map and its quadratic in a result, in HDF5."""

import h5py
import numpy as np

from lpvobs.io.results.hdf import Field, flags, number, numbers, text, write_group
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import COEFFICIENTS, QuadraticFit


def write_extrapolation(file: h5py.File, axes: tuple[str, str], fitted: QuadraticFit, outer_coverage: float) -> None:
    """Write `/extrapolation` in place of the one that is there; `axes` are the names of the fuel and the speed axis."""
    if "extrapolation" in file:
        del file["extrapolation"]
    nodes = {
        name: Field(file["map"][name][()], file["map"][name].attrs["units"], file["map"][name].attrs["long_name"])
        for name in axes
    }
    fuel, speed = (nodes[name].units for name in axes)
    units = (
        f"kg/s/({fuel})^2",
        f"kg/s/({fuel})",
        f"kg/s/({speed})^2",
        f"kg/s/({speed})",
        f"kg/s/({fuel})/({speed})",
        "kg/s",
    )
    units_of_each = {"coefficient_units": text(units)}
    write_group(
        file,
        "extrapolation",
        nodes
        | {
            "coefficient": Field(text(COEFFICIENTS), "1", "coefficient of Eq. (37)"),
            "coefficients": Field(
                fitted.coefficients,
                "1",
                "coefficients of Eq. (37), units in coefficient_units",
                ("coefficient",),
                units_of_each,
            ),
            "coefficients_standard_error": Field(
                fitted.standard_error, "1", "standard errors of the coefficients", ("coefficient",), units_of_each
            ),
            "delta_W_c": Field(fitted.delta_W_c, "kg/s", "sensor error, every node filled", axes[::-1]),
            "standard_error": Field(
                fitted.map_standard_error, "kg/s", "standard error; of prediction where extrapolated", axes[::-1]
            ),
            "support": Field(
                fitted.support,
                "1",
                "where the value comes from",
                axes[::-1],
                flags([1, 2], ["estimated", "extrapolated"]),
            ),
            "lack_of_fit": Field(fitted.lack_of_fit, "kg/s", "standard deviation of the surface around the quadratic"),
            "nodes": Field(fitted.nodes, "1", "nodes that the quadratic was fitted to"),
            "outer_coverage": Field(
                outer_coverage,
                "1",
                "share of outer estimated nodes inside their 90 % interval when fitted without them",
            ),
        },
    )


def read_extrapolation(file: h5py.File, grid: Grid) -> QuadraticFit | None:
    """Return what `/extrapolation` holds, None where it is not there."""
    if "extrapolation" not in file:
        return None
    group = file["extrapolation"]
    return QuadraticFit(
        coefficients=numbers(group, "coefficients", len(COEFFICIENTS)),
        standard_error=numbers(group, "coefficients_standard_error", len(COEFFICIENTS)),
        lack_of_fit=number(group, "lack_of_fit"),
        nodes=int(number(group, "nodes")),
        delta_W_c=numbers(group, "delta_W_c", *grid.shape),
        map_standard_error=numbers(group, "standard_error", *grid.shape),
        support=numbers(group, "support", *grid.shape).astype(np.int8),
    )
