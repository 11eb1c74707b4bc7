"""The map of a result as arrays."""

from lpvobs.api.files import File, as_path
from lpvobs.io.calibration.surfaces import Surface, read_surface


def read_map(result: File, values: str = "") -> Surface:
    """Return the map of a result as arrays.

    Raises DataError if the file is no result, or lacks what is asked for.

    Parameters
    ----------
    result : path
    values : str
        `map`: what was estimated, NaN elsewhere; `extrapolation`: every node; by default the latter if there is one.

    Returns
    -------
    Surface
        `values` and `standard_error` of shape (p2, p1) [kg/s], reading minus truth; `origin` 0 none, 1 estimated,
        2 extrapolated; `x.nodes` of shape (p2,), `y.nodes` of shape (p1,), in the units of `x` and `y`.
    """
    return read_surface(as_path(result), values)
