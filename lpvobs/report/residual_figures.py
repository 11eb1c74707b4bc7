"""Figures of the residual before and after: content in, SVG text out."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lpvobs.discovery.outcome import Ranked
from lpvobs.discovery.portrait import Partial, Portrait, Track
from lpvobs.discovery.thresholds import LAGS
from lpvobs.discovery.whiteness import Whiteness
from lpvobs.maps.joint import NORMAL_90
from lpvobs.records import Array
from lpvobs.report.figures import ESTIMATE, GRAMS, READING
from lpvobs.report.fit import LAGS as LAGS_99
from lpvobs.report.fit import ResidualFit
from lpvobs.report.svg import INK, drawn, label_of

BEFORE, AFTER = READING, ESTIMATE
MOST_BARS = 12
LABELS, COLOURS = ("before", "after"), (BEFORE, AFTER)
WHITE: dict[str, Any] = {"color": INK, "alpha": 0.12, "linewidth": 0, "label": "95 % band of white noise"}


@drawn()
def residual_course(figure: Figure, track: Track, balances: Sequence[str], found: Sequence[Mapping[str, Any]]) -> None:
    """Draw the residual of every balance along a log, before and after, with onset and end of the effects, [g/s]."""
    figure.set_figheight(1.4 + 1.15 * len(balances))
    rows = np.atleast_1d(figure.subplots(len(balances), 1, sharex=True))
    times = [effect[edge] for effect in found for edge in ("onset", "end") if effect[edge] is not None]
    for axes, balance, before, after in zip(rows, balances, track.before, track.after, strict=True):
        for band, colour, label in zip((before, after), COLOURS, LABELS, strict=True):
            axes.fill_between(track.time, *(GRAMS * band), color=colour, linewidth=0.0, alpha=0.75, label=label)
        _mark_judged(axes, track)
        for number, time in enumerate(times):
            edge = "onset, end" if number == 0 else None
            axes.axvline(time, color=INK, linestyle="--", linewidth=1.0, label=edge)
        axes.set_ylabel(f"{balance}\n[g/s]", fontsize=7.5)
        axes.grid(visible=True)
    rows[-1].set_xlabel("time since the start of the log [s]")
    rows[-1].set_xlim(track.time[0], track.time[-1])
    figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper left", ncols=4)


def _mark_judged(axes: Axes, track: Track) -> None:
    """Shade what the error before and after is judged on, where that is not all."""
    if track.judged.all():
        return
    edges = np.flatnonzero(np.diff(track.judged, prepend=False, append=False))
    for number, (begin, end) in enumerate(edges.reshape(-1, 2)):
        last = min(int(end), track.time.size - 1)
        label = "held out" if number == 0 else None
        axes.axvspan(track.time[begin], track.time[last], color=INK, alpha=0.09, linewidth=0, label=label)


@drawn(3.4)
def component_curve(figure: Figure, surface: Mapping[str, Any]) -> None:
    """Draw the factor on a component over its first input, its second as where the factor is farthest from one, with 90 %."""
    first, second = (np.array(knots) for knots in surface["knots"])
    row = int(np.abs(second - surface["largest_at"][1]).argmin())
    factor, error = (100.0 * np.array(surface[name])[:, row] for name in ("factor", "standard_error"))
    axes, more, half = figure.add_subplot(), factor - 100.0, NORMAL_90 * error
    axes.fill_between(first, more - half, more + half, color=AFTER, alpha=0.25, linewidth=0)
    label = f"{surface['inputs'][1]} = {second[row]:.3g} {surface['units'][1]}"
    axes.plot(first, more, color=AFTER, label=label)
    axes.axhline(0.0, color=INK, linewidth=0.7)
    axes.set(xlabel=f"{surface['inputs'][0]} [{surface['units'][0]}]", ylabel="deviation from the model [%]")
    axes.grid(visible=True)
    figure.legend(loc="outside upper left")


@drawn()
def ranking_bars(figure: Figure, ranking: Sequence[Ranked]) -> None:
    """Draw the evidence for each candidate alone, best first."""
    shown = [item for item in ranking[:MOST_BARS] if item.gain > 0.0]
    figure.set_figheight(1.2 + 0.26 * len(shown))
    axes = figure.add_subplot()
    place = np.arange(len(shown))[::-1]
    axes.barh(place, [item.gain for item in shown], color=AFTER, height=0.7)
    axes.set_yticks(place, [label_of(item.id) for item in shown])
    axes.set(xscale="log", xlabel="evidence: half the decrease of the sum of squares, in noise variances")
    axes.grid(visible=True, axis="x")


@drawn(4.2)
def partial_residual(figure: Figure, seen: Partial) -> None:
    """Draw the residual without an effect against what the effect says of it; its size is right where the slope is one."""
    axes = figure.add_subplot()
    few: dict[str, Any] = {"color": BEFORE, "markersize": 2.0, "alpha": 0.5, "label": "some instants"}
    axes.plot(seen.regressor, seen.residual, ".", **few, rasterized=True)
    mean, residual, error = seen.binned
    reach = mean.min(), mean.max()
    axes.plot(reach, reach, color=INK, linestyle="--", label="effect with its estimated size")
    axes.errorbar(
        mean, residual, NORMAL_90 * error, fmt="o", color=AFTER, markersize=3.5, label="means over all instants"
    )
    spread = float(np.quantile(np.abs(seen.residual), 0.995)) if seen.residual.size else 1.0
    axes.set_ylim(min(-spread, residual.min()) * 1.05, max(spread, residual.max()) * 1.05)
    about = f"prediction of {label_of(seen.id)} [noise standard deviations]"
    axes.set(xlabel=about, ylabel="residual without the effect")
    axes.grid(visible=True)
    axes.legend(loc="upper left")


@drawn(4.6)
def spectra(figure: Figure, seen: Portrait) -> None:
    """Draw the spectral density of every balance's residual in units of its noise, before and after."""
    for b, axes in _panels(figure, seen.balances, xlabel="frequency [Hz]", ylabel="density [1/Hz]"):
        for label, colour, density in zip(LABELS, COLOURS, seen.spectrum[:, b], strict=True):
            axes.loglog(seen.frequency, np.maximum(density, 1e-12), color=colour, label=label, linewidth=1.0)


