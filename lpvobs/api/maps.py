"""The map of the sensor's error: estimated, filled, read."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from lpvobs.api.files import File, Progress, as_path, changing, silent, some, writing

if TYPE_CHECKING:
    from lpvobs.io.calibration.surfaces import Surface
    from lpvobs.maps.quadratic import QuadraticFit
    from lpvobs.api.estimate import Estimated


def estimate(
    config: File,
    logs: File | Iterable[File],
    out: File,
    *,
    gain: File | None = None,
    method: str = "observer",
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> "Estimated":
    """Estimate the error map of the sensor from logs and write the result.

    Parameters
    ----------
    config : path
    logs : path or several
        Parquet logs, patterns, or folders of logs.
    out : path
        The result to write.
    gain : path, optional
        Made by `synth_gain`; without it one is made and proven first.
    method : str
        `observer`; `published`: Gamma = 200 I, as in the paper; `ekf`; `batch`.
    jobs : int, optional
        Logs done at the same time, one per process.
    scheduler : str, optional
        Address of a Dask scheduler, on whose workers the logs are done.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Returns
    -------
    Estimated
        `estimate.theta` and `estimate.standard_error` of shape (p,) [kg/s], the map's nodes in the order of Eq. (23);
        `summaries` of the logs, with metrics where a log has references; `refused`: why other logs were left out.

    Raises
    ------
    UsageError
        For an unknown method, or logs that are there twice.
    DataError
        If the gain or none of the logs can be used, or they inform no node.
    NotProven
        If the certificate of the gain does not hold.

    Notes
    -----
    Eq. (26) with gains that fall with information; see `docs/method.md` for the departures from the paper.
    """
    from lpvobs.io.configuration.config import load_config
    from lpvobs.io.logs.finding import find_logs
    from lpvobs.api.estimate import estimate_logs, gain_for, workplace_for

    paths = find_logs(some(logs, "log"))
    given = None if gain is None else as_path(gain)
    with writing(as_path(out), [as_path(config), *paths, *([given] if given else [])]) as target:
        configuration, text = load_config(as_path(config))
        workplace = workplace_for(method, len(paths), jobs, scheduler)
        stored = gain_for(configuration, paths, given, method)
        return estimate_logs(configuration, text, stored, paths, target, method, progress or silent, workplace)


def extrapolate(result: File) -> tuple["QuadraticFit", float]:
    """Fill the nodes that no log informed from the quadratic of Eq. (37), and write `/extrapolation` into the result.

    Returns
    -------
    fitted : QuadraticFit
        Coefficients in kg/s, mg/cycle and rpm with standard errors, values and intervals of prediction for every node.
    outer_coverage : float
        Share of the outer estimated nodes inside their 90 % interval when they take no part in the fit.

    Raises
    ------
    DataError
        If the file is no result, or its nodes do not determine the quadratic.
    """
    from lpvobs.api.extrapolate import extrapolate_result

    with changing(as_path(result)) as path:
        return extrapolate_result(path)


def read_map(result: File, values: str = "") -> "Surface":
    """Return the map of a result as arrays.

    Parameters
    ----------
    result : path
    values : str
        `map`: what was estimated, NaN elsewhere; `extrapolation`: every node; by default the latter if there is one.

    Returns
    -------
    Surface
        `values` and `standard_error` of shape (p2, p1) [kg/s], reading minus truth; `origin` 0 none, 1 estimated,
        2 extrapolated; `x.nodes` of shape (p2,) [rpm], `y.nodes` of shape (p1,) [mg/cycle].

    Raises
    ------
    DataError
        If the file is no result, or lacks what is asked for.
    """
    from lpvobs.io.calibration.surfaces import read_surface

    return read_surface(as_path(result), values)
