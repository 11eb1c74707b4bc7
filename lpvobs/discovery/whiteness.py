"""What is left of a residual: whether it is noise, and if not, when and where it is large, how fast it varies, what it follows.

Neighbouring instants share samples, so the tests of whiteness (autocorrelation, a portmanteau test, the periodogram) use sums over
blocks. The variance of their products is taken from the data: nothing is assumed about how the noise changes along the drive.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypedDict

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery.known_effects import own_time
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.thresholds import COLOURED, LAGS, LARGE, LEAST_VISIT, MOST_NAMED, NOTABLE
from lpvobs.kinds import Finite
from lpvobs.maps.excitation import cell_numbers
from lpvobs.records import Array, Item, Log

Pair = tuple[Finite, Finite]
STRONGEST = "map cell where the residual's mean square is largest"
When = TypedDict("When", {"log": str, "from": Finite, "to": Finite, "share": float})


class Where(TypedDict):
    """The map cell with the largest mean square of the residual, and how many times the median cell's mean square that is."""

    fuel: Pair
    speed: Pair
    times_median_power: float


class Frequency(TypedDict):
    """The frequency below which half of the residual's power lies."""

    half_power_below: float
    unit: str


@dataclass(frozen=True)
class Stretch:
    """A part of a log in which the residual is large."""

    log: Annotated[str, Item("1", "log")]
    begin: Annotated[float, Item("s", "begin of the stretch, since the start of the log", name="from")]
    end: Annotated[float, Item("s", "end of the stretch, since the start of the log", name="to")]
    share: Annotated[float, Item("1", "share of the residual's power above the median", gaps=True)]


@dataclass(frozen=True)
class Leftover:
    """When, where and how fast a residual is, and what it follows.

    `stretches` are at most `MOST_NAMED`, the strongest first; `balance` is the one in which most of it shows.
    """

    stretches: Annotated[tuple[Stretch, ...], Item(axes=("stretch",))]
    fuel: Annotated[tuple[float, float], Item("1", f"{STRONGEST}: fuel, in the unit of its axis", ("end",))]
    speed: Annotated[tuple[float, float], Item("rpm", f"{STRONGEST}: speed", ("end",))]
    times_noise: Annotated[float, Item("1", "largest mean square of a cell over that of the median cell", gaps=True)]
    half_power: Annotated[float, Item("Hz", "frequency below which half of the power of the block sums lies")]
    balance: str
    follows: Annotated[
        Mapping[str, float],
        Item("1", "strongest correlation of the residual with the signal", ("signal",), "correlation"),
    ]

    def as_json(self) -> dict[str, Any]:
        """Return it for programs."""
        return {
            "when": [{"log": s.log, "from": s.begin, "to": s.end, "share": s.share} for s in self.stretches],
            "where": {"fuel": list(self.fuel), "speed": list(self.speed), "times_median_power": self.times_noise},
            "frequency": {"half_power_below": self.half_power, "unit": "Hz"},
            "balance": self.balance,
        }


@dataclass(frozen=True)
class Whiteness:
    """Structure of the residual.

    White noise has the same uneven variance; lags begin with one. `correlated_with` has the correlation with every signal where
    it is significant and notable; it is empty where the residual is white.
    """

    white: Annotated[bool, Item("1", "whether no balance fails the portmanteau test with a notable correlation")]
    autocorrelation: Annotated[
        Array, Item("1", "autocorrelation of the residual's block sums", ("balance", "lag"), gaps=True)
    ]
    band: Annotated[Array, Item("1", "half width of the 95 % band of white noise", ("balance", "lag"), gaps=True)]
    p_values: Annotated[Array, Item("1", "p-value of the portmanteau test", ("balance",), "p_value", gaps=True)]
    periodogram_distance: Annotated[
        Array, Item("1", "distance of the cumulated periodogram from a line", ("balance",), gaps=True)
    ]
    periodogram_band: Annotated[float, Item("1", "95 % limit of that distance for white noise", gaps=True)]
    correlated_with: Annotated[
        Mapping[str, float], Item("1", "correlation of the residual with the signal", ("signal",))
    ]


