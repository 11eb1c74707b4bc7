"""What a page shows, as plain frozen data, and the results and logs that it is made of; the object of `report --json`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.base import MapAxis
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import DataError, UsageError
from lpvobs.ingest.record import stored_record
from lpvobs.io.configuration.config import config_of
from lpvobs.io.logs.parquet import log_digest
from lpvobs.io.logs.policies import Reading
from lpvobs.io.logs.reading import read_log, read_references
from lpvobs.io.results.hdf import is_hdf5
from lpvobs.io.results.results import REMEDY, StoredResult, read_result
from lpvobs.io.results.surfaces import Surface
from lpvobs.maps.excitation import excitation
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import best_fit
from lpvobs.records import Array
from lpvobs.report import outputs
from lpvobs.report.discovered import GROUPS, Discovered, read_discovered, sentence
from lpvobs.report.fit import ResidualFit
from lpvobs.report.spoken import cycle_title, distinct, paper_error

SEEN = 0.1
"""[s], how long a drive must inform a node for the fit to the references to show a value there."""
OF_FIT = ("fit", "lags_outside", "input_lags_outside")
"""Metrics of a log that its best fit has, None where there is no fit."""


@dataclass(frozen=True)
class SurfaceView:
    """A map on the nodes of a grid."""

    grid: Grid
    axes: tuple[MapAxis, MapAxis]  # fuel, speed
    values: Array  # (p_2, p_1) [kg/s], NaN where there is none
    filled: NDArray[np.bool_]  # (p_2, p_1) where the value is extrapolated
    doubtful: NDArray[np.bool_] | None = None  # (p_2, p_1) see `doubtful_nodes`


def view_of(surface: Surface, filled: NDArray[np.bool_]) -> SurfaceView:
    """Return a stored surface as it is drawn; `filled` says where its values are extrapolated."""
    fuel, speed = (MapAxis(axis.name, axis.unit, axis.long_name) for axis in (surface.y, surface.x))
    return SurfaceView(Grid(surface.y.nodes, surface.x.nodes), (fuel, speed), surface.values, filled)


@dataclass(frozen=True)
class Drive:
    """A log over time, N samples."""

    time: Array  # (N,) [s]
    fuel: Array  # (N,) the map's first input, in its unit
    speed: Array  # (N,) the map's second input, in its unit
    measured: Array  # (N,) [kg/s], the sensor's reading
    segments: tuple[tuple[int, int], ...]
    reference: Array | None  # (N,) [kg/s], the sensor's true error, where the log has it
    true_flow: Array | None  # (N,) [kg/s], where the log has it
    ingest: Mapping[str, Any] | None  # what `ingest` did to make the log, None for one that was not ingested
    surface: SurfaceView | None  # the bilinear map that fits the reference best, at the nodes that the drive informs


@dataclass(frozen=True)
class ResultView:
    """One result: its name on the page, what is stored, what was found on it, and the maps to draw."""

    name: str
    stored: StoredResult
    discovered: tuple[Discovered, ...] = ()

    @property
    def axes(self) -> tuple[MapAxis, MapAxis]:
        """The map's inputs: fuel, speed."""
        return ENGINES[self.stored.air_path].air_path.axes

    @property
    def estimated(self) -> SurfaceView:
        """The map as it was estimated."""
        return self._surface(self.stored.theta, np.zeros(self.stored.grid.shape, dtype=bool))

    @property
    def extrapolated(self) -> SurfaceView | None:
        """The map with its empty nodes filled, None where it has not been extrapolated."""
        fitted = self.stored.extrapolation
        return None if fitted is None else self._surface(fitted.delta_W_c, fitted.support == 2)

    def _surface(self, values: Array, filled: NDArray[np.bool_]) -> SurfaceView:
        doubtful = doubtful_nodes(self.stored.supported, self.stored.standard_error)
        return SurfaceView(self.stored.grid, self.axes, values, filled, doubtful)

    @property
    def errors(self) -> SurfaceView:
        """The standard error of every estimated node."""
        return SurfaceView(self.stored.grid, self.axes, self.stored.standard_error, ~self.stored.supported)

    @property
    def deviation(self) -> Array:
        """Standard error of every node, that of prediction where it is extrapolated, shape (p_2, p_1) [kg/s]; NaN for none."""
        fitted = self.stored.extrapolation
        return self.stored.standard_error if fitted is None else fitted.map_standard_error


@dataclass(frozen=True)
class CycleView:
    """One log with the results that were made from it; without `drive` where the log was not given."""

    title: str
    results: tuple[ResultView, ...]
    printed: bool  # whether the paper prints an error for this cycle, and the log knows its own
    drive: Drive | None


@dataclass(frozen=True)
class Report:
    """All that a page shows: results in the order given, and the logs that were given, by the digest of each."""

    results: tuple[ResultView, ...]
    paths: Mapping[str, Path]
    drives: Mapping[str, Drive]
    fits: tuple[ResidualFit, ...] = ()  # how well the results follow the logs that were given
    regions: tuple[outputs.RegionMean, ...] = ()

    @property
    def named(self) -> list[tuple[str, StoredResult]]:
        """The results as stored, each under a name of its own."""
        return [(view.name, view.stored) for view in self.results]

    @property
    def sentences(self) -> list[str]:
        """What `trace` and `refine` have found on each result."""
        return [f"{view.name}: {sentence(item)}" for view in self.results for item in view.discovered]

    @property
    def cycles(self) -> list[CycleView]:
        """Every log that made one of the results."""
        logs = {log.sha256: log.name for view in self.results for log in view.stored.logs}
        return [self._cycle(digest, name) for digest, name in logs.items()]

    def _cycle(self, digest: str, name: str) -> CycleView:
        made = [(view, log) for view in self.results for log in view.stored.logs if log.sha256 == digest]
        printed = any(log.metrics and paper_error(view.stored.air_path, name) is not None for view, log in made)
        return CycleView(cycle_title(name), tuple(view for view, _ in made), printed, self.drives.get(digest))

    @property
    def best_fits(self) -> dict[tuple[str, str], ResidualFit]:
        """The balance that follows each log best, by the names of result and log."""
        ordered = sorted(self.fits, key=lambda fit: -fit.rms)
        return {(fit.result, fit.log): fit for fit in ordered}


