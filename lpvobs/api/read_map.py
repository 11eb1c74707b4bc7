"""`read_map`: the map of a result as arrays, to be looked at in a notebook or handed to pandas and xarray."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvobs.api.files import File, as_path
from lpvobs.errors import UsageError
from lpvobs.io.results.results import read_result
from lpvobs.io.results.surfaces import ORIGINS, Surface, read_surface
from lpvobs.observer.estimate import ERROR
from lpvobs.report.tables import origin_counts

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


@dataclass(frozen=True, repr=False)
class Map(Surface):
    """The sensor's error over engine speed and fuel, bilinear between the nodes; a notebook shows it as a figure."""

    headline: str = ""  # what `estimate` said of it

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {name}" for name, count in origin_counts(self).items())
        axes = " over ".join((f"{self.y.name} [{self.y.unit}]", f"{self.x.name} [{self.x.unit}]"))
        return f"Map of the sensor error [{self.unit}], {axes}: {counts}" + (self.headline and f"; {self.headline}")

    def _repr_html_(self) -> str:
        from lpvobs.report.content import view_of
        from lpvobs.report.figures import error_limit, error_map

        view = view_of(self, self.origin > 1)
        drawn = error_map("map", "map of the sensor error", view, error_limit([view]))
        return f'<div style="max-width: 46rem">{drawn}<p>{self.headline}</p></div>'

    def plot(self, ax: "Axes | None" = None, **look: Any) -> "Axes":
        """Draw the map [g/s] into axes of matplotlib, by default into new ones; `look` goes to `pcolormesh`."""
        from matplotlib import pyplot

        ax = pyplot.subplots()[1] if ax is None else ax
        values = 1e3 * self.values
        largest = float(np.nanmax(np.abs(values), initial=1e-9))
        style: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest, "shading": "nearest"} | look
        mesh = ax.pcolormesh(self.y.nodes, self.x.nodes, values, **style)
        ax.figure.colorbar(mesh, ax=ax, label="sensor error [g/s]")
        ax.set_xlabel(f"{self.y.long_name} [{self.y.unit}]")
        ax.set_ylabel(f"{self.x.long_name} [{self.x.unit}]")
        return ax

    def to_pandas(self) -> "pd.DataFrame":
        """Return a row per node: both axes, value, standard error, and where the value comes from; the unit is that of the map."""
        import pandas as pd

        x, y = (each.ravel() for each in np.meshgrid(self.x.nodes, self.y.nodes, indexing="ij"))
        origin = [ORIGINS[int(code)] for code in self.origin.ravel()]
        columns = {self.x.name: x, self.y.name: y, "delta_W_c": self.values.ravel()}
        return pd.DataFrame(columns | {"standard_error": self.standard_error.ravel(), "origin": origin})

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset` with both axes as coordinates and units as attributes.

        Raises UsageError where xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            raise UsageError("to_xarray needs xarray; install it with: pip install 'lpvobs[notebook]'") from None
        axes = [(axis.name, axis.nodes, {"units": axis.unit, "long_name": axis.long_name}) for axis in (self.x, self.y)]
        both, unit = [name for name, *_ in axes], {"units": self.unit}
        contents = {
            "delta_W_c": (both, self.values, unit | {"long_name": ERROR}),
            "standard_error": (both, self.standard_error, unit),
            "origin": (both, np.vectorize(ORIGINS.get)(self.origin)),
        }
        return xarray.Dataset(contents, {axis[0]: axis for axis in axes})


def read_map(result: File, values: str = "") -> Map:
    """Return the map of a result as arrays: values and standard errors [kg/s], reading minus truth, over speed and fuel.

    Raises DataError if the file is no result, or lacks what is asked for.

    Parameters
    ----------
    values : str
        `map`: what was estimated, NaN elsewhere; `extrapolation`: every node; by default the latter if there is one.

    Examples
    --------
    `read_map("map.h5").to_pandas()`: a row per node. `.plot()`: a figure. `.mean({"n_e": (1500, 2500)}).ci90`: the 90 % interval of
    the mean error between 1500 and 2500 rpm, over all fuels.
    """
    path = as_path(result)
    return Map(**vars(read_surface(path, values)), headline=read_result(path).headline)
