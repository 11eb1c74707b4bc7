"""Courses over time, as a figure and as data for the page's own script: extremes of few columns, however long the log is."""

import base64
import json
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lpvobs.records import Array
from lpvobs.report.content import CycleView, Drive
from lpvobs.report.figures import ESTIMATE, GRAMS, READING
from lpvobs.report.svg import INK, drawn, label_of

DRAWN = 250  # most columns of a figure
TOLD = 3000  # most columns for the script: over ten times those of a figure, so that a zoom still shows every extreme
FEWEST = 4  # samples of a column on average, at least
COLOURS = (READING, ESTIMATE, "#3b8f4e", "#8f5fbf", "#b03060", "#8a7a10")
"""Of the traces of a pane but the truth, as in the script."""
NOTHING = -32768  # stands for no value; others use the numbers up to 32767 on either side of the middle


class TimeTrace(NamedTuple):
    """One line over time; lines of one pane share an axis, whose label it is."""

    name: str
    pane: str
    truth: bool
    values: Array  # (N,)


def traces(cycle: CycleView, drive: Drive) -> Iterator[TimeTrace]:
    """Yield flows and errors [g/s] of a log, and the map's two inputs."""
    flow, error = "mass air flow [g/s]", "sensor error [g/s]"
    several = len(cycle.results) > 1
    maps = ((view.name, view.stored.grid, view.stored.theta) for view in cycle.results)
    known = [(name, grid.interpolate(theta, drive.fuel, drive.speed)) for name, grid, theta in maps]
    yield TimeTrace("reading", flow, False, GRAMS * drive.measured)
    for name, estimate in known:
        corrected = GRAMS * (drive.measured - estimate)
        yield TimeTrace(f"corrected by {name}" if several else "corrected", flow, False, corrected)
    if drive.true_flow is not None:
        yield TimeTrace("true flow", flow, True, GRAMS * drive.true_flow)
    for name, estimate in known:
        yield TimeTrace(f"map {name}" if several else "map", error, False, GRAMS * estimate)
    if drive.reference is not None:
        yield TimeTrace("true error", error, True, GRAMS * drive.reference)
    for axis, values in zip(cycle.results[0].axes, (drive.fuel, drive.speed), strict=True):
        yield TimeTrace(axis.channel, f"{axis.meaning} [{axis.unit}]", False, values)


@drawn()
def course(figure: Figure, time: Array, shown: Sequence[TimeTrace]) -> None:
    """Draw traces over time, a pane below the other; the script of the page draws the same, to be zoomed."""
    panes = list(dict.fromkeys(trace.pane for trace in shown))
    figure.set_figheight(0.5 + 1.6 * len(panes))
    place, edges = _columns(time, DRAWN)
    middles = np.repeat(0.5 * (edges[1:] + edges[:-1]), 2)
    rows = figure.subplots(len(panes), 1, sharex=True)
    for axes, pane in zip(rows, panes, strict=True):
        colours = iter(COLOURS)
        for trace in (trace for trace in shown if trace.pane == pane):
            colour, dashes = (INK, "--") if trace.truth else (next(colours, READING), "-")
            values = _extremes(place, trace.values, edges.size - 1)
            axes.plot(middles, values, color=colour, linestyle=dashes, linewidth=0.8, label=label_of(trace.name))
        axes.set_title(pane)
        axes.grid(visible=True)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    rows[-1].set_xlabel("time [s]")
    rows[-1].set_xlim(time[0], time[-1])


def course_data(time: Array, shown: Sequence[TimeTrace]) -> Markup:
    """Return the traces as JSON that may stand inside a script element: numbers of two bytes, small enough to be mailed."""
    place, edges = _columns(time, TOLD)
    told = [
        {"name": name, "pane": pane, "truth": truth, **_coded(_extremes(place, values, edges.size - 1))}
        for name, pane, truth, values in shown
    ]
    text = json.dumps({"from": float(time[0]), "to": float(time[-1]), "traces": told})
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def _columns(time: Array, most: int) -> tuple[NDArray[np.int64], Array]:
    """Return the column of every sample, shape (N,), and the edges of the columns [s]."""
    columns = int(np.clip(time.size // FEWEST, 1, most))
    span = max(float(time[-1] - time[0]), 1e-9)
    place = np.clip((time - time[0]) / span * columns, 0, columns - 1).astype(int)
    return place, np.linspace(time[0], time[0] + span, columns + 1)


def _extremes(place: NDArray[np.int64], values: Array, columns: int) -> Array:
    """Return smallest and largest value of every column in turn, shape (2 columns,), NaN where there is none."""
    there, starts = np.unique(place, return_index=True)  # time runs forward, and so do the columns
    extremes = np.full((columns, 2), np.nan)
    extremes[there] = np.stack([of.reduceat(values, starts) for of in (np.fmin, np.fmax)], axis=1)
    return extremes.ravel()


def _coded(values: Array) -> dict[str, float | str]:
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    middle, step = 0.5 * (low + high), max(high - low, 1e-9) / 65000.0
    codes = np.where(np.isfinite(values), np.round((np.nan_to_num(values) - middle) / step), NOTHING)
    return {"middle": middle, "step": step, "data": base64.b64encode(codes.astype("<i2").tobytes()).decode()}
