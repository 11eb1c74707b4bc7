"""The page of a fleet: a line per vehicle, worst first, the types' maps, every vehicle by itself."""

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np

from lpvobs.engines.base import MapAxis
from lpvobs.io.logs.finding import date_of
from lpvobs.io.results.fleets import StoredFleet
from lpvobs.report.content import SurfaceView
from lpvobs.report.fleets import change_rows, effect_rows
from lpvobs.report.page import rendered
from lpvobs.report.spoken import spelled
from lpvobs.report.tables import Table
from lpvobs.tracking.fleet import PeriodMap

KNOWN = 1e-3  # [kg/s], standard error of a type's node from which it is drawn


def fleet_page(name: str, fleet: StoredFleet) -> str:
    """Return the page as text; the same fleet gives the same text."""
    fuel, speed = (MapAxis(axis, item.unit, item.meaning) for axis, item in fleet.axes.items())
    known = [np.where(np.diag(each.covariance) < KNOWN**2, each.mean, np.nan) for each in fleet.found.types]
    filled = np.zeros(fleet.grid.shape, dtype=bool)
    views = [SurfaceView(fleet.grid, (fuel, speed), values.reshape(filled.shape), filled) for values in known]
    cells = defaultdict[str, dict[str, list[str]]](dict)
    for cell in fleet.found.cells:
        where = f"{cell.seconds:.0f} s each at {spelled(cell.speed, speed)}"
        cells[cell.vehicle].setdefault(where, []).append(f"{cell.fuel:g}")
    return rendered(
        "fleet.html",
        name=name,
        fleet=fleet,
        fuel=fuel,
        lines=_lines(fleet),
        types=list(zip(fleet.found.types, views, strict=True)),
        changes=_by_vehicle(change_rows(fleet)),
        effects=_by_vehicle(effect_rows(fleet)),
        cells=cells,
        date=date_of,
    )


def _by_vehicle(table: Table) -> Mapping[str, list[list[str]]]:
    found = defaultdict[str, list[list[str]]](list)
    for row in table[1]:
        found[row[0]].append(row)
    return found


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
