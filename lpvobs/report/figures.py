"""Figures of the map: over its two inputs, in space, cut open, and what to drive next; content in, SVG text out."""

from collections.abc import Iterable, Sequence
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
from lpvobs.maps.excitation import Plan
from lpvobs.records import Array
from lpvobs.report.content import Drive, SurfaceView
from lpvobs.report.svg import INK, TIP, drawn

TRUTH, ESTIMATE, READING = INK, "#2f7fc1", "#c4621a"
"""Blue and orange are told apart with any colour vision, and stand out from a white and from a nearly black page alike."""
DIVERGING, SEQUENTIAL = "RdBu_r", "viridis"
GRAMS = 1e3
CUTS = 3  # cuts through a map along each of its axes
SURE = 1.645  # standard errors on either side of a 90 % interval
FAINT = 0.35  # opacity of what is extrapolated
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
    grid = surface.grid
    axes.set_xticks(grid.fuel, minor=True)
    axes.set_yticks(grid.speed, minor=True)
    axes.grid(visible=True, which="minor")
    label_axes(axes, surface.axes)


@drawn(5.2)
def surface_view(figure: Figure, surface: SurfaceView, limit: float) -> None:
    """Draw the map as a surface in space, [g/s]; extrapolated parts are pale."""
    with mpl.rc_context({"grid.color": "#80808050"}):
        axes: Any = figure.add_subplot(projection="3d")
    grid, scale = surface.grid, Normalize(-GRAMS * limit, GRAMS * limit)
    values = GRAMS * surface.values
    middle = 0.25 * (values[:-1, :-1] + values[1:, :-1] + values[:-1, 1:] + values[1:, 1:])
    filled = surface.filled
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
        for k, look in zip(_spread(cut[2].sum(1)), LOOKS, strict=False):
            _line(axes, at, cut[:, k], f"{places[k]:g} {across.unit}", look)
        axes.set_xlabel(f"{along.meaning} [{along.unit}]")
        axes.grid(visible=True)
        axes.legend()
    panes[0].set_ylabel("sensor error [g/s]")


def _spread(counts: Array) -> list[int]:
    """Return some of the rows or columns that have estimated nodes: evenly spread over them."""
    rows = np.flatnonzero(counts >= min(2, counts.max()))
    picked = rows[np.unique(np.linspace(0, rows.size - 1, CUTS + 2).round().astype(int)[1:-1])] if rows.size else rows
    return [int(i) for i in picked]


def _line(axes: Axes, at: Array, cut: Array, text: str, look: tuple[str, str]) -> None:
    """Draw values, their standard errors and where they are estimated, shape (3, N)."""
    colour, mark = look
    values, deviation, known = cut
    axes.plot(at, GRAMS * values, color=colour, linestyle="--", linewidth=0.8)
    own = np.where(known > 0.0, GRAMS * values, np.nan)
    axes.plot(at, own, color=colour, marker=mark, markersize=3.5, label=text)
    low, high = (GRAMS * (values + sign * SURE * deviation) for sign in (-1.0, 1.0))
    axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0.0)


@drawn()
def plan_map(figure: Figure, surface: SurfaceView, plan: Plan) -> None:
    """Draw a heat map of how long to drive in each cell, [s]; the cells that pay best are framed and numbered."""
    u, n = surface.grid.fuel, surface.grid.speed
    top = float(np.nanmax(plan.time, initial=0.0)) or 1.0
    scale = LogNorm(min(1.0, 0.1 * top), top)
    axes = cell_map(figure, surface, plan.time, scale, "time to drive in the cell [s]")
    frame(axes, u, n, plan.cells)
    for number, (j, i) in enumerate(plan.cells, 1):
        axes.text(
            0.5 * (u[i] + u[i + 1]),
            0.5 * (n[j] + n[j + 1]),
            str(number),
            ha="center",
            va="center_baseline",
            fontsize=8.0,
            color="#000000",
            bbox={"facecolor": "#ffffff", "edgecolor": "none", "pad": 0.8, "alpha": 0.85},
        )


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
            axes.text(
                float(grid.fuel[i]),
                float(grid.speed[j]),
                _value(value, digits),
                gid=TIP + _told(surface, j, i, _value(value, digits + 2)),
                ha="center",
                va="center_baseline",
                fontsize=6.5,
                color="#ffffff" if dark else "#000000",
            )
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
    corners = [
        Outline([(u_edges[i + right], n_edges[j + up]) for right, up in around], closed=True)
        for j, i in np.argwhere(filled)
    ]
    outline = Outline.make_compound_path(*corners)
    return PathPatch(outline, fill=False, hatch="////", linewidth=0.0, edgecolor="#808080")


def label_axes(axes: Axes, names: tuple[MapAxis, MapAxis]) -> None:
    """Write what the map's two axes are."""
    fuel, speed = names
    axes.set(
        xlabel=f"{fuel.meaning} {fuel.channel} [{fuel.unit}]", ylabel=f"{speed.meaning} {speed.channel} [{speed.unit}]"
    )


def edges(nodes: Array) -> Array:
    """Return the middles between nodes, and as much beyond the outer ones, shape (p + 1,)."""
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    return np.concatenate([[2 * nodes[0] - middle[0]], middle, [2 * nodes[-1] - middle[-1]]])


def _log_scale(values: Array) -> LogNorm:
    """Return a logarithmic scale over positive values, at least one decade wide."""
    top = float(values.max()) if values.size else 1.0
    low = float(values.min()) if values.size else 0.1
    return LogNorm(max(min(low, 0.1 * top), 1e-4 * top), top)


def _told(surface: SurfaceView, j: int, i: int, value: str) -> str:
    """Return what is said of a node when the pointer rests on it."""
    fuel, speed = surface.axes
    said = f"{surface.grid.fuel[i]:g} {fuel.unit}, {surface.grid.speed[j]:g} {speed.unit}: {value}"
    if surface.filled[j, i]:
        return f"{said}, extrapolated"
    doubtful = surface.doubtful is not None and surface.doubtful[j, i]
    return f"{said}, doubtful: few estimated neighbours and a large standard error" if doubtful else said


def _value(value: float, digits: int) -> str:
    return f"{value:z.{digits}f}".replace("-", "−")
