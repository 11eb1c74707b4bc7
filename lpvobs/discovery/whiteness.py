"""Whether a residual is noise: autocorrelation of its block means, a portmanteau test, the periodogram, and what it follows.

Neighbouring instants share samples, so the tests use sums over blocks. The variance of their products is taken from the data:
nothing is assumed about how the noise changes along the drive.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.discovery.linear import Linear
from lpvobs.discovery.thresholds import COLOURED, LAGS, NOTABLE
from lpvobs.records import Array, Item


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
    sums = np.add.reduceat(residual, first, axis=1)
    counts = np.diff(np.append(first, residual.shape[1]))
    sums = sums / np.sqrt(counts)
    found = [portmanteau(row) for row in sums]
    rho, band, p = (np.array([item[i] for item in found]) for i in range(3))
    distance = np.array([periodogram_distance(row) for row in sums])
    means = {name: np.add.reduceat(values, first) / counts for name, values in signals.items()}
    coloured = (p < COLOURED) & (np.abs(rho).max(1) > NOTABLE)
    return Whiteness(
        white=not bool(coloured.any()),
        autocorrelation=rho,
        band=band,
        p_values=p,
        periodogram_distance=distance,
        periodogram_band=1.36 / np.sqrt(max(sums.shape[1] // 2 - 1, 1)),
        correlated_with=_followed(sums, means),
    )


def portmanteau(x: Array) -> tuple[Array, Array, float]:
    """Return autocorrelation and band at lags 1..LAGS, and the p-value of their joint test."""
    x = x - x.mean()
    power = max(float(x @ x), 1e-300)
    lags = range(1, LAGS + 1)
    products = np.array([x[lag:] @ x[:-lag] for lag in lags])
    variance = np.array([(x[lag:] ** 2) @ (x[:-lag] ** 2) for lag in lags])
    statistic = float(np.sum(products**2 / np.maximum(variance, 1e-300)))
    return products / power, 1.96 * np.sqrt(variance) / power, float(scipy.stats.chi2.sf(statistic, LAGS))


def periodogram_distance(x: Array) -> float:
    """Return the largest distance of the cumulated periodogram from that of white noise."""
    power = np.abs(np.fft.rfft(x - x.mean())[1:-1]) ** 2
    if power.size < 2 or power.sum() == 0.0:
        return 0.0
    line = np.arange(1, power.size + 1) / power.size
    return float(np.max(np.abs(np.cumsum(power) / power.sum() - line)))


def _followed(sums: Array, signals: Mapping[str, Array]) -> dict[str, float]:
    limit = times_noise(len(signals) * sums.shape[0] * (2 * LAGS + 1))
    found = {}
    for name, values in signals.items():
        pairs = [correlation(row, values, lag) for row in sums for lag in range(-LAGS, LAGS + 1)]
        strongest = max((r for r, noise in pairs if abs(r) > limit * noise), key=abs, default=0.0)
        if abs(strongest) > NOTABLE:
            found[name] = strongest
    return dict(sorted(found.items(), key=lambda item: -abs(item[1])))


def correlation(x: Array, y: Array, lag: int) -> tuple[float, float]:
    """Return the correlation of x with y `lag` blocks earlier, and its standard deviation for noise of x's own variance."""
    if x.size <= abs(lag) + 2:
        return 0.0, 0.0
    a, b = (x[lag:], y[: y.size - lag]) if lag >= 0 else (x[:lag], y[-lag:])
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return (float(a @ b) / size, float(np.sqrt((a**2) @ (b**2))) / size) if size > 0.0 else (0.0, 0.0)


def times_noise(tests: int) -> float:
    """Return how many standard deviations a correlation must have to count, where so many are looked at."""
    return float(scipy.stats.norm.isf(0.5 * COLOURED / max(1, tests)))


def structure(linear: Linear, on: NDArray[np.bool_] | None = None) -> Whiteness:
    """Return the structure of a model's residual with respect to every input and channel, at some instants or all."""
    problem = linear.problem
    every = problem.inputs() | dict(problem.auxiliary)
    if on is None:
        return whiteness(linear.residual[0], problem.first, every)
    first = np.flatnonzero(np.diff(problem.block[on], prepend=-1))
    return whiteness(linear.residual[0][:, on], first, {name: values[on] for name, values in every.items()})
