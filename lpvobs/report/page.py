"""Content and figures into one self-contained HTML page."""

import re
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Any

import jinja2
import numpy as np

from lpvobs import __version__
from lpvobs.engines.registry import ENGINES
from lpvobs.maps.excitation import Plan, plan
from lpvobs.report import figures, surface_figures, tables
from lpvobs.report.content import CycleView, Report, ResultView, SurfaceView
from lpvobs.report.courses import course_data
from lpvobs.report.discovered import sentences
from lpvobs.report.names import cycle_title, method_title, paper_error
from lpvobs.report.outputs import RegionMean
from lpvobs.report.residual import Picture, Section, fit_section, picture, residual_sections
from lpvobs.report.spoken import headline

TEMPLATE = "report.html.j2"
_NOT_SHOWN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What names from files may hold and a page may not: controls, letters that turn the direction of others, halves of letters."""


def page(report: Report, regions: Sequence[RegionMean] = ()) -> str:
    """Return the page as text; the same content gives the same text."""
    named = [(view.name, view.stored) for view in report.results]
    widest = max((stored for _, stored in named), key=lambda stored: len(stored.gain.log_bounds))
    paper = tables.beside_paper(named)
    printed = [ENGINES[stored.air_path].published for _, stored in named if paper and stored.extrapolation is not None]
    cycles = list(enumerate(report.cycles))
    return rendered(
        "",
        verdicts=[
            *(line for view in report.results for line in verdict(view)),
            *sentences([(v.name, v.discovered) for v in report.results]),
            *map(tables.region_line, regions),
        ],
        summary=tables.told(tables.report_rows(named)),
        referenced=any(log.metrics is not None for _, stored in named for log in stored.logs),
        maps=[Section(each.title, tuple(_maps(each, f"c{number}"))) for number, each in cycles],
        quality=[Section(view.name, tuple(_quality(view, number))) for number, view in enumerate(report.results)],
        driving=list(_driving(report)),
        residuals=[*filter(None, [fit_section(report.fits)])]
        + [part for number, view in enumerate(report.results) for part in residual_sections(view, number)],
        cycles=[
            (Section(each.title, tuple(_courses(each, f"t{number}"))), course_data(each, each.drive))
            for number, each in cycles
            if each.drive is not None
        ],
        script=(files("lpvobs.report") / "templates" / "course.js").read_text(encoding="utf-8"),
        bounds=tables.bounds_table(widest.gain, widest.logs, paper),
        coefficients=tables.coefficient_tables(named, paper),
        paper=paper,
        remarks=list(dict.fromkeys(found.remark for found in printed if found is not None)),
        held=[
            (view.name, tables.percent(view.stored.outer_coverage, 0))
            for view in report.results
            if view.stored.extrapolation is not None
        ],
        gains=[(view.name, tables.gain_line(view.stored.gain), gain_rows(view)) for view in report.results],
        defects=defect_rows(report),
        ingested=[
            (tables.ingest_notes(each.drive.ingest), tables.ingest_rows(each.drive.ingest))
            for each in report.cycles
            if each.drive is not None and each.drive.ingest is not None
        ],
        refused=[line for view in report.results for line in view.stored.refused],
        origins=[(view.name, view.stored.provenance) for view in report.results],
    )


def rendered(body: str, **content: Any) -> str:
    """Return the page with another template as its body, if one is named, without what a browser would obey instead of showing."""
    folder = files("lpvobs.report") / "templates"
    text = (folder / TEMPLATE).read_text(encoding="utf-8")
    if body:
        text = text[: text.index("<body>")] + (folder / body).read_text(encoding="utf-8")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    return _NOT_SHOWN.sub("\ufffd", environment.from_string(text).render(version=__version__, **content))


def verdict(view: ResultView) -> Iterator[str]:
    """Yield what a result says, and how far it is from the truth on every log that knows it."""
    stored = view.stored
    says = stored.headline or headline(stored.grid, view.axes, stored.theta, stored.covariance, stored.supported)
    nodes = f"{int(stored.supported.sum())} of {stored.grid.size} nodes estimated"
    yield f"{view.name} ({method_title(stored.method)}): {says}. {nodes}."
    for log in stored.logs:
        if (m := log.metrics) is not None:
            beside = paper_error(stored.air_path, log.name)
            paper = f"; the paper reports {tables.percent(beside)}" if beside is not None else ""
            constant = ENGINES[stored.air_path].air_path.rate_names
            held = f", {' and '.join(constant)} held constant" if stored.method == "published" else ""
            yield (
                f"{view.name}: on {cycle_title(log.name)}, the map differs from the sensor's true error by "
                f"{tables.percent(m.mean_relative_error)} on average (best bilinear map on this grid: "
                f"{tables.percent(m.floor_mean_relative_error)}{paper}) and by {tables.grams(m.rmse)} g/s rms. "
                f"Stability is proven for {tables.percent(log.share_certified, 1)} of the samples{held}."
            )
    if all(log.metrics is None for log in stored.logs):
        yield "The logs have no reference channels, so the true error is unknown; the 90 % intervals show how accurate the map is."


def gain_rows(view: ResultView) -> tables.Table:
    """Return L with the names of its rows and columns."""
    gain = view.stored.gain
    rows = [[state, *(f"{value:.5g}" for value in row)] for state, row in zip(gain.states, gain.gain.L, strict=True)]
    return ["L", *gain.outputs, "sensor"], rows


def defect_rows(report: Report) -> tables.Table:
    """Return what was found wrong with every log and dropped."""
    header = ["log", "samples used", "samples read", "dropped", "causes", "gaps"]
    header += ["time repeated or backward", "duration s"]
    rows = {}
    for view in report.results:
        for log in view.stored.logs:
            causes = ", ".join(f"{name} {count}" for name, count in ({**log.dropped, **log.found}).items()) or "-"
            counts = [str(log.samples), str(log.samples_read), str(log.dropped_rows), causes, str(log.gaps)]
            rows[log.sha256] = [log.name, *counts, str(log.repeated), f"{log.duration:.1f}"]
    return header, list(rows.values())


def _maps(cycle: CycleView, name: str) -> Iterator[Picture]:
    """Yield the map of every result of a log, as it was estimated, filled, in space and cut open."""
    shown = [correction.result.estimated for correction in cycle.corrections]
    drive, title = cycle.drive, cycle.title
    limit = figures.error_limit([*shown, *([drive.surface] if drive and drive.surface else [])])

    def printed(numbers: str) -> str:
        return f" ({numbers})" if cycle.printed else ""

    if drive is not None and drive.surface is not None:
        yield picture(
            figures.error_map(f"{name}-ref", f"reference error, {title}", drive.surface, limit),
            f"True error of the sensor (reference) at the nodes that the drive informs, as the best bilinear "
            f"map{printed('the paper: Figure 3')}.",
        )
    for index, view in enumerate(each.result for each in cycle.corrections):
        own, what = f"{name}-r{index}", f"{title}, {method_title(view.stored.method)}"
        doubted = " Dotted frames mark doubtful nodes: few estimated neighbours and a large standard error."
        yield picture(
            figures.error_map(f"{own}-map", f"estimated map, {what}", view.estimated, limit),
            f"Estimated error map, {what}{printed('Figures 5a, 8a')}. The drive gives no information on empty nodes."
            + (doubted if view.estimated.doubtful is not None and view.estimated.doubtful.any() else ""),
        )
        if view.extrapolated is not None:
            yield picture(
                figures.error_map(f"{own}-full", f"extrapolated map, {what}", view.extrapolated, limit),
                f"The estimated map with its empty nodes filled{printed('Figures 5b, 8b')}. Hatched nodes are extrapolated.",
            )
        whole = view.extrapolated or view.estimated
        if np.isfinite(view.stored.theta).any():
            yield picture(
                surface_figures.surface_view(f"{own}-space", f"map in space, {what}", whole, limit),
                f"The map as a surface, {what}. Extrapolated parts are pale.",
            )
            yield picture(
                surface_figures.cuts(f"{own}-cuts", f"cuts through the map, {what}", whole, view.deviation),
                f"Cuts through the map with 90 % intervals, {what}. Marks are estimated nodes; dashed lines are extrapolated.",
            )
    if drive is not None:
        yield picture(
            figures.trajectory(f"{name}-path", f"operating points, {title}", cycle, drive, shown[0]),
            f"Operating points of the drive on the grid of the map{printed('Figures 4b, 7b')}.",
        )


def _courses(cycle: CycleView, name: str) -> Iterator[Picture]:
    """Yield the courses over time: the first one is what the script replaces; the paper's own figures in its comparison alone."""
    drive = cycle.drive
    if drive is None:
        return
    for index, correction in enumerate(cycle.corrections):
        what = f"{cycle.title}, {method_title(correction.result.stored.method)}"
        yield picture(
            figures.flow_course(f"{name}-f{index}", f"flows over time, {what}", drive, correction),
            f"Sensor reading before and after the correction, {what}{' (Figures 6b, 9b)' if cycle.printed else ''}.",
        )
        if drive.reference is not None and correction.estimate is not None:
            yield picture(
                figures.error_course(f"{name}-e{index}", f"errors over time, {what}", drive, correction),
                f"True (reference) and estimated error of the sensor, {what}{' (Figures 6a, 9a)' if cycle.printed else ''}.",
            )
    if cycle.printed:
        yield picture(
            figures.drive_course(f"{name}-drive", f"fuel and speed over time, {cycle.title}", cycle, drive),
            "Fuel quantity and engine speed over time (Figures 4a, 7a).",
        )


