"""The data for figures of a residual before and after, of bounded size for logs of any length."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from lpvobs.discovery.known_effects import own_time
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.refine import Refinement
from lpvobs.discovery.residual import Problem
from lpvobs.discovery.thresholds import LAGS
from lpvobs.discovery.whiteness import block_sums, correlations, times_noise
from lpvobs.records import Array, Item, Log

MOST_COLUMNS = 500  # columns of the figure for all logs together; each holds the smallest and the largest value
MOST_POINTS = 1500  # points drawn of one partial residual
BINS = 25  # bins of a partial residual
SEGMENT = 256  # instants in each of the segments that a spectrum is averaged over
STILL = 1e-6  # relative range below which a channel counts as constant: nothing can follow it
LEAST_PART = 0.05  # share of an effect's power below which a balance is left out of the effect's partial residual
DRAWN = "f4"  # single precision: a figure shows no more
NOISE = "standard deviations of the noise"
COLUMN = ("balance", "extreme", "time")
BY_BALANCE, BY_LAG = ("state", "balance"), ("state", "signal", "lag")


@dataclass(frozen=True)
class Track:
    """The residual along one log, in M columns."""

    log: str
    time: Annotated[Array, Item("s", "time of the column's middle, since the start of the log")]
    before: Annotated[
        Array, Item("kg/s", "least and largest residual of a column, before", COLUMN, gaps=True, stored=DRAWN)
    ]
    after: Annotated[
        Array, Item("kg/s", "least and largest residual of a column, after", COLUMN, gaps=True, stored=DRAWN)
    ]
    judged: Annotated[NDArray[np.bool_], Item("1", "whether the held-out error is computed from the column", ("time",))]


@dataclass(frozen=True)
class Partial:
    """The added-variable plot of one effect: map, constants and the other effects are projected out of both axes."""

    id: str
    regressor: Annotated[
        Array, Item("1", f"residual that the effect predicts, in {NOISE}", ("point",), gaps=True, stored=DRAWN)
    ]
    residual: Annotated[
        Array, Item("1", f"residual without the effect, in {NOISE}", ("point",), gaps=True, stored=DRAWN)
    ]
    binned: Annotated[Array, Item("1", f"means over bins of the regressor, in {NOISE}", ("mean", "bin"), gaps=True)]


@dataclass(frozen=True)
class Portrait:
    """Data for the figures of a trace or a refinement, B balances.

    The axis `state` has the model before and after, the axis `lag` -LAGS to LAGS blocks, positive where the residual is later.
    """

    balances: Annotated[tuple[str, ...], Item("1", "balance", name="balance")]
    tracks: Annotated[tuple[Track, ...], Item(name="log")]
    partials: Annotated[tuple[Partial, ...], Item(name="effect")]
    block: Annotated[float, Item("s", "length of the blocks whose sums are tested")]
    blocks: Annotated[int, Item("1", "number of blocks")]
    frequency: Annotated[Array, Item("Hz", "frequency")]
    spectrum: Annotated[
        Array, Item("s", "power spectrum of the residual over its noise", (*BY_BALANCE, "frequency"), gaps=True)
    ]
    cumulated: Annotated[
        Array,
        Item(
            "1", "cumulated periodogram of the block sums", (*BY_BALANCE, "share"), "cumulated_periodogram", gaps=True
        ),
    ]
    signals: Annotated[tuple[str, ...], Item("1", "input or channel", name="signal")]
    cross: Annotated[
        Array, Item("1", "strongest correlation of a balance with the signal", BY_LAG, "cross_correlation", gaps=True)
    ]
    cross_limit: Annotated[Array, Item("1", "limit for white noise over all signals and lags", BY_LAG, gaps=True)]
    effective: Annotated[
        Array, Item("1", "number of independent values in the block sums", BY_BALANCE, "effective_blocks", gaps=True)
    ]


def portrait(found: Refinement, logs: Sequence[Log]) -> Portrait:
    """Return the data for the figures of a refinement or a trace."""
    both = (found.before, found.after)
    problem = found.after.problem
    first = problem.first
    signals, residuals = _signals(problem), [linear.residual[0] for linear in both]
    sums = [block_sums(residual, first) for residual in residuals]
    spectra = [_spectrum(residual, problem.spacing) for residual in residuals]
    cross = [cross_correlations(residual, first, signals) for residual in residuals]
    return Portrait(
        balances=problem.model.balances,
        tracks=tuple(_tracks(both, logs)),
        partials=tuple(_partial(found.after, i) for i in range(len(found.after.terms))),
        block=float(np.median(np.diff(problem.begins))) if first.size > 1 else 0.0,
        blocks=first.size,
        frequency=spectra[0][0],
        signals=tuple(signals),
        spectrum=np.stack([power for _, power in spectra]),
        cumulated=np.stack([_cumulated(each) for each in sums]),
        cross=np.stack([r for r, _ in cross]),
        cross_limit=np.stack([limit for _, limit in cross]),
        effective=np.stack([_effective(each) for each in sums]),
    )


def cross_correlations(residual: Array, first: NDArray[np.int64], signals: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return the strongest correlation among the balances, and its limit, both of shape (S, L), see `correlations`."""
    pairs = correlations(residual, first, signals)
    strongest = np.abs(pairs[..., 0]).argmax(1)
    r, noise = np.moveaxis(np.take_along_axis(pairs, strongest[:, None, :, None], 1)[:, 0], -1, 0)
    return r, times_noise(pairs[..., 0].size) * noise