def load(paths: Sequence[Path]) -> Report:
    """Return what a page shows of the results and logs in files, told apart by content; the first is a result.

    Raises DataError if a file cannot be used, or a log belongs to none of the results.
    """
    first, *further = paths
    for path in further:
        if not path.is_file():
            raise DataError(f"{path}: no such file; name result files, or logs from which these results were made")
    inner = [path for path in further if is_hdf5(path)]
    results = [read_result(path) for path in (first, *inner)]
    logs = {log_digest(path): path for path in further if path not in inner}
    discovered = [read_discovered(result.path) for result in results]
    names = distinct([result.path for result in results])
    drives = {digest: _drive(path, digest, results) for digest, path in logs.items()}
    return Report(tuple(map(ResultView, names, results, discovered)), logs, drives)


def _drive(path: Path, digest: str, results: Sequence[StoredResult]) -> Drive:
    owner = next((result for result in results if any(log.sha256 == digest for log in result.logs)), None)
    if owner is None:
        raise DataError(
            f"{path}: none of the given results was made from this log (SHA-256 {digest[:12]}...); "
            f"expected a log that `lpvobs estimate` read, unchanged; leave this log out, or run `lpvobs estimate` on it first"
        )
    air_path, grid = ENGINES[owner.air_path].air_path, owner.grid
    log = read_log(path, air_path.channels, _reading(owner))
    references = read_references(path, log.rows) or {}
    fuel, speed = (log[axis.channel] for axis in air_path.axes)
    reference, surface = references.get("ref_delta_W_c"), None
    if reference is not None and (known := np.isfinite(reference)).any():
        best = best_fit(grid, *grid.regressors(fuel[known], speed[known]), reference[known])
        informed = excitation(grid, fuel, speed, log.time, log.segments).nodes() >= SEEN
        values = np.where(informed, best, np.nan).reshape(grid.shape)
        surface = SurfaceView(grid, air_path.axes, values, np.zeros(grid.shape, dtype=bool))
    return Drive(
        time=log.time,
        fuel=fuel,
        speed=speed,
        measured=log[air_path.sensor],
        segments=log.segments,
        reference=reference,
        true_flow=references.get("ref_W_c"),
        ingest=stored_record(path),
        surface=surface,
    )


def _reading(result: StoredResult) -> Reading:
    """Return how the log was read when the result was made: a slow sensor that was put right then is put right here."""
    try:
        return config_of(result.provenance.config, result.path).reading
    except UsageError as error:
        raise DataError(f"{error}; the configuration in this file is damaged; {REMEDY}") from None


def doubtful_nodes(supported: NDArray[np.bool_], standard_error: Array) -> NDArray[np.bool_]:
    """Return the estimated nodes that stand alone and are poorly known, shape (p_2, p_1).

    Alone: at most one of the four neighbours is estimated. Poorly known: the standard error is above the middle one. Such a node
    leans on a few seconds of driving, and no neighbour would show that they went wrong.
    """
    padded = np.pad(supported, 1).astype(int)
    beside = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    if not supported.any():
        return supported
    return np.asarray(supported & (beside <= 1) & (standard_error > np.median(standard_error[supported])))


def report_output(report: Report) -> outputs.ReportOutput:
    """Return the object of `report --json`."""
    results, best = [_result_output(view) for view in report.results], report.best_fits
    logs = [
        outputs.ReportedLog(
            result=name,
            method=result.method,
            paper_mean_relative_error=paper_error(result.air_path, log.name),
            **outputs.log_fields(log) | {key: getattr(best.get((name, log.name)), key, None) for key in OF_FIT},
        )
        for name, result in report.named
        for log in result.logs
    ]
    return outputs.ReportOutput(
        logs=logs,
        map=results[0].map,
        extrapolation=results[0].extrapolation,
        results=results,
        regions=report.regions,
        fits=report.fits,
        refused=[f"{name}: {line}" for name, result in report.named for line in result.refused],
    )


def _result_output(view: ResultView) -> outputs.ReportedResult:
    result, found = view.stored, {GROUPS[item.verb]: item.content for item in view.discovered}
    fitted, nodes = result.extrapolation, int(result.supported.sum())
    more = 0 if fitted is None else int((fitted.support == 2).sum())
    errors = result.standard_error[result.supported]
    sought = found.get("trace") or found.get("refinement") or {"verdict": None, "error": {}}
    return outputs.ReportedResult(
        result=view.name,
        file=str(result.path),
        method=result.method,
        map=outputs.MapCounts(cells=result.grid.size, estimated=nodes, extrapolated=more),
        nodes_estimated=nodes,
        standard_error=float(np.median(errors)) if errors.size and (errors > 0.0).all() else None,
        balance_agreement=result.balance_agreement,
        verdict=sought["verdict"],
        residual=sought["error"].get("after", sought["error"].get("before")),
        extrapolation=None if fitted is None else outputs.QuadraticOutput(**outputs.quadratic_fields(fitted)),
        gain=outputs.ReportedGain(
            **outputs.gain_fields(result.gain), smallest_pivot=result.gain.gain.certificate.smallest_pivot
        ),
        **found,
    )
