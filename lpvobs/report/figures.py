"""Figures of the page: content in, SVG text out; long courses drawn with few points."""

from collections.abc import Sequence
from itertools import pairwise
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
from lpvobs.report.content import Corrected, CycleView, Drive, SurfaceView
from lpvobs.report.svg import INK, TIP, drawn

Segments = tuple[tuple[int, int], ...]


def thin(time: Array, values: Array, segments: Segments, columns: int) -> tuple[Array, Array]:
    """Return times, and the smallest and largest value of each column of pixels, with NaN where the line breaks.

    The line breaks between segments, and values of shape (N,) may be NaN. The columns cover the whole time. Both results have
    shape (M,), M about twice the number of columns at most; a segment with fewer samples is returned whole.
    """
    whole = max(float(time[-1] - time[0]), np.finfo(float).tiny)
    pieces = [
        _thin_segment(time[a:b], values[a:b], max(1, round(columns * float(time[b - 1] - time[a]) / whole)))
        for a, b in segments
    ]
    gap = np.full((2, 1), np.nan)
    joined = np.concatenate([part for piece in pieces for part in (piece, gap)][:-1], axis=1)
    return joined[0], joined[1]


def _thin_segment(time: Array, values: Array, columns: int) -> Array:
    """Return times and extremes of one segment, shape (2, M)."""
    if time.size <= 2 * columns:
        return np.stack([time, values])
    column = np.minimum((time - time[0]) * (columns / (time[-1] - time[0])), columns - 1).astype(int)
    starts = np.searchsorted(column, np.arange(columns + 1))
    points = [_extremes(time[a:b], values[a:b]) for a, b in pairwise(starts) if b > a]
    return np.concatenate(points, axis=1)


def _extremes(time: Array, values: Array) -> Array:
    """Return where and what the extremes are, shape (2, 2), or a break, shape (2, 1), where nothing is known."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size == 0:
        return np.array([[time[0]], [np.nan]])
    at = np.sort(known[[np.argmin(values[known]), np.argmax(values[known])]])
    return np.stack([time[at], values[at]])


def busiest(time: Array, values: Array, width: float) -> tuple[float, float]:
    """Return the window of a width [s] in which the values, shape (N,), move most: the largest sum of steps over its parts."""
    start, stop = float(time[0]), float(time[-1])
    if stop - start <= width:
        return start, stop
    raster = np.linspace(start, stop, max(int((stop - start) / (width / 30.0)), 2))  # 30 parts: noise averages out
    mean = np.interp(raster, time, values)
    moved = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(mean)))])
    ends = np.searchsorted(raster, raster + width, side="right") - 1
    inside = raster <= stop - width
    best = int(np.argmax(np.where(inside, moved[ends] - moved, -np.inf)))
    return float(raster[best]), float(raster[best]) + width


def window(time: Array, segments: Segments, start: float, stop: float) -> tuple[slice, Segments]:
    """Return the samples in a window of time, and the segments among them counted from its first sample."""
    first, last = int(np.searchsorted(time, start)), int(np.searchsorted(time, stop, side="right"))
    inside = [(max(a, first) - first, min(b, last) - first) for a, b in segments]
    return slice(first, last), tuple((a, b) for a, b in inside if b > a)


TRUTH, ESTIMATE, READING = INK, "#2f7fc1", "#c4621a"
"""Blue and orange are told apart with any colour vision, and stand out from a white and from a nearly black page alike."""
DIVERGING, SEQUENTIAL = "RdBu_r", "viridis"
COLUMNS = 250  # pixel columns that a course over time is drawn with
DETAIL = 40.0  # [s], the stretch shown enlarged
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
    axes = figure.add_subplot()
    excited = np.where(excitation > 0, excitation, np.nan)
    grid = surface.grid
    scale = _log_scale(excited[np.isfinite(excited)])
    image = axes.pcolormesh(grid.fuel, grid.speed, excited, cmap=SEQUENTIAL, norm=scale)
    figure.colorbar(image, ax=axes, label="excitation δ₁ of the cell [s]", pad=0.015)
    label_axes(axes, surface.axes)
    axes.grid(visible=True)


@drawn()
def drive_course(figure: Figure, cycle: CycleView, drive: Drive) -> None:
    """Draw the map's two inputs over time."""
    rows = figure.subplots(2, 1, sharex=True)
    for axes, axis, values in zip(rows, cycle.axes, (drive.fuel, drive.speed), strict=True):
        axes.plot(*thin(drive.time, values, drive.segments, COLUMNS), color=ESTIMATE, linewidth=0.8)
        axes.set_ylabel(f"{axis.channel} [{axis.unit}]")
        axes.grid(visible=True)
    rows[1].set_xlabel("time [s]")
    rows[1].set_xlim(drive.time[0], drive.time[-1])


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


@drawn(5.2)
def error_course(figure: Figure, drive: Drive, correction: Corrected) -> None:
    """Draw reference and estimated error over time, [g/s], whole and enlarged."""
    lines = [("reference error", drive.reference, TRUTH, "-"), ("estimated error", correction.estimate, ESTIMATE, "--")]
    _two_scales(figure, drive=drive, lines=lines, label="sensor error [g/s]")


@drawn(5.2)
def flow_course(figure: Figure, drive: Drive, correction: Corrected) -> None:
    """Draw true flow, reading, and reading after correction over time, [g/s], whole and enlarged."""
    corrected = None if correction.estimate is None else drive.measured - correction.estimate
    lines = [
        ("reading", drive.measured, READING, "-"),
        ("reading after correction", corrected, ESTIMATE, "-"),
        ("true flow", drive.true_flow, TRUTH, "--"),
    ]
    _two_scales(figure, drive=drive, lines=lines, label="mass air flow [g/s]")


def _two_scales(figure: Figure, drive: Drive, lines: Sequence[tuple[str, Array | None, str, str]], label: str) -> None:
    """Draw lines over the whole time, and below over the stretch in which the reading moves most."""
    whole, detail = figure.subplots(2, 1)
    start, stop = busiest(drive.time, drive.measured, DETAIL)
    part, segments = window(drive.time, drive.segments, start, stop)
    for text, values, colour, dashes in lines:
        if values is None:
            continue
        style = {"color": colour, "linestyle": dashes, "label": text}
        whole.plot(*thin(drive.time, GRAMS * values, drive.segments, COLUMNS), **style, linewidth=0.7)
        detail.plot(*thin(drive.time[part], GRAMS * values[part], segments, COLUMNS), **style)
    whole.axvspan(start, stop, color=INK, alpha=0.12, linewidth=0)
    whole.set_xlim(drive.time[0], drive.time[-1])
    detail.set_xlim(start, stop)
    detail.set_xlabel("time [s]; the lower plot enlarges the shaded part")
    for axes in (whole, detail):
        axes.set_ylabel(label)
        axes.grid(visible=True)
    figure.legend(*whole.get_legend_handles_labels(), loc="outside upper left", ncols=len(lines))


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
    axes.set_xlabel(f"{fuel.meaning} {fuel.channel} [{fuel.unit}]")
    axes.set_ylabel(f"{speed.meaning} {speed.channel} [{speed.unit}]")


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
