"""The description of a residual that no effect explains: when and where in the map it is large, its frequency, what it follows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from lpvobs.discovery.known_effects import own_time
from lpvobs.discovery.linear import Linear
from lpvobs.discovery.thresholds import LARGE, LEAST_VISIT, MOST_NAMED
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


def block_sums(residual: Array, first: NDArray[np.int64]) -> Array:
    """Return the sum of each balance over each block, over the root of its instants, shape (B, blocks)."""
    counts = np.diff(np.append(first, residual.shape[1]))
    return np.asarray(np.add.reduceat(residual, first, axis=1) / np.sqrt(counts))


def leftover(linear: Linear, logs: Sequence[Log], follows: Mapping[str, float]) -> Leftover:
    """Return the description of a model's residual."""
    problem = linear.problem
    power = (linear.residual[0] ** 2).mean(0)
    cells = cell_numbers(problem.grid, linear.nodes[0])
    time = np.bincount(cells)
    mean = np.bincount(cells, power) / np.maximum(time, 1)
    visited = time >= LEAST_VISIT
    worst = int(np.argmax(np.where(visited, mean, 0.0)))
    columns = problem.grid.fuel.size - 1
    row, column = divmod(worst, columns)
    u, n = problem.grid.fuel, problem.grid.speed
    sums = block_sums(linear.residual[0], problem.first)
    return Leftover(
        stretches=tuple(_stretches(linear, power, logs)),
        fuel=(float(u[column]), float(u[column + 1])),
        speed=(float(n[row]), float(n[row + 1])),
        times_noise=float(mean[worst] / np.median(mean[visited])) if visited.any() else 1.0,
        half_power=_half_power(sums, problem.begins),
        balance=problem.model.balances[int(np.argmax((sums**2).sum(1)))],
        follows=follows,
    )


def _stretches(linear: Linear, power: Array, logs: Sequence[Log]) -> list[Stretch]:
    """Return runs of neighbouring blocks with large power, the strongest first."""
    problem = linear.problem
    coarse = problem.block // problem.per_coarse
    time, of_log = own_time(problem, logs), problem.of_log
    first = np.flatnonzero(np.diff(coarse, prepend=-1))
    last = np.append(first[1:], coarse.size) - 1
    mean = np.add.reduceat(power, first) / (last - first + 1)
    usual = float(np.median(mean))
    excess = np.maximum(mean - usual, 0.0) * (last - first + 1)
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
