"""Figures of the map and of a calibrated engine: content in, SVG text out.

Of the map: over its two inputs, in space, cut open, and what to drive next. Of an engine: every component with its correction,
what the data say of it, and what they leave.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from lpvobs.engines.base import MapAxis
from lpvobs.engines.curves import Nodes
from lpvobs.io.results.engines import ComponentPoint, StoredEngine
from lpvobs.maps.excitation import Plan
from lpvobs.maps.joint import NORMAL_90
from lpvobs.records import Array
from lpvobs.report.content import Drive, SurfaceView
from lpvobs.report.engines import flows_of
from lpvobs.report.svg import INK, TIP, drawn

TRUTH, ESTIMATE, READING = INK, "#2f7fc1", "#c4621a"
"""Blue and orange are told apart with any colour vision, and stand out from a white and from a nearly black page alike."""
DIVERGING, SEQUENTIAL = "RdBu_r", "viridis"
GRAMS = 1e3
CUTS = 3  # cuts through a map along each of its axes; lines through a component, along its first one
FAINT = 0.35  # opacity of what is extrapolated
CENTRED: dict[str, Any] = {"ha": "center", "va": "center_baseline"}
PLATE = {"facecolor": "#ffffff", "edgecolor": "none", "pad": 0.8, "alpha": 0.85}  # behind a number on a map
LOOKS = ((ESTIMATE, "o"), (READING, "s"), (TRUTH, "^"))
"""Colour and mark of each cut: told apart without colour, too."""


def error_limit(surfaces: Sequence[SurfaceView]) -> float:
    """Return the largest estimated |value| of several maps, [kg/s], so that they share one colour scale."""
    sizes = [np.abs(surface.values[~surface.filled & np.isfinite(surface.values)]) for surface in surfaces]
    return max((float(size.max()) for size in sizes if size.size), default=0.0) or 1e-3


@drawn()
def excitation_map(figure: Figure, surface: SurfaceView, excitation: Array) -> None:
    """Draw a heat map of delta_1 of Eq. (29) of every cell, [s], shape (p_2 - 1, p_1 - 1); blank where it is zero."""
    cell_map(figure, surface, excitation, _log_scale(excitation[excitation > 0.0]), "excitation δ₁ of the cell [s]")


def cell_map(figure: Figure, surface: SurfaceView, values: Array, scale: LogNorm, label: str) -> Axes:
    """Draw a rectangle per cell, shape (p_2 - 1, p_1 - 1), blank where its value is zero, and return the axes."""
    axes, grid = figure.add_subplot(), surface.grid
    shown = np.where(values > 0.0, values, np.nan)
    image = axes.pcolormesh(grid.fuel, grid.speed, shown, cmap=SEQUENTIAL, norm=scale)
    figure.colorbar(image, ax=axes, label=label, pad=0.015)
    label_axes(axes, surface.axes)
    axes.grid(visible=True)
    return axes


@drawn()
def trajectory(figure: Figure, drive: Drive, surface: SurfaceView) -> None:
    """Draw the path of the operating point over the grid of the map; the line is an image, it is too dense for vectors."""
    axes = figure.add_subplot()
    for start, stop in drive.segments:
        part = slice(start, stop)
        (line,) = axes.plot(drive.fuel[part], drive.speed[part], color=ESTIMATE, linewidth=0.5, rasterized=True)
        line.set_antialiased(False)  # an image of two colours is small
    axes.set_xticks(surface.grid.fuel, minor=True)
    axes.set_yticks(surface.grid.speed, minor=True)
    axes.grid(visible=True, which="minor")
    label_axes(axes, surface.axes)


@drawn(5.2)
def surface_view(figure: Figure, surface: SurfaceView, limit: float) -> None:
    """Draw the map as a surface in space, [g/s]; extrapolated parts are pale."""
    with mpl.rc_context({"grid.color": "#80808050"}):
        axes: Any = figure.add_subplot(projection="3d")
    grid, scale = surface.grid, Normalize(-GRAMS * limit, GRAMS * limit)
    values, filled = GRAMS * surface.values, surface.filled
    middle = 0.25 * (values[:-1, :-1] + values[1:, :-1] + values[:-1, 1:] + values[1:, 1:])
    pale = filled[:-1, :-1] | filled[1:, :-1] | filled[:-1, 1:] | filled[1:, 1:]
    colours = np.asarray(mpl.colormaps[DIVERGING](scale(np.nan_to_num(middle))))
    colours[..., 3] = np.where(np.isfinite(middle), np.where(pale, FAINT, 1.0), 0.0)
    axes.plot_surface(
        *np.meshgrid(grid.fuel, grid.speed),
        values,
        facecolors=colours,
        rcount=values.shape[0],
        ccount=values.shape[1],
        edgecolor=(0.5, 0.5, 0.5, 0.5),
        linewidth=0.3,
        shade=False,
    )
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0.5, 0.5, 0.5, 0.06))
    label_axes(axes, surface.axes)
    axes.set_zlabel("sensor error [g/s]")
    axes.view_init(elev=28.0, azim=-120.0)
    axes.set_box_aspect((1.3, 1.3, 0.8), zoom=0.95)


@drawn()
def cuts(figure: Figure, surface: SurfaceView, deviation: Array) -> None:
    """Draw the map along a few speeds and a few fuel quantities with 90 % intervals, [g/s]; extrapolated parts are dashed."""
    known = np.isfinite(surface.values) & ~surface.filled
    fuel, speed = zip(surface.axes, (surface.grid.fuel, surface.grid.speed), strict=True)
    lines = np.stack([surface.values, deviation, known])  # (3, p_2, p_1)
    panes = figure.subplots(1, 2, sharey=True)
    for axes, (along, at), (across, places), cut in (
        (panes[0], fuel, speed, lines),
        (panes[1], speed, fuel, lines.transpose(0, 2, 1)),
    ):
        for k, (colour, mark) in zip(_spread(cut[2].sum(1)), LOOKS, strict=False):
            values, error, estimated = cut[:, k]
            axes.plot(at, GRAMS * values, color=colour, linestyle="--", linewidth=0.8)
            own = np.where(estimated > 0.0, GRAMS * values, np.nan)
            axes.plot(at, own, color=colour, marker=mark, markersize=3.5, label=f"{places[k]:g} {across.unit}")
            low, high = (GRAMS * (values + sign * NORMAL_90 * error) for sign in (-1.0, 1.0))
            axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0.0)
        axes.set_xlabel(f"{along.meaning} [{along.unit}]")
        axes.grid(visible=True)
        axes.legend()
    panes[0].set_ylabel("sensor error [g/s]")


def _spread(counts: Array) -> list[int]:
    """Return some of the rows or columns that have estimated nodes: evenly spread over them."""
    rows = np.flatnonzero(counts >= min(2, counts.max()))
    picked = rows[np.unique(np.linspace(0, rows.size - 1, CUTS + 2).round().astype(int)[1:-1])] if rows.size else rows
    return [int(i) for i in picked]


@drawn()
def plan_map(figure: Figure, surface: SurfaceView, plan: Plan) -> None:
    """Draw a heat map of how long to drive in each cell, [s]; the cells that pay best are framed and numbered."""
    u, n = surface.grid.fuel, surface.grid.speed
    top = float(np.nanmax(plan.time, initial=0.0)) or 1.0
    axes = cell_map(figure, surface, plan.time, LogNorm(min(1.0, 0.1 * top), top), "time to drive in the cell [s]")
    frame(axes, u, n, plan.cells)
    for number, (j, i) in enumerate(plan.cells, 1):
        middle = 0.5 * (u[i] + u[i + 1]), 0.5 * (n[j] + n[j + 1])
        axes.text(*middle, str(number), **CENTRED, fontsize=8.0, color="#000000", bbox=PLATE)


@drawn()
def error_map(
    figure: Figure,
    surface: SurfaceView,
    limit: float | None = None,
    label: str = "sensor error [g/s]",
    framed: NDArray[np.bool_] | None = None,
) -> None:
    """Draw a heat map with a value at every node, [g/s]; extrapolated nodes are hatched, those of `framed` have a frame.

    Colours reach as far as `limit` [kg/s] on either side of zero; without one they are of positive values, on a logarithmic scale.
    """
    axes = figure.add_subplot()
    grid, values = surface.grid, GRAMS * surface.values
    u_edges, n_edges = edges(grid.fuel), edges(grid.speed)
    scale = _log_scale(values[values > 0.0]) if limit is None else Normalize(-GRAMS * limit, GRAMS * limit)
    image = axes.pcolormesh(u_edges, n_edges, values, cmap=SEQUENTIAL if limit is None else DIVERGING, norm=scale)
    if surface.filled.any():
        axes.add_patch(_hatched(u_edges, n_edges, surface.filled))
    if surface.doubtful is not None:
        frame(axes, u_edges, n_edges, np.argwhere(surface.doubtful), linestyle=":")
    digits = int(np.clip(1 - np.floor(np.log10(float(scale.vmax or 1.0))), 0, 4))  # about two of the largest value
    for (j, i), value in np.ndenumerate(values):
        if np.isfinite(value):
            red, green, blue, _ = image.cmap(scale(value))
            dark = 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2 < 0.179  # where white contrasts more
            text = axes.text(float(grid.fuel[i]), float(grid.speed[j]), _value(value, digits), **CENTRED, fontsize=6.5)
            text.set(gid=TIP + _told(surface, j, i, _value(value, digits + 2)), color="#ffffff" if dark else "#000000")
    figure.colorbar(image, ax=axes, label=label, pad=0.015, extend="both" if surface.filled.any() else "neither")
    label_axes(axes, surface.axes)
    axes.set_xticks(grid.fuel[::2])
    axes.set_yticks(grid.speed[::2])
    if framed is not None:
        frame(axes, u_edges, n_edges, np.argwhere(framed))


def frame(axes: Axes, u: Array, n: Array, places: Iterable[Sequence[int]], **look: Any) -> None:
    """Draw a frame around some rectangles, by their place between the edges n and u."""
    style: dict[str, Any] = {"fill": False, "edgecolor": READING, "linewidth": 1.8} | look
    for j, i in places:
        axes.add_patch(Rectangle((u[i], n[j]), u[i + 1] - u[i], n[j + 1] - n[j], **style))


def _hatched(u_edges: Array, n_edges: Array, filled: NDArray[np.bool_]) -> PathPatch:
    """Return the extrapolated nodes as one hatched area."""
    around = ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))
    corners = ([(u_edges[i + right], n_edges[j + up]) for right, up in around] for j, i in np.argwhere(filled))
    outline = Outline.make_compound_path(*(Outline(each, closed=True) for each in corners))
    return PathPatch(outline, fill=False, hatch="////", linewidth=0.0, edgecolor="#808080")


def label_axes(axes: Axes, names: tuple[MapAxis, MapAxis]) -> None:
    """Write what the map's two axes are."""
    fuel, speed = (f"{axis.meaning} {axis.channel} [{axis.unit}]" for axis in names)
    axes.set(xlabel=fuel, ylabel=speed)


