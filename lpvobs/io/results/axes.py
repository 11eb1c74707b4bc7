"""The axes of the error map in a result: the fuel axis, then the speed axis."""

from collections.abc import Mapping
from dataclasses import replace

import h5py

from lpvobs.io.results.mapping import Layout
from lpvobs.maps.grid import Grid
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
