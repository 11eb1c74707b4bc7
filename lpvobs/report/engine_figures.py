"""Figures of a calibrated engine: every component with its correction, what the data say of it, and what they leave."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from lpvobs.engines.curves import LearnedCurve, Nodes
from lpvobs.engines.unknowns import Component
from lpvobs.io.results.engines import ComponentPoint, StoredEngine
from lpvobs.records import Array
from lpvobs.report.figures import ESTIMATE, GRAMS, READING, SURE
from lpvobs.report.svg import INK, drawn

HEIGHT = 3.0
"""[inch] of a figure."""
CUTS = 3
"""Lines through a surface, along its first axis."""


@drawn(HEIGHT)
def residuals(figure: Figure, stored: StoredEngine, kind: str) -> None:
    """Draw what the configured engine and all other points leave of a flow, over that flow."""
    own = [row for row in stored.rows if row.kind == kind]
    flow = GRAMS * np.array([row.reference for row in own])
    axes = figure.subplots()
    for label, colour in (("before", READING), ("held_out", ESTIMATE)):
        left = GRAMS * np.array([getattr(row, label) for row in own])
        axes.plot(flow, left, "o", markersize=3, color=colour, label=label.replace("_", " "))
    axes.axhline(0.0, color=INK, linewidth=0.5)
    axes.set(xlabel=f"{kind}, reference [g/s]", ylabel="residual [g/s]")
    axes.legend()


@drawn(HEIGHT)
def correction(figure: Figure, stored: StoredEngine, component: Component) -> None:
    """Draw a correction with its band, that before the data, and the points that the rows show."""
    mean, error, before = (
        values[stored.unknowns.places()[component.name]]
        for values in (stored.unknowns.mean, stored.error, stored.prior_error)
    )
    own = [point for point in stored.points if point.component == component.name]
    _lines(figure, component.axes, (mean, error, before), own)


@drawn(HEIGHT)
def learned_curve(figure: Figure, learned: LearnedCurve) -> None:
    """Draw a learned curve with its band."""
    _lines(figure, learned.axes, (learned.values, learned.relative_error * learned.values, None), ())


def _lines(
    figure: Figure,
    axes_of: Mapping[str, Nodes],
    curves: tuple[Array, Array, Array | None],
    points: Sequence[ComponentPoint],
) -> None:
    """Draw values over their first axis, at some nodes of the second and the middle of others, with the points nearest to each.

    `curves` are values, their standard errors, and those before the data where they are known.
    """
    mean, error = (_along(axes_of, values) for values in curves[:2])
    before = None if curves[2] is None else _along(axes_of, curves[2])
    (label, nodes), *others = axes_of.items()
    columns = np.unique(np.linspace(0, mean.shape[1] - 1, CUTS).round().astype(int))
    at = others[0][1].values[columns] if others else np.zeros(1)
    nearest = np.array([int(np.argmin(np.abs(at - point.across))) for point in points])
    panes = figure.subplots(1, columns.size, sharey=True, squeeze=False)[0]
    for number, (axes, column) in enumerate(zip(panes, columns, strict=True)):
        line, width = mean[:, column], SURE * error[:, column]
        axes.fill_between(nodes.values, line - width, line + width, color=ESTIMATE, alpha=0.25, linewidth=0.0)
        axes.plot(nodes.values, line, color=ESTIMATE)
        if before is not None:
            for side in (-SURE, SURE):
                axes.plot(nodes.values, side * before[:, column], ":", color=INK)
        here = [point for point, pane in zip(points, nearest, strict=True) if pane == number]
        axes.plot([p.along for p in here], [p.value for p in here], "o", markersize=2, color=READING)
        axes.set_xlabel(f"{label} [{nodes.unit}]")
        if others:
            axes.set_title(f"{others[0][0]} = {at[number]:g} {others[0][1].unit}".removesuffix(" 1"))


def _along(axes: Mapping[str, Nodes], values: Array) -> Array:
    """Return values at the nodes of the first two axes, those of a third at its middle, shape (n, m)."""
    shape = [axis.values.size for axis in axes.values()]
    whole = values.reshape(*shape, *[1] * (3 - len(shape)))
    return np.asarray(whole[:, :, whole.shape[2] // 2])