def edges(nodes: Array) -> Array:
    """Return the middles between nodes, and as much beyond the outer ones, shape (p + 1,)."""
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    return np.concatenate([[2 * nodes[0] - middle[0]], middle, [2 * nodes[-1] - middle[-1]]])


def _log_scale(values: Array) -> LogNorm:
    """Return a logarithmic scale over positive values, at least one decade wide."""
    low, top = (float(values.min()), float(values.max())) if values.size else (0.1, 1.0)
    return LogNorm(max(min(low, 0.1 * top), 1e-4 * top), top)


def _told(surface: SurfaceView, j: int, i: int, value: str) -> str:
    """Return what is said of a node when the pointer rests on it."""
    fuel, speed = surface.axes
    said = f"{surface.grid.fuel[i]:g} {fuel.unit}, {surface.grid.speed[j]:g} {speed.unit}: {value}"
    if surface.filled[j, i]:
        return f"{said}, extrapolated"
    if surface.doubtful is not None and surface.doubtful[j, i]:
        return f"{said}, doubtful: few estimated neighbours and a large standard error"
    return said


def _value(value: float, digits: int) -> str:
    return f"{value:z.{digits}f}".replace("-", "−")


@drawn(3.0)
def residuals(figure: Figure, stored: StoredEngine, kind: str) -> None:
    """Draw what the configured engine and all other points leave of a flow, over that flow."""
    flow, before, held_out = GRAMS * flows_of(stored, kind)
    axes = figure.subplots()
    axes.plot(flow, before, "o", markersize=3, color=READING, label="before")
    axes.plot(flow, held_out, "o", markersize=3, color=ESTIMATE, label="held out")
    axes.axhline(0.0, color=INK, linewidth=0.5)
    axes.set(xlabel=f"{kind}, reference [g/s]", ylabel="residual [g/s]")
    axes.legend()


