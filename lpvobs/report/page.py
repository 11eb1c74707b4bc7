"""Content and figures into one self-contained HTML page."""

import re
from collections.abc import Iterator, Sequence
from importlib.resources import files

import jinja2
import numpy as np

from lpvobs import __version__
from lpvobs.engines.registry import ENGINES
from lpvobs.io.results.results import LogSummary
from lpvobs.maps.excitation import Plan, plan
from lpvobs.report import figures, surface_figures, tables
from lpvobs.report.content import Corrected, CycleView, Drive, Report, ResultView, SurfaceView
from lpvobs.report.discovered import sentences
from lpvobs.report.names import method_title, paper_error
from lpvobs.report.outputs import RegionMean
from lpvobs.report.residual import Picture, Section, fit_section, picture, residual_sections
from lpvobs.report.spoken import headline

TEMPLATE = "report.html.j2"
_NOT_SHOWN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What names from files may hold and a page may not: controls, letters that turn the direction of others, halves of letters."""


def page(report: Report, regions: Sequence[RegionMean] = ()) -> str:
    """Return the page as text; the same content gives the same text."""
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True).from_string(
        (files("lpvobs.report") / "templates" / TEMPLATE).read_text(encoding="utf-8")
    )
    named = [(view.name, view.stored) for view in report.results]
    widest = max((stored for _, stored in named), key=lambda stored: len(stored.gain.log_bounds))
    printed = [ENGINES[stored.air_path].published for _, stored in named if stored.extrapolation is not None]
    text = template.render(
        version=__version__,
        verdicts=[
            *(verdict(view) for view in report.results),
            *sentences([(v.name, v.discovered) for v in report.results]),
            *map(tables.region_line, regions),
        ],
        summary=tables.report_rows(named),
        cycles=[Section(each.title, tuple(_pictures(each, f"c{number}"))) for number, each in enumerate(report.cycles)],
        quality=[Section(view.name, tuple(_quality(view, number))) for number, view in enumerate(report.results)],
        driving=list(_driving(report)),
        residuals=[*filter(None, [fit_section(report.fits)])]
        + [part for number, view in enumerate(report.results) for part in residual_sections(view, number)],
        bounds=tables.bounds_table(widest.gain, widest.logs),
        coefficients=tables.coefficient_tables(named),
        remarks=list(dict.fromkeys(found.remark for found in printed if found is not None)),
        held=[
            (view.name, tables.percent(view.stored.outer_coverage, 0))
            for view in report.results
            if view.stored.extrapolation is not None
        ],
        gains=[(view.name, tables.gain_line(view.stored.gain), gain_rows(view)) for view in report.results],
        defects=defect_rows(report),
        refused=[line for view in report.results for line in view.stored.refused],
        origins=[(view.name, view.stored.provenance) for view in report.results],
    )
    return legible(text)


def legible(text: str) -> str:
    """Return text without what a browser or an editor would obey instead of showing it."""
    return _NOT_SHOWN.sub("\ufffd", text)


def verdict(view: ResultView) -> str:
    """Return one sentence on how far the corrected sensor is from the truth, for each log of a result."""
    return " ".join(_sentence(view, log) for log in view.stored.logs)


def _sentence(view: ResultView, log: LogSummary) -> str:
    nodes = f"{int(view.stored.supported.sum())} of {view.stored.grid.size} nodes estimated"
    if log.metrics is None:
        stored = view.stored
        says = headline(stored.grid, view.axes, stored.theta, stored.covariance, stored.supported)
        return (
            f"{view.name} ({method_title(view.stored.method)}): {nodes}; the log {log.name} has no references, "
            f"so the standard errors are all that is known of the map's accuracy: {says}."
        )
    m = log.metrics
    beside = paper_error(view.stored.air_path, log.name)
    paper = f"; the paper reports {tables.percent(beside)}" if beside is not None else ""
    constant = ENGINES[view.stored.air_path].air_path.rate_names
    held = f", {' and '.join(constant)} held constant" if view.stored.method == "published" else ""
    floor, certified = tables.percent(m.floor_mean_relative_error), tables.percent(log.share_certified, 1)
    return (
        f"{view.name} ({method_title(view.stored.method)}): the map misses the sensor's true error by "
        f"{tables.percent(m.mean_relative_error)} on average (floor of the grid {floor}{paper}), {tables.grams(m.rmse)} g/s rms; "
        f"{nodes}; {certified} of the samples where stability is certified{held}."
    )


def gain_rows(view: ResultView) -> tables.Table:
    """Return L with the names of its rows and columns."""
    gain = view.stored.gain
    rows = [[state, *(f"{value:.5g}" for value in row)] for state, row in zip(gain.states, gain.gain.L, strict=True)]
    return ["L", *gain.outputs, "sensor"], rows


def defect_rows(report: Report) -> tables.Table:
    """Return what was found wrong with every log and dropped."""
    header = ["log", "samples used", "of", "dropped", "because of", "gaps", "repeated or backward", "duration s"]
    rows = {}
    for view in report.results:
        for log in view.stored.logs:
            causes = ", ".join(f"{name} {count}" for name, count in ({**log.dropped, **log.found}).items()) or "-"
            counts = [str(log.samples), str(log.samples_read), str(log.dropped_rows), causes, str(log.gaps)]
            rows[log.sha256] = [log.name, *counts, str(log.repeated), f"{log.duration:.1f}"]
    return header, list(rows.values())


def _pictures(cycle: CycleView, name: str) -> Iterator[Picture]:
    """Yield what corresponds to the paper's Figures 3 to 9, as far as the content has it."""
    shown = [correction.result.estimated for correction in cycle.corrections]
    drive = cycle.drive
    limit = figures.error_limit([*shown, *([drive.surface] if drive and drive.surface else [])])
    if drive is not None:
        yield from _drive(cycle, drive, name, limit)
    for index, correction in enumerate(cycle.corrections):
        yield from _correction(cycle, correction, f"{name}-r{index}", limit)


