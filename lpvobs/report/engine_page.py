"""The page of a calibrated engine: every component with its correction, what the data say of it, and what they leave."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from lpvobs.engines.curves import LearnedCurve, Nodes
from lpvobs.engines.unknowns import Component
from lpvobs.io.results.engines import ComponentPoint, StoredEngine
from lpvobs.records import Array
from lpvobs.report.engines import CalibrateOutput, calibration_tables
from lpvobs.report.figures import ESTIMATE, GRAMS, READING
from lpvobs.report.page import rendered
from lpvobs.report.residual import Section, picture
from lpvobs.report.surface_figures import SURE
from lpvobs.report.svg import INK, render
from lpvobs.report.tables import Table, percent

BODY = "engine.html.j2"
HEIGHT = 3.0
"""[inch] of a figure."""
CUTS = 3
"""Lines through a surface, along its first axis."""


def engine_page(name: str, stored: StoredEngine, found: CalibrateOutput) -> str:
    """Return the page as text; the same engine gives the same text."""
    learned = {} if stored.learned is None else stored.learned.known.curves
    components = [item for item in stored.unknowns.components if item.axes]
    return rendered(
        BODY,
        name=name,
        inputs=", ".join(found.inputs) or "the configuration alone",
        tables=calibration_tables(found),
        residuals=Section("", tuple(
            picture(residuals(f"r{number}", stored, row.kind), f"{row.kind}: error at every point, before the "
                "calibration and held out")
            for number, row in enumerate(found.rows)
        )),
        components=Section("", tuple(
            picture(correction(f"c{number}", stored, item), f"{item.name}: {item.meaning}; {_told(stored, item)}")
            for number, item in enumerate(components)
        ) + tuple(
            picture(curve(f"l{number}", part, item), f"{part}: {item.meaning}, as learned from healthy logs")
            for number, (part, item) in enumerate(learned.items())
        )),
        constants=_constants(found),
    )  # fmt: skip


def residuals(name: str, stored: StoredEngine, kind: str) -> str:
    """Return what the configured engine and all other points leave of a flow, over that flow."""
    own = [row for row in stored.rows if row.kind == kind]
    flow = GRAMS * np.array([row.reference for row in own])

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for label, colour in (("before", READING), ("held_out", ESTIMATE)):
            left = GRAMS * np.array([getattr(row, label) for row in own])
            axes.plot(flow, left, "o", markersize=3, color=colour, label=label.replace("_", " "))
        axes.axhline(0.0, color=INK, linewidth=0.5)
        axes.set_xlabel(f"{kind}, reference [g/s]")
        axes.set_ylabel("residual [g/s]")
        axes.legend()

    return render(name, f"residual of {kind} over its flow", HEIGHT, draw)


def correction(name: str, stored: StoredEngine, component: Component) -> str:
    """Return a correction with its band, that before the data, and the points that the rows show."""
    mean, error, before = (
        values[stored.unknowns.places()[component.name]]
        for values in (stored.unknowns.mean, stored.error, stored.prior_error)
    )
    own = [point for point in stored.points if point.component == component.name]
    return lines(name, f"correction {component.name}", component.axes, (mean, error, before), own)


def curve(name: str, part: str, learned: LearnedCurve) -> str:
    """Return a learned curve with its band."""
    error = learned.relative_error * learned.values
    return lines(name, f"{part}: {learned.name}", learned.axes, (learned.values, error, None), ())


def lines(
    name: str,
    title: str,
    axes_of: Mapping[str, Nodes],
    curves: tuple[Array, Array, Array | None],
    points: Sequence[ComponentPoint],
) -> str:
    """Return values over their first axis, at some nodes of the second and the middle of others, with the points nearest to each.

    `curves` are values, their standard errors, and those before the data where they are known.
    """
    mean, error = (_along(axes_of, values) for values in curves[:2])
    before = None if curves[2] is None else _along(axes_of, curves[2])
    (label, nodes), *others = axes_of.items()

    def draw(figure: Figure) -> None:
        columns = np.unique(np.linspace(0, mean.shape[1] - 1, CUTS).round().astype(int))
        at = others[0][1].values[columns] if others else np.zeros(1)
        nearest = np.array([int(np.argmin(np.abs(at - point.across))) for point in points])
        panes = figure.subplots(1, columns.size, sharey=True, squeeze=False)[0]
        for number, (axes, column) in enumerate(zip(panes, columns, strict=True)):
            line, width = mean[:, column], SURE * error[:, column]
            axes.fill_between(nodes.values, line - width, line + width, color=ESTIMATE, alpha=0.25, linewidth=0.0)
            axes.plot(nodes.values, line, color=ESTIMATE)
            for side in (-SURE, SURE) if before is not None else ():
                axes.plot(nodes.values, side * before[:, column], ":", color=INK)  # type: ignore[index]
            here = [point for point, pane in zip(points, nearest, strict=True) if pane == number]
            axes.plot([p.along for p in here], [p.value for p in here], "o", markersize=2, color=READING)
            axes.set_xlabel(f"{label} [{nodes.unit}]")
            if others:
                axes.set_title(f"{others[0][0]} = {at[number]:g} {others[0][1].unit}".removesuffix(" 1"))

    return render(name, title, HEIGHT, draw)


def _along(axes: Mapping[str, Nodes], values: Array) -> Array:
    """Return values at the nodes of the first two axes, those of a third at its middle, shape (n, m)."""
    shape = [axis.values.size for axis in axes.values()]
    whole = values.reshape(*shape, *[1] * (3 - len(shape)))
    return np.asarray(whole[:, :, whole.shape[2] // 2])


def _told(stored: StoredEngine, component: Component) -> str:
    """Return how much of a correction the data determined."""
    own = stored.unknowns.places()[component.name]
    share = float(np.mean(stored.error[own] < 0.5 * stored.prior_error[own]))
    return f"the data determine {100 * share:.0f} % of its nodes; the tolerance determines the others"


def _constants(found: CalibrateOutput) -> Table:
    rows = [
        [name, percent(item.deviation), percent(item.standard_error), "data" if item.determined else "tolerance"]
        for name, item in found.constants.items()
    ]
    return ["constant", "deviation", "standard error", "determined by"], rows
