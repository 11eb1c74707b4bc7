"""The page of a fleet: a line per vehicle, worst first, the types' maps, every vehicle by itself."""

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np

from lpvobs.engines.base import MapAxis
from lpvobs.io.logs.finding import date_of
from lpvobs.io.results.fleets import StoredFleet
from lpvobs.report.content import SurfaceView
from lpvobs.report.figures import error_limit, error_map
from lpvobs.report.fleets import change_rows, effect_rows, fleet_summary, vehicle_rows
from lpvobs.report.page import rendered
from lpvobs.report.residual import Section, picture
from lpvobs.report.spoken import spelled
from lpvobs.tracking.fleet import PeriodMap

BODY = "fleet.html.j2"
KNOWN = 1e-3  # [kg/s], standard error of a type's node from which it is drawn


def fleet_page(name: str, fleet: StoredFleet) -> str:
    """Return the page as text; the same fleet gives the same text."""
    found = fleet.found
    fuel, speed = (MapAxis(axis, item.unit, item.meaning) for axis, item in fleet.axes.items())
    pictures = []
    for number, each in enumerate(found.types):
        known = np.diag(each.covariance) < KNOWN**2
        values = np.where(known, each.mean, np.nan).reshape(fleet.grid.shape)
        view = SurfaceView(fleet.grid, (fuel, speed), values, np.zeros(fleet.grid.shape, dtype=bool))
        drawing = error_map(f"t{number}", f"map of type {each.kind}", view, error_limit([view]))
        caption = f"Type {each.kind}: the mean error map of its vehicles. Nodes with a standard error above 1 g/s are left out."
        pictures.append(picture(drawing, caption))
    return rendered(
        BODY,
        name=name,
        summary=fleet_summary(fleet),
        header=vehicle_rows(fleet, True)[0][3:],
        vehicles=list(_told(fleet, (fuel, speed))),
        refused=fleet.refused,
        types=Section("", tuple(pictures)),
    )


def _told(fleet: StoredFleet, axes: tuple[MapAxis, MapAxis]) -> Iterator[dict[str, Any]]:
    """Yield what the page says of each vehicle."""
    own, cells = defaultdict[str, list[PeriodMap]](list), defaultdict[str, dict[str, list[str]]](dict)
    for item in fleet.found.maps:
        own[item.vehicle].append(item)
    fuel, speed = axes
    unit = "" if fuel.unit == "1" else f" {fuel.unit}"
    for cell in fleet.found.cells:
        where = f"{cell.seconds:.0f} s each at {spelled(cell.speed, speed)}"
        cells[cell.vehicle].setdefault(where, []).append(f"{cell.fuel:g}")
    weights = {name: 1.0 / maps[-1].standard_error ** 2 for name, maps in own.items()}
    means = {name: 1e3 * np.array([w @ its.theta for its in own[name]]) / w.sum() for name, w in weights.items()}
    widest = max(float(np.ptp(mean)) for mean in means.values())
    changes, effects, rows = change_rows(fleet)[1], effect_rows(fleet)[1], vehicle_rows(fleet, True)[1]
    for number, (each, row) in enumerate(zip(fleet.found.worst_first(), rows, strict=True)):
        mean = means[each.vehicle]
        low, high = float(mean.min()), float(mean.max())
        y = 9.0 - 14.0 * (mean - 0.5 * (low + high)) / max(widest, 1e-9)
        x = np.linspace(1.0, 89.0, mean.size) if mean.size > 1 else np.array([1.0])
        next_cells = [f"{where} and {', '.join(fuels)}{unit}" for where, fuels in cells[each.vehicle].items()]
        told = [
            f"{change[1]} on {change[2]} (90 %: {change[3]} to {change[4]}): level {change[5]} {change[6]} g/s, gain "
            f"{change[7]} {change[8]} %"
            for change in changes
            if change[0] == each.vehicle
        ]
        told += [
            f"refine found {effect[1]} in logs from {effect[8]} to {effect[9]}: "
            f"{effect[2]} {effect[3]} {effect[6]} (90 %: {effect[4]} to {effect[5]})"
            for effect in effects
            if effect[0] == each.vehicle
        ]
        yield {
            "id": f"v{number}",
            "name": each.vehicle,
            "verdict": each.verdict,
            "logs": each.logs,
            "cells": row[3:],
            "low": f"{low:.2f}",
            "high": f"{high:.2f}",
            "points": " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(x, y, strict=True)),
            "lines": [
                f"{date_of(each.first)} to {date_of(each.last)}, type {each.type}",
                *told,
                *([f"cells to drive next: {'; '.join(next_cells)}"] if next_cells else []),
            ],
        }