def _drive(cycle: CycleView, drive: Drive, name: str, limit: float) -> Iterator[Picture]:
    title = cycle.title
    if drive.surface is not None:
        yield picture(
            figures.error_map(f"{name}-ref", f"reference error, {title}", drive.surface, limit),
            "Reference error where the drive goes, as the best bilinear map shows it (the paper's Figure 3).",
        )
    yield picture(
        figures.drive_course(f"{name}-drive", f"fuel and speed over time, {title}", cycle, drive),
        "Fuel quantity and engine speed over time (Figures 4a, 7a).",
    )
    surface = cycle.corrections[0].result.estimated
    yield picture(
        figures.trajectory(f"{name}-path", f"operating points, {title}", cycle, drive, surface),
        "Path of the operating point over the grid; cells without it are the area S (Figures 4b, 7b).",
    )


def _correction(cycle: CycleView, correction: Corrected, name: str, limit: float) -> Iterator[Picture]:
    view, drive = correction.result, cycle.drive
    what = f"{cycle.title}, {method_title(view.stored.method)}"
    yield picture(
        figures.error_map(f"{name}-map", f"estimated map, {what}", view.estimated, limit),
        f"Estimated error map, {what} (Figures 5a, 8a): empty nodes were not informed by the drive.",
    )
    if view.extrapolated is not None:
        yield picture(
            figures.error_map(f"{name}-full", f"extrapolated map, {what}", view.extrapolated, limit),
            f"The same, filled from the quadratic of Eq. (37), {what} (Figures 5b, 8b): hatched nodes are extrapolated.",
        )
    whole = view.estimated if view.extrapolated is None else view.extrapolated
    if np.isfinite(view.stored.theta).any():
        yield picture(
            surface_figures.surface_view(f"{name}-space", f"map in space, {what}", whole, limit),
            f"The map as a surface, {what}; what is extrapolated is pale.",
        )
        yield picture(
            surface_figures.cuts(f"{name}-cuts", f"cuts through the map, {what}", whole, view.deviation),
            f"Cuts through the map with 90 % intervals, {what}: estimated nodes are marked, dashed is extrapolated.",
        )
    if drive is None or correction.estimate is None:
        return
    if drive.reference is not None:
        yield picture(
            figures.error_course(f"{name}-error", f"errors over time, {what}", drive, correction),
            f"Reference and estimated error along the drive, {what} (Figures 6a, 9a).",
        )
    yield picture(
        figures.flow_course(f"{name}-flow", f"flows over time, {what}", drive, correction),
        f"True flow where known, reading, and reading after correction, {what} (Figures 6b, 9b).",
    )


def _driving(report: Report) -> Iterator[Section]:
    for number, view in enumerate(report.results):
        found = plan_of(view)
        if found is not None and found.cells:
            shown = surface_figures.plan_map(f"p{number}", f"cells to drive next, {view.name}", view.estimated, found)
            caption = "How long to drive in each cell; frames number the cells of the table."
            table = drive_rows(view, found), f"Cells that pay best, {view.name}"
            yield Section(view.name, (picture(shown, caption),), (table,))


def _quality(view: ResultView, number: int) -> Iterator[Picture]:
    errors = SurfaceView(view.stored.grid, view.axes, view.stored.standard_error, ~view.stored.supported)
    if (view.stored.standard_error > 0).any():
        yield picture(
            figures.standard_error_map(f"q{number}-se", f"standard error, {view.name}", errors),
            "Standard error of every estimated node, tolerance of the engine's constants included.",
        )
    yield picture(
        figures.excitation_map(f"q{number}-pe", f"excitation, {view.name}", view.estimated, view.stored.excitation),
        "Persistency of excitation of every cell: smallest eigenvalue of the integral of Eq. (29).",
    )


def plan_of(view: ResultView) -> Plan | None:
    """Return what to drive next, None where the result's method says nothing of its noise.

    Estimated nodes count with their noise, extrapolated ones with their error of prediction; a node without any value counts as
    wrong by as much as the estimated ones are large.
    """
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
