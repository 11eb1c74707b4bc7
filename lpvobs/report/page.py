"""Content and figures into self-contained HTML pages: the templates say what stands where, this module what they may ask for."""

import re
from typing import Any

import numpy as np

from lpvobs import __version__
from lpvobs.engines.registry import ENGINES
from lpvobs.io.templates import filled
from lpvobs.maps.excitation import Plan, plan
from lpvobs.report import (
    courses,
    discovered,
    engine_figures,
    engines,
    figures,
    fleets,
    names,
    residual_figures,
    spoken,
    tables,
)
from lpvobs.report.content import Report, ResultView

_NOT_SHOWN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What names from files may hold and a page may not: controls, letters that turn the direction of others, halves of letters."""


ASKED = courses, discovered, engine_figures, engines, figures, fleets, names, residual_figures, spoken, tables
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
        regions=report.regions,
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


def rendered(template: str, **content: Any) -> str:
    """Return a page, or a part of one, without what a browser would obey instead of showing."""
    asked = {module.__name__.rpartition(".")[2]: module for module in ASKED}
    filters = {
        "percent": tables.percent,
        "grams": tables.grams,
        "chance": spoken.chance,
        "second": spoken.second,
        "method": names.method_title,
        "cycle": names.cycle_title,
        "significant": lambda value, digits: f"{value:.{digits}g}",
    }
    text = filled(
        "lpvobs.report.templates",
        template,
        filters,
        markup=True,
        ENGINES=ENGINES,
        version=__version__,
        **asked | content,
    )
    return _NOT_SHOWN.sub("\ufffd", text)


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
