"""Figures of the map over its two inputs: content in, SVG text out."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from lpvobs.engines.base import MapAxis
from lpvobs.records import Array
from lpvobs.report.content import CycleView, Drive, SurfaceView
from lpvobs.report.svg import INK, TIP, drawn

TRUTH, ESTIMATE, READING = INK, "#2f7fc1", "#c4621a"
"""Blue and orange are told apart with any colour vision, and stand out from a white and from a nearly black page alike."""
DIVERGING, SEQUENTIAL = "RdBu_r", "viridis"
GRAMS = 1e3


def error_limit(surfaces: Sequence[SurfaceView]) -> float:
    """Return the largest estimated |value| of several maps, [kg/s], so that they share one colour scale."""
    sizes = [np.abs(surface.values[~surface.filled & np.isfinite(surface.values)]) for surface in surfaces]
    return max((float(size.max()) for size in sizes if size.size), default=0.0) or 1e-3


@drawn()
def error_map(figure: Figure, surface: SurfaceView, limit: float) -> None:
    """Draw a heat map of the sensor's error with its values, [g/s]; extrapolated nodes are hatched."""
    node_map(figure, surface, Normalize(-GRAMS * limit, GRAMS * limit), "sensor error [g/s]")


@drawn()
def standard_error_map(figure: Figure, surface: SurfaceView) -> None:
    """Draw a heat map of the standard error with its values, [g/s]."""
    known = GRAMS * surface.values[np.isfinite(surface.values) & (surface.values > 0)]
    node_map(figure, surface, _log_scale(known), "standard error [g/s]")


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
def trajectory(figure: Figure, cycle: CycleView, drive: Drive, surface: SurfaceView) -> None:
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
    label_axes(axes, cycle.axes)


def node_map(figure: Figure, surface: SurfaceView, scale: Normalize, label: str) -> Axes:
    """Draw a rectangle per node with its value, and return the axes."""
    axes = figure.add_subplot()
    grid, values = surface.grid, GRAMS * surface.values
    u_edges, n_edges = edges(grid.fuel), edges(grid.speed)
    colours = DIVERGING if scale.vmin is not None and scale.vmin < 0 else SEQUENTIAL
    image = axes.pcolormesh(u_edges, n_edges, values, cmap=colours, norm=scale)
    if surface.filled.any():
        axes.add_patch(_hatched(u_edges, n_edges, surface.filled))
    if surface.doubtful is not None:
        frame(axes, surface, surface.doubtful, linestyle=":")
    digits = int(np.clip(1 - np.floor(np.log10(float(scale.vmax or 1.0))), 0, 4))  # about two of the largest value
    for (j, i), value in np.ndenumerate(values):
        if np.isfinite(value):
            red, green, blue, _ = image.cmap(scale(value))
            dark = 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2 < 0.179  # where white contrasts more
            axes.text(
                float(grid.fuel[i]),
                float(grid.speed[j]),
                _value(value, digits),
                gid=f"{TIP}{_where(surface, i, j)}: {_value(value, digits + 2)}{_mark(surface, j, i)}",
                ha="center",
                va="center_baseline",
                fontsize=6.5,
                color="#ffffff" if dark else "#000000",
            )
    figure.colorbar(image, ax=axes, label=label, pad=0.015, extend="both" if surface.filled.any() else "neither")
    label_axes(axes, surface.axes)
    axes.set_xticks(grid.fuel[::2])
    axes.set_yticks(grid.speed[::2])
    return axes


def frame(axes: Axes, surface: SurfaceView, nodes: NDArray[np.bool_], **look: Any) -> None:
    """Draw a frame around some nodes."""
    u, n = edges(surface.grid.fuel), edges(surface.grid.speed)
    style: dict[str, Any] = {"fill": False, "edgecolor": READING, "linewidth": 1.8} | look
    for j, i in np.argwhere(nodes):
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


def _mark(surface: SurfaceView, j: int, i: int) -> str:
    if surface.filled[j, i]:
        return ", extrapolated"
    doubtful = surface.doubtful is not None and surface.doubtful[j, i]
    return ", doubtful: few estimated neighbours and a large standard error" if doubtful else ""


def _where(surface: SurfaceView, i: int, j: int) -> str:
    fuel, speed = surface.axes
    return f"{surface.grid.fuel[i]:g} {fuel.unit}, {surface.grid.speed[j]:g} {speed.unit}"


def _value(value: float, digits: int) -> str:
    return f"{value:z.{digits}f}".replace("-", "−")