@drawn(3.0)
def component(
    figure: Figure,
    axes_of: Mapping[str, Nodes],
    values: Array,
    errors: Array,
    errors_before: Array | None = None,
    points: Sequence[ComponentPoint] = (),
) -> None:
    """Draw a correction or a learned curve with its band, that before the data, and the points that the rows show.

    Over its first axis, at some nodes of the second and the middle of others, with the points nearest to each.
    """
    mean, error = _along(axes_of, values), _along(axes_of, errors)
    before = None if errors_before is None else _along(axes_of, errors_before)
    (label, nodes), *others = axes_of.items()
    columns = np.unique(np.linspace(0, mean.shape[1] - 1, CUTS).round().astype(int))
    at = others[0][1].values[columns] if others else np.zeros(1)
    nearest = np.array([int(np.argmin(np.abs(at - point.across))) for point in points])
    panes = figure.subplots(1, columns.size, sharey=True, squeeze=False)[0]
    for number, (axes, column) in enumerate(zip(panes, columns, strict=True)):
        line, width = mean[:, column], NORMAL_90 * error[:, column]
        axes.fill_between(nodes.values, line - width, line + width, color=ESTIMATE, alpha=0.25, linewidth=0.0)
        axes.plot(nodes.values, line, color=ESTIMATE)
        if before is not None:
            for side in (-NORMAL_90, NORMAL_90):
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
