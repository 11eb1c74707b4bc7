"""`report`: results or a calibrated engine, and the logs that belong to them, as tables, page and verdicts on gates."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from lpvobs.api.files import File, Files, as_path, as_paths, write_text, writing
from lpvobs.api.known_engine import known_engine, stored_config
from lpvobs.api.search_start import known_from, search_start
from lpvobs.discovery import imbalances, known_effects, residual
from lpvobs.errors import DataError, UsageError
from lpvobs.io.results import engines, fleets, hdf, refinements, results, surfaces
from lpvobs.report.content import Report, load, report_output
from lpvobs.report.engines import CalibrateOutput, told
from lpvobs.report.fit import ResidualFit, fit_along
from lpvobs.report.gates import Verdict, enforce, judge, junit_xml, parse_gate
from lpvobs.report.outputs import RegionMean, ReportOutput


def write_report(
    result: File,
    further: Files = (),
    *,
    html: File | None = None,
    gates: Sequence[str] = (),
    region: Mapping[str, tuple[float, float]] | None = None,
) -> ReportOutput:
    """Return how far the corrected sensor is from the truth, write the page if asked for, and judge the gates.

    Raises NotProven if a log fails a gate; the page is written all the same; DataError if a file cannot be used, or a log lacks
    the metric of a gate; UsageError if a gate cannot be understood.

    Parameters
    ----------
    further : path or several
        Logs that the results were made from (courses over time), and further results.
    html : path, optional
        The self-contained page to write.
    gates : sequence of str
        Such as `mean_relative_error<=0.02`; fractions are fractions.
    region : mapping of str to (float, float), optional
        From and to by the name of an axis: the mean of each map over it, with its interval.
    """
    done = make_report(result, further, html=html, gates=gates, region=region)
    enforce(done.verdicts)
    return done.content


@dataclass(frozen=True)
class Reported:
    """What a report says."""

    report: Report
    content: ReportOutput  # the object that `lpvobs report --json` prints, without its schema
    verdicts: tuple[Verdict, ...]  # of every gate on every log


def make_report(
    result: File,
    further: Files = (),
    *,
    html: File | None = None,
    gates: Sequence[str] = (),
    junit: File | None = None,
    region: Mapping[str, tuple[float, float]] | None = None,
) -> Reported:
    """Return what `write_report` does, and the verdicts of gates beside it, written as JUnit XML if asked for."""
    conditions = list(dict.fromkeys(map(parse_gate, [gates] if isinstance(gates, str) else gates)))
    if junit is not None and not conditions:
        raise UsageError(
            f"--junit {junit}: JUnit XML contains the outcome of gates, but no gate is given; add --gate, or drop --junit"
        )
    if junit is not None and html is not None and as_path(junit).resolve() == as_path(html).resolve():
        raise UsageError(f"--junit {junit}: --html names the same file; name two different files")
    paths = [as_path(result), *as_paths(further)]
    with ExitStack() as claims:
        page, suite = (None if each is None else claims.enter_context(writing(each, paths)) for each in (html, junit))
        report = load(paths)
        fits = [
            fit
            for name, stored in report.named
            for log in stored.logs
            if log.sha256 in report.paths
            for fit in fits_of((name, log.name), stored, report.paths[log.sha256])
        ]
        regions = [] if region is None else [_mean_over(name, item.path, region) for name, item in report.named]
        report = replace(report, fits=tuple(fits), regions=tuple(regions))
        content = report_output(report)
        if page is not None:
            from lpvobs.report.page import page as made

            write_text(page, made(report), paths)
        verdicts = judge(conditions, content.logs, content.results)
        if suite is not None:
            write_text(suite, junit_xml(verdicts, content.refused), paths)
    return Reported(report, content, verdicts)


def _mean_over(name: str, path: Path, region: Mapping[str, tuple[float, float]]) -> RegionMean:
    mean = surfaces.read_surface(path).mean(region)
    low, high = mean.ci90[0].tolist()
    where = ", ".join(f"{axis} {ends[0]:g} to {ends[1]:g}" for axis, ends in region.items())
    return RegionMean(result=name, region=where, value=float(mean.values[0]), ci90=(low, high))


def kind_of(path: Path) -> str:
    """Return what kind of file it says it is, such as result, engine or fleet; nothing where it does not say."""
    if path.is_file() and hdf.is_hdf5(path):
        with suppress(OSError), h5py.File(path, "r") as file:  # of a damaged one, whoever reads it says so
            return str(file.attrs.get("schema", "")).partition("/")[2].partition("/")[0]
    return ""


def report_fleet(fleet: File, *, html: File | None = None) -> fleets.StoredFleet:
    """Return a fleet, and write its page if asked for; raises DataError if the file is none."""
    path = as_path(fleet)
    stored = fleets.read_fleet(path)
    if html is not None:
        from lpvobs.report.page import fleet_page

        write_text(html, fleet_page(path.stem, stored), [path])
    return stored


def report_engine(engine: File, *, html: File | None = None) -> CalibrateOutput:
    """Return what is known of a calibrated engine, and write its page if asked for; raises DataError if the file is none."""
    path = as_path(engine)
    stored = engines.read_engine(path, stored_config(path, engines.KIND, engines.REMEDY).engine_path())
    found = told(stored, str(path))
    if html is not None:
        from lpvobs.report.page import rendered

        write_text(html, rendered("engine.html", name=path.name, stored=stored, found=found), [path])
    return found


def fits_of(names: tuple[str, str], stored: results.StoredResult, path: Path) -> Iterator[ResidualFit]:
    """Yield the fit of every balance that predicts the reading; none where the method of the map does not tell of the engine.

    `names` are those of result and log.
    """
    # The prediction is the flow past the sensor by the balance, with the constants that were found, plus the map: y - e.
    engine = known_engine(stored)
    model = engine.residual_model()
    log = engine.read(path)
    refined = results.read_beside(stored.path, "refinement", refinements.StoredRefinement)
    try:
        known = known_from(stored, model, engine.config.estimate.prior_map, engine.calibrated)
        start = search_start(model, known, refined, [log])
        problem = residual.lay_out(start.model, stored.grid, start.prior, [log])
    except DataError:  # another method, or too short: the other tables say so
        return
    terms = [known_effects.term_on(effect, problem, [log]) for effect in (() if refined is None else refined.effects)]
    at = np.zeros(len(problem.covariance))
    left = imbalances.imbalances_at(problem, imbalances.scenes_with(problem, terms, at), at)
    left = left if left.shape[1] == problem.K else 0.5 * (left[:, : problem.K] + left[:, problem.K :])
    fuel, speed = (problem.along(axis.channel) for axis in engine.air_path.axes)
    mean = np.where(stored.supported, start.prior.mean.reshape(stored.grid.shape), np.nan)
    theta = stored.grid.interpolate(mean, fuel, speed)
    measured = problem.along(engine.air_path.sensor)
    inputs = problem.inputs()
    for balance, e, slope, shown in zip(model.balances, left, problem.by_reading, problem.shown, strict=True):
        if np.any(slope != 0.0):
            with np.errstate(divide="ignore", invalid="ignore"):
                predicted = np.where(shown, measured - (e / slope - theta), np.nan)
            found = fit_along((*names, balance), problem.time, measured, predicted, inputs)
            if found is not None:
                yield found
