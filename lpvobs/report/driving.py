"""Which cells to drive next, as the page shows it."""

import numpy as np

from lpvobs.maps.planning import Plan, plan
from lpvobs.report.content import ResultView
from lpvobs.report.tables import Table, grams


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


def drive_rows(view: ResultView, found: Plan) -> Table:
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
            grams(float(found.deviation[row, column])),
            f"{view.stored.excitation[row, column]:.2f}",
            f"{max(found.time[row, column], 1.0):.0f}",
        ]
        for number, (row, column) in enumerate(found.cells, 1)
    ]
    return header, rows