@drawn(4.6)
def autocorrelations(figure: Figure, seen: Portrait, structure: Mapping[str, Whiteness]) -> None:
    """Draw the autocorrelation of every balance's block sums, before and after, with the band of white noise."""
    lag = seen.block * np.arange(1, LAGS + 1)
    for b, axes in _panels(figure, seen.balances, xlabel="lag [s]", ylabel="autocorrelation"):
        band = structure["after"].band[b]
        axes.fill_between(lag, -band, band, **WHITE)
        for label, colour, shift in zip(LABELS, COLOURS, (-0.12, 0.12), strict=True):
            values = structure[label].autocorrelation[b]
            axes.vlines(lag + shift * seen.block, 0.0, values, color=colour, linewidth=2.5, label=label)
        axes.axhline(0.0, color=INK, linewidth=0.6)


@drawn(4.6)
def periodograms(figure: Figure, seen: Portrait, structure: Mapping[str, Whiteness]) -> None:
    """Draw the cumulated periodogram of every balance's block sums, before and after, with the band of white noise."""
    share, band = np.linspace(0.0, 1.0, seen.cumulated.shape[2] + 1), structure["after"].periodogram_band
    for b, axes in _panels(figure, seen.balances, xlabel="share of the frequencies", ylabel="share of the power"):
        axes.fill_between(share, share - band, share + band, **WHITE)
        for label, colour, power in zip(LABELS, COLOURS, seen.cumulated[:, b], strict=True):
            axes.plot(share, np.concatenate([[0.0], power]), color=colour, label=label)
        axes.set_ylim(0.0, 1.0)


def _panels(figure: Figure, balances: Sequence[str], **labels: str) -> Iterator[tuple[int, Axes]]:
    """Yield the number and the small panel of every balance, to be drawn in."""
    panels = _grid(figure, len(balances), 2, sharex=True)
    for b, balance in enumerate(balances):
        yield b, panels[b]
        panels[b].set(title=balance, **labels)
        panels[b].grid(visible=True)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)


def _grid(figure: Figure, count: int, columns: int, sharex: bool = False) -> Sequence[Axes]:
    """Return so many panels in rows of so many; the places that are left over stay empty."""
    panels = figure.subplots(-(-count // columns), columns, sharex=sharex, squeeze=False).ravel()
    for spare in panels[count:]:
        spare.set_visible(False)
    return list(panels[:count])


@drawn()
def resid_panels(figure: Figure, seen: ResidualFit) -> None:
    """Draw the autocorrelation of a residual, and its correlation with each input at lags of either sign, with 99 % bands."""
    drawn_in = [("itself", np.array(seen.autocorrelation), 0, seen.band)]
    drawn_in += [(name, np.array(seen.cross[name]), -LAGS_99, seen.cross_band[name]) for name in seen.outside]
    figure.set_figheight(1.1 + 1.05 * -(-len(drawn_in) // 4))
    panels = _grid(figure, len(drawn_in), 4)
    for axes, (name, values, first, band) in zip(panels, drawn_in, strict=True):
        lag = np.arange(first, LAGS_99 + 1)
        axes.axhspan(-band, band, **WHITE | {"label": "99 % band of independent noise"})
        axes.vlines(lag, 0.0, values, color=AFTER, linewidth=1.2)
        axes.axhline(0.0, color=INK, linewidth=0.5)
        axes.set_title(label_of(name), fontsize=7.5)
        axes.tick_params(labelsize=6.5)
        if first:
            axes.set_ylim(*np.clip([min(values.min(), -band) * 1.3, max(values.max(), band) * 1.3], -1.05, 1.05))
    figure.supxlabel(f"delay of the residual behind the input, in lags of {seen.step:.3g} s", fontsize=8.0)


@drawn()
def cross_correlations(figure: Figure, seen: Portrait) -> None:
    """Draw the correlation with every input and channel at lags of either sign, before and after; dots are beyond noise."""
    figure.set_figheight(1.4 + 0.24 * len(seen.signals))
    panels = figure.subplots(1, 2, sharey=True)
    lag: Array = seen.block * np.arange(-LAGS, LAGS + 1, dtype=float)
    largest = max(0.1, float(np.abs(seen.cross).max()))
    for axes, label, values, limit in zip(panels, LABELS, seen.cross, seen.cross_limit, strict=True):
        image = axes.pcolormesh(lag, np.arange(len(seen.signals)), values, cmap="RdBu_r", vmin=-largest, vmax=largest)
        beyond = np.argwhere((np.abs(values) > limit) & (limit > 0.0))
        if beyond.size:
            axes.plot(lag[beyond[:, 1]], beyond[:, 0], ".", color="#000000", markersize=2.5)
        axes.set(title=label, xlabel="delay of the residual [s]")
    panels[0].set_yticks(np.arange(len(seen.signals)), [label_of(signal) for signal in seen.signals], fontsize=7.5)
    panels[0].invert_yaxis()
    figure.colorbar(image, ax=panels, label="correlation", pad=0.015)