def whiteness(residual: Array, first: NDArray[np.int64], signals: Mapping[str, Array]) -> Whiteness:
    """Return the structure of a whitened residual, shape (B, K).

    `first`, shape (blocks,), is the first instant of every block; the residual may be correlated with the signals, shape (K,) each.
    """
    sums = block_sums(residual, first)
    found = [portmanteau(row) for row in sums]
    rho, band, p = (np.array([item[i] for item in found]) for i in range(3))
    distance = np.array([periodogram_distance(row) for row in sums])
    coloured = (p < COLOURED) & (np.abs(rho).max(1) > NOTABLE)
    return Whiteness(
        white=not bool(coloured.any()),
        autocorrelation=rho,
        band=band,
        p_values=p,
        periodogram_distance=distance,
        periodogram_band=1.36 / np.sqrt(max(sums.shape[1] // 2 - 1, 1)),
        correlated_with=_followed(list(signals), correlations(residual, first, signals)),
    )


def portmanteau(x: Array) -> tuple[Array, Array, float]:
    """Return autocorrelation and band at lags 1..LAGS, and the p-value of their joint test."""
    x = x - x.mean()
    power = max(float(x @ x), 1e-300)
    lags = range(1, LAGS + 1)
    products = np.array([x[lag:] @ x[:-lag] for lag in lags])
    variance = np.array([(x[lag:] ** 2) @ (x[:-lag] ** 2) for lag in lags])
    statistic = float(np.sum(products**2 / np.maximum(variance, 1e-300)))
    return products / power, 1.96 * np.sqrt(variance) / power, float(scipy.special.chdtrc(LAGS, statistic))


def periodogram_distance(x: Array) -> float:
    """Return the largest distance of the cumulated periodogram from that of white noise."""
    power = np.abs(np.fft.rfft(x - x.mean())[1:-1]) ** 2
    if power.size < 2 or power.sum() == 0.0:
        return 0.0
    line = np.arange(1, power.size + 1) / power.size
    return float(np.max(np.abs(np.cumsum(power) / power.sum() - line)))


def _followed(names: Sequence[str], pairs: Array) -> dict[str, float]:
    """Return the strongest correlation with each signal that is significant and notable, the strongest first."""
    r, noise = np.moveaxis(pairs, -1, 0)
    strong = np.where((np.abs(r) > times_noise(r.size) * noise) & (np.abs(r) > NOTABLE), r, 0.0)
    found = {name: max(each.ravel().tolist(), key=abs) for name, each in zip(names, strong, strict=True) if each.any()}
    return dict(sorted(found.items(), key=lambda item: -abs(item[1])))


def correlations(residual: Array, first: NDArray[np.int64], signals: Mapping[str, Array]) -> Array:
    """Return the correlation of S signals with B balances at L lags of blocks, and its deviation for noise, shape (S, B, L, 2).

    Lags go from -LAGS to LAGS. At a positive lag the residual comes after the signal.
    """
    sums, counts = block_sums(residual, first), np.diff(np.append(first, residual.shape[1]))
    means = (
        np.add.reduceat(np.reshape(list(signals.values()), (len(signals), residual.shape[1])), first, axis=1) / counts
    )
    return np.stack([correlation(sums, means, lag) for lag in range(-LAGS, LAGS + 1)], axis=2)


def correlation(x: Array, y: Array, lag: int) -> Array:
    """Return the correlation of B rows x with S rows y `lag` columns earlier, and its deviation for noise of x's own variance.

    Its shape is (S, B, 2).
    """
    n = x.shape[1] - abs(lag)
    if n <= 2:
        return np.zeros((len(y), len(x), 2))
    a, b = (x[:, lag:], y[:, :n]) if lag >= 0 else (x[:, :n], y[:, -lag:])
    a, b = (row - row.mean(1, keepdims=True) for row in (a, b))
    size = np.sqrt(np.outer((b**2).sum(1), (a**2).sum(1)))
    pair = np.stack([b @ a.T, np.sqrt(b**2 @ (a**2).T)], axis=-1)
    return np.asarray(np.divide(pair, size[..., None], out=np.zeros_like(pair), where=size[..., None] > 0.0))


def times_noise(tests: int) -> float:
    """Return how many standard deviations a correlation must have to count, where so many are looked at."""
    return float(-scipy.special.ndtri(0.5 * COLOURED / max(1, tests)))


def structure(linear: Linear, on: NDArray[np.bool_] | slice = slice(None)) -> Whiteness:
    """Return the structure of a model's residual with respect to every input and channel, at some instants or all."""
    problem = linear.problem
    every = problem.inputs() | dict(problem.auxiliary)
    first = np.flatnonzero(np.diff(problem.block[on], prepend=-1))
    return whiteness(linear.residual[0][:, on], first, {name: values[on] for name, values in every.items()})


def block_sums(residual: Array, first: NDArray[np.int64]) -> Array:
    """Return the sum of each balance over each block, over the root of its instants, shape (B, blocks)."""
    counts = np.diff(np.append(first, residual.shape[1]))
    return np.asarray(np.add.reduceat(residual, first, axis=1) / np.sqrt(counts))


def leftover(linear: Linear, logs: Sequence[Log], follows: Mapping[str, float]) -> Leftover:
    """Return the description of a model's residual where a balance counts: other places leave nothing."""
    problem = linear.problem
    power, counts = (linear.residual[0] ** 2).mean(0), np.asarray(problem.shown.any(axis=0))
    cells = cell_numbers(problem.grid, linear.nodes[0])
    time = np.bincount(cells, counts)
    mean = np.bincount(cells, power) / np.maximum(time, 1)
    visited = time >= LEAST_VISIT
    worst = int(np.argmax(np.where(visited, mean, 0.0)))
    columns = problem.grid.fuel.size - 1
    row, column = divmod(worst, columns)
    u, n = problem.grid.fuel, problem.grid.speed
    sums = block_sums(linear.residual[0], problem.first)
    return Leftover(
        stretches=tuple(_stretches(linear, power, counts, logs)),
        fuel=(float(u[column]), float(u[column + 1])),
        speed=(float(n[row]), float(n[row + 1])),
        times_noise=float(mean[worst] / np.median(mean[visited])) if visited.any() else 1.0,
        half_power=_half_power(sums, problem.begins),
        balance=problem.model.balances[int(np.argmax((sums**2).sum(1)))],
        follows=follows,
    )


def _stretches(linear: Linear, power: Array, counts: NDArray[np.bool_], logs: Sequence[Log]) -> list[Stretch]:
    """Return runs of neighbouring blocks with large power where the places count, the strongest first."""
    problem = linear.problem
    coarse, of_log, time = problem.coarse, problem.of_log, own_time(problem, logs)
    first = np.flatnonzero(np.diff(coarse, prepend=-1))
    last = np.append(first[1:], coarse.size) - 1
    number = np.add.reduceat(counts, first, dtype=float)
    mean = np.add.reduceat(power, first) / np.maximum(number, 1.0)
    usual = float(np.median(mean[number > 0.0])) if counts.any() else 0.0
    excess = np.maximum(mean - usual, 0.0) * number
    total = max(float(excess.sum()), 1e-300)
    large = np.flatnonzero(mean > LARGE * usual)
    apart = (np.diff(large) > 1) | (np.diff(of_log[first[large]]) != 0)
    found = []
    for run in np.split(large, np.flatnonzero(apart) + 1) if large.size else ():
        log = logs[int(of_log[first[run[0]]])]
        begin, end = (float(time[at] - log.time[0]) for at in (first[run[0]], last[run[-1]]))
        found.append(Stretch(log.name, begin, end, float(excess[run].sum() / total)))
    return sorted(found, key=lambda stretch: -stretch.share)[:MOST_NAMED]


def _half_power(sums: Array, begins: Array) -> float:
    """Return the frequency below which half of the power of the block sums lies [Hz]."""
    power = (np.abs(np.fft.rfft(sums - sums.mean(1, keepdims=True))[:, 1:]) ** 2).sum(0)
    if power.size == 0 or begins.size < 2:
        return 0.0
    frequency = np.fft.rfftfreq(sums.shape[1], float(np.median(np.diff(begins))))[1:]
    at = int(np.searchsorted(np.cumsum(power), 0.5 * power.sum()))
    return float(frequency[min(at, frequency.size - 1)])