def _driving(report: Report) -> Iterator[Section]:
    for number, view in enumerate(report.results):
        found = plan_of(view)
        if found is not None and found.cells:
            shown = surface_figures.plan_map(f"p{number}", f"cells to drive next, {view.name}", view.estimated, found)
            caption = "Time to drive in each cell. The numbered frames are the cells of the table."
            table = drive_rows(view, found), f"Cells where a second of driving improves the map most, {view.name}"
            yield Section(view.name, (picture(shown, caption),), (table,))


def _quality(view: ResultView, number: int) -> Iterator[Picture]:
    errors = SurfaceView(view.stored.grid, view.axes, view.stored.standard_error, ~view.stored.supported)
    if (view.stored.standard_error > 0).any():
        yield picture(
            figures.standard_error_map(f"q{number}-se", f"standard error, {view.name}", errors),
            "Standard error of every estimated node. It includes the tolerance of the engine constants.",
        )
    yield picture(
        figures.excitation_map(f"q{number}-pe", f"excitation, {view.name}", view.estimated, view.stored.excitation),
        "Excitation of every cell by the drive: the smallest eigenvalue of the integral in Eq. (29).",
    )


def plan_of(view: ResultView) -> Plan | None:
    """Return what to drive next, None where the result's method says nothing of its noise."""
    # Estimated nodes count with their noise, extrapolated ones with their error of prediction; a node without any value
    # counts as wrong by as much as the estimated ones are large.
    stored = view.stored
    if not stored.supported.any() or not (stored.standard_error > 0).any():
        return None
    usual = float(np.sqrt(np.mean(stored.theta[stored.supported] ** 2)))
    noise = np.sqrt(np.maximum(np.diag(stored.noise), 0.0)).reshape(stored.grid.shape)
    beyond = np.where(np.isfinite(view.deviation), view.deviation, usual)
    deviation = np.where(stored.supported, noise, beyond)
    return plan(stored.grid, stored.supported, stored.excitation, stored.noise, deviation)


def drive_rows(view: ResultView, found: Plan) -> tables.Table:
    """Return the cells that pay best, with what is known there and how long to drive."""
    fuel, speed = view.axes
    grid = view.stored.grid
    header = ["", f"{fuel.meaning} {fuel.unit}", f"{speed.meaning} {speed.unit}", "unknown now g/s"]
    header += ["excitation so far s", "time to drive s"]
    rows = [
        [
            str(number),
            f"{grid.fuel[column]:g} to {grid.fuel[column + 1]:g}",
            f"{grid.speed[row]:g} to {grid.speed[row + 1]:g}",
            tables.grams(float(found.deviation[row, column])),
            f"{view.stored.excitation[row, column]:.2f}",
            f"{max(found.time[row, column], 1.0):.0f}",
        ]
        for number, (row, column) in enumerate(found.cells, 1)
    ]
    return header, rows
