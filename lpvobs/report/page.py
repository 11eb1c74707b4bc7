"""Content and figures into self-contained HTML pages: the templates say what stands where, this module what they may ask for."""

import re
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

from lpvobs import __version__
from lpvobs.engines.base import MapAxis
from lpvobs.engines.registry import ENGINES
from lpvobs.io import templates
from lpvobs.io.logs.finding import date_of
from lpvobs.io.results.fleets import StoredFleet
from lpvobs.maps.excitation import Plan, plan
from lpvobs.report import courses, discovered, engines, figures, fleets, residual_figures, spoken, tables
from lpvobs.report.content import Report, ResultView, SurfaceView
from lpvobs.tracking.fleet import PeriodMap

_NOT_SHOWN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What names from files may hold and a page may not: controls, letters that turn the direction of others, halves of letters."""

KNOWN = 1e-3  # [kg/s], standard error of a type's node from which it is drawn
ASKED = courses, discovered, engines, figures, fleets, residual_figures, spoken, tables
"""What the templates call by name."""


def page(report: Report) -> str:
    """Return the page as text; the same content gives the same text."""
    named, cycles = report.named, report.cycles
    widest = max((stored for _, stored in named), key=lambda stored: len(stored.gain.log_bounds))
    paper = tables.beside_paper(named)
    filled = [view for view in report.results if view.stored.extrapolation is not None]
    printed = [ENGINES[view.stored.air_path].published for view in filled if paper]
    plans = [(f"p{number}", view, plan_of(view)) for number, view in enumerate(report.results)]
    logs = {log.sha256: log for _, stored in named for log in stored.logs}
    return rendered(
        "report.html",
        report=report,
        cycles=cycles,
        given=[cycle for cycle in cycles if cycle.drive is not None],
        paper=paper,
        referenced=any(log.metrics is not None for _, stored in named for log in stored.logs),
        driving=[(name, view, found) for name, view, found in plans if found is not None and found.cells],
        bounds=tables.bounds_table(widest.gain, widest.logs, paper),
        coefficients=tables.coefficient_tables(named, paper),
        filled=filled,
        remarks=list(dict.fromkeys(found.remark for found in printed if found is not None)),
        logs=logs.values(),
        refused=[line for _, stored in named for line in stored.refused],
    )


def fleet_page(name: str, fleet: StoredFleet) -> str:
    """Return the page as text; the same fleet gives the same text."""
    fuel, speed = (MapAxis(axis, item.unit, item.meaning) for axis, item in fleet.axes.items())
    known = [np.where(np.diag(each.covariance) < KNOWN**2, each.mean, np.nan) for each in fleet.found.types]
    filled = np.zeros(fleet.grid.shape, dtype=bool)
    views = [SurfaceView(fleet.grid, (fuel, speed), values.reshape(filled.shape), filled) for values in known]
    cells = defaultdict[str, dict[str, list[str]]](dict)
    for cell in fleet.found.cells:
        where = f"{cell.seconds:.0f} s each at {spoken.spelled(cell.speed, speed)}"
        cells[cell.vehicle].setdefault(where, []).append(f"{cell.fuel:g}")
    return rendered(
        "fleet.html",
        name=name,
        fleet=fleet,
        fuel=fuel,
        lines=_lines(fleet),
        types=list(zip(fleet.found.types, views, strict=True)),
        changes=fleets.change_rows(fleet)[1],
        effects=fleets.effect_rows(fleet)[1],
        cells=cells,
        date=date_of,
    )


def _lines(fleet: StoredFleet) -> dict[str, dict[str, Any]]:
    """Return the mean of each vehicle's map from period to period as a small line, all of one scale, with its ends [g/s]."""
    own = defaultdict[str, list[PeriodMap]](list)
    for item in fleet.found.maps:
        own[item.vehicle].append(item)
    weights = {name: 1.0 / maps[-1].standard_error ** 2 for name, maps in own.items()}
    means = {name: 1e3 * np.array([w @ its.theta for its in own[name]]) / w.sum() for name, w in weights.items()}
    widest = max(float(np.ptp(mean)) for mean in means.values())
    lines = {}
    for name, mean in means.items():
        low, high = float(mean.min()), float(mean.max())
        y = 9.0 - 14.0 * (mean - 0.5 * (low + high)) / max(widest, 1e-9)
        x = np.linspace(1.0, 89.0, mean.size) if mean.size > 1 else np.array([1.0])
        points = " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(x, y, strict=True))
        lines[name] = {"low": low, "high": high, "points": points}
    return lines


def rendered(template: str, **content: Any) -> str:
    """Return a page, or a part of one, without what a browser would obey instead of showing."""
    values = {module.__name__.rpartition(".")[2]: module for module in ASKED}
    values |= {"ENGINES": ENGINES, "version": __version__} | content
    filters: dict[str, Callable[..., Any]] = {
        "percent": tables.percent,
        "grams": tables.grams,
        "chance": spoken.chance,
        "second": spoken.second,
        "method": spoken.method_title,
        "cycle": spoken.cycle_title,
        "significant": lambda value, digits: f"{value:.{digits}g}",
    }
    return _NOT_SHOWN.sub(
        "\ufffd", templates.filled("lpvobs.report.templates", template, filters, markup=True, **values)
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
