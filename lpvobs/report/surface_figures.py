"""Figures of the map as a surface: in space, cut open, and what to drive next."""

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from lpvobs.maps.excitation import Plan
from lpvobs.records import Array
from lpvobs.report import figures
from lpvobs.report.content import SurfaceView
from lpvobs.report.svg import drawn

CUTS = 3  # cuts through a map along each of its axes
SURE = 1.645  # standard errors on either side of a 90 % interval
FAINT = 0.35  # opacity of what is extrapolated


@drawn(5.2)
def surface_view(figure: Figure, surface: SurfaceView, limit: float) -> None:
    """Draw the map as a surface in space, [g/s]; extrapolated parts are pale."""
    with mpl.rc_context({"grid.color": "#80808050"}):
        axes: Any = figure.add_subplot(projection="3d")
    grid, scale = surface.grid, Normalize(-figures.GRAMS * limit, figures.GRAMS * limit)
    values = figures.GRAMS * surface.values
    middle = 0.25 * (values[:-1, :-1] + values[1:, :-1] + values[:-1, 1:] + values[1:, 1:])
    filled = surface.filled
    pale = filled[:-1, :-1] | filled[1:, :-1] | filled[:-1, 1:] | filled[1:, 1:]
    colours = np.asarray(mpl.colormaps[figures.DIVERGING](scale(np.nan_to_num(middle))))
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
    figures.label_axes(axes, surface.axes)
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


LOOKS = ((figures.ESTIMATE, "o"), (figures.READING, "s"), (figures.TRUTH, "^"))
"""Colour and mark of each cut: told apart without colour, too."""


def _spread(counts: Array) -> list[int]:
    """Return some of the rows or columns that have estimated nodes: evenly spread over them."""
    rows = np.flatnonzero(counts >= min(2, counts.max()))
    picked = rows[np.unique(np.linspace(0, rows.size - 1, CUTS + 2).round().astype(int)[1:-1])] if rows.size else rows
    return [int(i) for i in picked]


def _line(axes: Axes, at: Array, cut: Array, text: str, look: tuple[str, str]) -> None:
    """Draw values, their standard errors and where they are estimated, shape (3, N)."""
    colour, mark = look
    values, deviation, known = cut
    axes.plot(at, figures.GRAMS * values, color=colour, linestyle="--", linewidth=0.8)
    own = np.where(known > 0.0, figures.GRAMS * values, np.nan)
    axes.plot(at, own, color=colour, marker=mark, markersize=3.5, label=text)
    low, high = (figures.GRAMS * (values + sign * SURE * deviation) for sign in (-1.0, 1.0))
    axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0.0)


@drawn()
def change_map(figure: Figure, surface: SurfaceView, changed: NDArray[np.bool_]) -> None:
    """Draw a heat map of how a map has changed, [g/s]; nodes that have changed by more than their errors are framed."""
    size = figures.GRAMS * figures.error_limit([surface])
    axes = figures.node_map(figure, surface, Normalize(-size, size), "change of the sensor error [g/s]")
    figures.frame(axes, surface, changed)


@drawn()
def plan_map(figure: Figure, surface: SurfaceView, plan: Plan) -> None:
    """Draw a heat map of how long to drive in each cell, [s]; the cells that pay best are framed and numbered."""
    u, n = surface.grid.fuel, surface.grid.speed
    top = float(np.nanmax(plan.time, initial=0.0)) or 1.0
    scale = LogNorm(min(1.0, 0.1 * top), top)
    axes = figures.cell_map(figure, surface, plan.time, scale, "time to drive in the cell [s]")
    for number, (row, column) in enumerate(plan.cells, 1):
        corner, size = (u[column], n[row]), (u[column + 1] - u[column], n[row + 1] - n[row])
        axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor=figures.READING, linewidth=1.8))
        middle = corner[0] + 0.5 * size[0], corner[1] + 0.5 * size[1]
        axes.text(
            *middle,
            str(number),
            ha="center",
            va="center_baseline",
            fontsize=8.0,
            color="#000000",
            bbox={"facecolor": "#ffffff", "edgecolor": "none", "pad": 0.8, "alpha": 0.85},
        )