def _signals(problem: Problem) -> dict[str, Array]:
    inputs = problem.inputs()
    moving = {name: values for name, values in inputs.items() if np.ptp(values) > STILL * np.abs(values).max()}
    return moving | dict(problem.auxiliary)


def _tracks(both: tuple[Linear, Linear], logs: Sequence[Log]) -> list[Track]:
    time, of_log = own_time(both[1].problem, logs), both[1].problem.of_log
    columns = max(20, MOST_COLUMNS // len(logs))
    found = []
    for i, log in enumerate(logs):
        on = np.flatnonzero(of_log == i)
        starts = np.unique(np.linspace(0, on.size, min(columns, on.size) + 1).astype(int)[:-1])
        before, after = (_extremes(linear.raw[0][:, on], starts) for linear in both)
        counts = np.diff(np.append(starts, on.size))
        middle = np.add.reduceat(time[on] - log.time[0], starts) / counts
        judged = np.add.reduceat(both[1].problem.judged[on].astype(int), starts) > 0
        found.append(Track(log.name, middle, before, after, judged))
    return found


def _extremes(values: Array, starts: NDArray[np.int64]) -> Array:
    return np.stack([np.minimum.reduceat(values, starts, axis=1), np.maximum.reduceat(values, starts, axis=1)], axis=1)


def _partial(linear: Linear, index: int) -> Partial:
    """Return the added-variable plot of one effect (Frisch and Waugh), in the linear model around the optimum."""
    at = linear.p + linear.beta.size + index
    row = linear.row(index)
    term = linear.terms[index]
    alone = -linear.moved(np.zeros_like(linear.residual), row)[0] / row[at]
    absent = next((effect.null for effect in linear.problem.catalogue if effect.id == term.effect.id), 0.0)
    regressor = -alone * (term.size - absent)
    residual = linear.residual[0] + regressor
    power = (regressor**2).sum(1)
    kept = power >= LEAST_PART * power.sum()
    x, y = regressor[kept].ravel(), residual[kept].ravel()
    order = np.argsort(x)
    parts = [order[a:b] for a, b in zip(*_edges(x.size), strict=True)]
    binned = np.array([[x[p].mean(), y[p].mean(), y[p].std() / np.sqrt(p.size)] for p in parts]).T
    some = np.sort(np.random.default_rng(0).permutation(x.size)[:MOST_POINTS])
    return Partial(term.effect.id, x[some], y[some], binned)


def _edges(size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where bins of as many sorted points each begin and end; the outer ones are small, where an effect shows most."""
    share = 0.5 * (1.0 + np.sin(np.pi * (np.linspace(0.0, 1.0, BINS + 1) - 0.5)))
    edges = np.unique(np.round(share * size).astype(np.int64))
    return edges[:-1], edges[1:]


def _spectrum(residual: Array, spacing: float) -> tuple[Array, Array]:
    """Return frequencies [Hz], shape (f,), and the power at them [1/Hz], shape (B, f): Welch's mean over overlapping segments.

    It is what `scipy.signal.welch` returns, which takes half a second of CPU time to load.
    """
    length = min(SEGMENT, residual.shape[1])
    segments = sliding_window_view(residual, length, axis=1)[:, :: length - length // 2]
    hann = np.hanning(length + 1)[:-1]
    shapes = np.fft.rfft((segments - segments.mean(-1, keepdims=True)) * hann)[..., 1:]
    power = 2.0 * spacing / (hann @ hann) * (np.abs(shapes) ** 2).mean(1)
    if length % 2 == 0:
        power[:, -1] *= 0.5  # this frequency has no negative twin
    return np.asarray(np.fft.rfftfreq(length, spacing)[1:]), np.asarray(power)


def _cumulated(sums: Array) -> Array:
    power = np.abs(np.fft.rfft(sums - sums.mean(1, keepdims=True))[:, 1:]) ** 2
    total = np.maximum(power.sum(1, keepdims=True), 1e-300)
    return np.asarray(np.cumsum(power, axis=1) / total)


def _effective(sums: Array) -> Array:
    """Return how many independent values each balance's block sums are worth, shape (B,): n / (1 + 2 sum of correlations)."""
    x = sums - sums.mean(1, keepdims=True)
    n = x.shape[1]
    power = np.maximum((x**2).sum(1), 1e-300)
    lags = range(1, min(LAGS, n - 1) + 1)
    together = sum(((x[:, lag:] * x[:, :-lag]).sum(1) / power for lag in lags), np.zeros(x.shape[0]))
    return np.asarray(np.clip(n / np.maximum(1.0 + 2.0 * together, 1.0 / n), 1.0, n))
