"""Courses over time for the page's own script: extremes of many columns as numbers of two bytes, small enough to be mailed."""

import base64
import json
from collections.abc import Iterator

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from lpvobs.records import Array
from lpvobs.report.content import CycleView, Drive
from lpvobs.report.figures import GRAMS

COLUMNS = 3000  # most columns of a course: ten times what a figure has, so that a zoom by ten still shows every extreme
FEWEST = 4  # samples of a column on average, at least
NOTHING = -32768  # stands for no value; others use the numbers up to 32767 on either side of the middle


def course_data(cycle: CycleView, drive: Drive) -> Markup:
    """Return the traces of a drive as JSON that may stand inside a script element."""
    span = float(drive.time[0]), float(drive.time[-1])
    columns = int(np.clip(drive.time.size // FEWEST, 1, COLUMNS))
    place = np.clip((drive.time - span[0]) / max(span[1] - span[0], 1e-9) * columns, 0, columns - 1).astype(int)
    traces = [
        {"name": name, "pane": pane, "truth": truth, **_coded(_extremes(place, values, columns))}
        for name, pane, truth, values in _traces(cycle, drive)
    ]
    text = json.dumps({"from": span[0], "to": span[1], "traces": traces})
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def _traces(cycle: CycleView, drive: Drive) -> Iterator[tuple[str, str, bool, Array]]:
    """Yield name, pane, whether it is the truth, and values of every trace."""
    flow, error = "mass air flow [g/s]", "sensor error [g/s]"
    several = len(cycle.corrections) > 1
    known = [(each.result.name, each.estimate) for each in cycle.corrections if each.estimate is not None]
    yield "reading", flow, False, GRAMS * drive.measured
    for name, estimate in known:
        yield f"corrected by {name}" if several else "corrected", flow, False, GRAMS * (drive.measured - estimate)
    if drive.true_flow is not None:
        yield "true flow", flow, True, GRAMS * drive.true_flow
    for name, estimate in known:
        yield f"map {name}" if several else "map", error, False, GRAMS * estimate
    if drive.reference is not None:
        yield "true error", error, True, GRAMS * drive.reference
    for axis, values in zip(cycle.axes, (drive.fuel, drive.speed), strict=True):
        yield axis.channel, f"{axis.meaning} [{axis.unit}]", False, values


def _extremes(place: NDArray[np.int64], values: Array, columns: int) -> Array:
    """Return smallest and largest value of every column in turn, shape (2 columns,), NaN where there is none."""
    known = np.isfinite(values)
    low, high = np.full(columns, np.inf), np.full(columns, -np.inf)
    np.minimum.at(low, place[known], values[known])
    np.maximum.at(high, place[known], values[known])
    return np.where(np.repeat(low <= high, 2), np.stack([low, high], axis=1).ravel(), np.nan)


def _coded(values: Array) -> dict[str, float | str]:
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    middle, step = 0.5 * (low + high), max(high - low, 1e-9) / 65000.0
    codes = np.where(np.isfinite(values), np.round((np.nan_to_num(values) - middle) / step), NOTHING)
    return {"middle": middle, "step": step, "data": base64.b64encode(codes.astype("<i2").tobytes()).decode()}
