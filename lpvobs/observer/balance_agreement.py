"""How far the engine's balances agree, and which mistake in the log would make them agree.

Every balance is a flow past the sensor that owes nothing to the sensor, so the difference of two holds neither its error nor the
map. In a cell of the map it is noise, which visits average out, what the constants may be off within their tolerance, and what the
model leaves out. Where it is far more, a constant is wrong, the log is of another engine, or its channels are mixed up.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.engines.base import AirPath
from lpvobs.engines.channels import Channels, Suspects
from lpvobs.engines.followers import followed
from lpvobs.engines.unknowns import Unknowns, unknowns_of
from lpvobs.errors import DataError
from lpvobs.maps.excitation import cell_numbers
from lpvobs.maps.grid import Grid
from lpvobs.observer.parts import log_of
from lpvobs.observer.settings import EstimateSettings
from lpvobs.observer.smoothing import joined
from lpvobs.records import Additive, Array, Defects, Piece, Recording

BLOCK = 0.2  # [s] over which all channels are averaged first: noise goes, transients stay, and it costs little
CHUNK = 1 << 14  # blocks that are held in memory at a time
LEAST_BLOCKS = 5  # in a cell that is compared: a second
LEFT_OUT = 0.02
"""Share of the flow that a balance may be off in a cell for what its equations leave out, constants being right."""
DISAGREE = 2.5
"""Ratio from which on balances disagree. 50 right drives with constants within 1 % had 1.83 at most (`make wrong`); on three a
displacement off by 20 % had 3.4 at least, exchanged channels 3.6."""
SECOND = 5  # blocks
STILL = 0.05  # rms change of the flow in a second, over its mean, below which noise may be all of it
MENDED = 0.5
"""Share of the root mean square of the difference that is left, at most, where a mistake is put right. On 24 right drives each
mistake of a diesel made it 2.8 times larger at least; with constants off by 20 % none left less than 0.6 of it."""


@dataclass(frozen=True)
class BalanceSums(Additive):
    """Sums over blocks of a log in every cell of the grid; those of logs add up. D pairs of balances: the first, and each other."""

    blocks: Array  # (cells,)
    reading: Array  # (cells,) [kg/s], of the sensor
    pairs: Array  # (cells, D) blocks in which both balances of a pair say something; what follows is of these
    flow: Array  # (cells, D) [kg/s], mean of the balances of a pair
    difference: Array  # (cells, D) [kg/s], their difference
    # (D, 1 + H) [kg^2/s^2], square of the difference over all cells, on the log as it is and with each of H mistakes
    # put right
    power: Array
    # (cells, D, q) [kg/s], of the difference by the relative change of each uncertain constant, and the modes of a
    # calibrated engine
    slope: Array
    visits: Array  # (cells, D, 3) over visits, of s and n, the sums of difference and blocks: s^2, s n, n^2
    broken: Array  # (checks,) blocks in which the check is broken
    # (4,) of changes within a second: their number; squares of those of the reading, of those of the balances' flow, and
    # products of both [kg^2/s^2]
    changes: Array

    def follows(self) -> float:
        """Return the correlation of what reading and flow change by within a second; NaN where the flow hardly does."""
        count, reading, flow, both = self.changes.tolist()
        if not flow > count * (STILL * float(self.reading.sum() / self.blocks.sum())) ** 2:
            return nan
        return both / float(np.sqrt(reading * flow)) if reading > 0.0 else 0.0

    def mended_by(self) -> int | None:
        """Return which mistake, put right, makes balances agree far better; None where none does."""
        left = np.sqrt(self.power.max(axis=0, initial=0.0))
        best = 1 + int(np.argmin(left[1:])) if left.size > 1 else 0
        return best - 1 if best and left[best] < MENDED * left[0] else None


@dataclass(frozen=True, kw_only=True)
class BalanceAgreement:
    """How far the balances agree."""

    # root mean square over the map of their difference over its standard deviation; NaN where there is one balance
    ratio: float = nan
    p_value: float = nan  # of a larger one, if noise, tolerances and what the model leaves out were all there is
    where: Mapping[str, tuple[float, float]]  # the cell where they disagree most, by axis


@dataclass(frozen=True)
class Judged:
    """The engine whose balances are judged: around its constants, with what is not known of them and of its corrections."""

    air_path: AirPath
    unknowns: Unknowns


def judged(configured: AirPath, settings: EstimateSettings, known: Unknowns | None) -> Judged:
    """Return the engine as calibrated, with its corrections; where nothing is, as configured within its tolerances."""
    if known is None:
        return Judged(configured, unknowns_of(settings.tolerance, ()))
    return Judged(configured.deviating(known.deviation()), known.seen_from(known.deviation()))


class Watched:
    """A recording that is looked into while somebody else goes through it; how it is cut into pieces changes no bit of the sums."""

    def __init__(self, recording: Recording, engine: Judged, grid: Grid, suspects: Suspects):
        self.recording, self.look = recording, (engine, grid, suspects)
        self.name, self.sha256 = recording.name, recording.sha256
        self._sums: BalanceSums | None = None

    @property
    def defects(self) -> Defects:
        """What was found and done on reading."""
        return self.recording.defects

    def pieces(self) -> Iterator[Piece]:
        """Yield the samples in order."""
        self._sums, rest, means = None, Channels(), Channels()
        for piece in followed(self.look[0].air_path.followers, self.recording.pieces()):
            rest = joined(rest, {"time": piece.time, "begins": piece.begins.astype(float), **piece.channels})
            entered = np.diff(np.floor(rest["time"] / BLOCK), prepend=-np.inf) > 0.0
            first = np.flatnonzero((rest["begins"] > 0.0) | entered)  # no block reaches across a gap
            means = joined(means, _block_means(rest, first))
            rest = {name: column[first[-1] :].copy() for name, column in rest.items()}  # may go on in the next piece
            while means["time"].size >= CHUNK:
                self._add({name: column[:CHUNK] for name, column in means.items()})
                means = {name: column[CHUNK:] for name, column in means.items()}
            yield piece
        if rest:
            self._add(joined(means, _block_means(rest, np.array([0, rest["time"].size]))))

    def _add(self, means: Channels) -> None:
        sums = sums_of(means, *self.look)
        self._sums = sums if self._sums is None else self._sums + sums

    @property
    def sums(self) -> BalanceSums:
        """The sums of what has been gone through; raises DataError where that is nothing."""
        if self._sums is None:
            raise DataError(f"log '{self.name}': no sample could be used; record or export it again")
        return self._sums


def _block_means(columns: Channels, first: NDArray[np.int64]) -> Channels:
    """Return the means of all columns from each block's first sample to the next one's."""
    if first.size < 2:
        return {name: np.empty(0) for name in columns}
    return {name: np.add.reduceat(v[: first[-1]], first[:-1]) / np.diff(first) for name, v in columns.items()}


def sums_of(means: Channels, engine: Judged, grid: Grid, suspects: Suspects) -> BalanceSums:
    """Return the sums over blocks, from the means of their channels."""
    air_path = engine.air_path
    flow, slope = _balances(engine, means)
    difference = flow[1:] - flow[0]
    both = np.isfinite(difference)
    difference, slope = np.where(both, difference, 0.0), np.where(both[:, None], slope[1:] - slope[0], 0.0)
    power = [np.sum(difference**2, axis=1)]
    for mix_up in suspects.mix_ups:
        mended = mix_up.mended(means)
        impossible = any(check.broken(mended).mean() > check.most for check in suspects.checks)
        with np.errstate(all="ignore"):  # a mistake that is none may leave nothing possible
            other, _ = _balances(engine, mended, slopes=False)
        left = np.sum((other[1:] - other[0]) ** 2, axis=1, where=both)
        power.append(np.where(np.isfinite(left) & (not impossible), left, np.inf))
    fuel, speed = (means[axis.channel] for axis in air_path.axes)
    cell = cell_numbers(grid, grid.regressors(fuel, speed)[0])
    cells = (grid.shape[0] - 1) * (grid.shape[1] - 1)

    def by_cell(where: NDArray[np.int64], values: Array) -> Array:
        total = np.zeros((cells, *values.shape[1:]))
        np.add.at(total, where, values)
        return total

    one = np.ones(cell.size)
    entered = np.flatnonzero(np.diff(cell, prepend=-1))
    s, n = np.add.reduceat(difference.T, entered), np.add.reduceat(both.T.astype(float), entered)
    return BalanceSums(
        blocks=by_cell(cell, one),
        reading=by_cell(cell, means[air_path.sensor]),
        pairs=by_cell(cell, both.T.astype(float)),
        flow=by_cell(cell, np.where(both, 0.5 * (flow[1:] + flow[0]), 0.0).T),
        difference=by_cell(cell, difference.T),
        power=np.stack(power, axis=1),
        slope=by_cell(cell, np.moveaxis(slope, -1, 0)),
        visits=by_cell(cell[entered], np.stack([s * s, s * n, n * n], axis=2)),
        broken=np.array([float(np.count_nonzero(check.broken(means))) for check in suspects.checks]),
        changes=_changes(means["time"], means[air_path.sensor], flow[:2].mean(axis=0)),
    )


def _changes(time: Array, reading: Array, flow: Array) -> Array:
    """Return number, squares and products of the changes within a second, shape (4,), where none of them is across a gap."""
    within = (time[SECOND:] - time[:-SECOND] < (SECOND + 1) * BLOCK) & np.isfinite(flow[SECOND:] - flow[:-SECOND])
    r, w = ((x[SECOND:] - x[:-SECOND])[within] for x in (reading, flow))
    return np.array([r.size, np.sum(r * r), np.sum(w * w), np.sum(r * w)])


def _balances(engine: Judged, means: Channels, slopes: bool = True) -> tuple[Array, Array]:
    """Return the flows of all balances [kg/s] and their slopes by what is not known; states and rates are those of the means."""
    time, air_path, unknowns = means["time"], engine.air_path, engine.unknowns
    rates = {name: np.gradient(means[name], time) if time.size > 1 else np.zeros(1) for name in air_path.smoothed}
    log = log_of(time, means)
    found = air_path.balances(log, rates, unknowns.constants if slopes else ())
    if not unknowns.components:
        return found.flow, found.slope
    flow, n = found.flow.copy(), len(unknowns.constants)
    modes = np.zeros((len(flow), unknowns.reduction.shape[1] - n if slopes else 0, time.size))
    for place, correction in zip(unknowns.places().values(), air_path.corrections(log, rates), strict=True):
        on = correction.on(len(flow))
        columns = correction.columns(place.stop - place.start)
        flow[on] += columns @ unknowns.mean[place]
        if slopes:
            modes[on] += (columns @ unknowns.reduction[place, n:]).T
    return flow, np.concatenate([found.slope, modes], axis=1)


def agreement(grid: Grid, sums: BalanceSums, unknown: Array, axes: Sequence[str]) -> BalanceAgreement:
    """Return how far the balances agree: of the pair that does so least.

    The sums are those of a log, or of several added up; `unknown`, shape (q, q), is the covariance of what the slopes are by,
    and `axes` names the map's axes, fuel first.
    """
    pairs = sums.difference.shape[1]
    worst = BalanceAgreement(where={})
    for pair in range(pairs):
        cells = np.flatnonzero(sums.pairs[:, pair] >= LEAST_BLOCKS)
        if not cells.size:
            continue
        n = sums.pairs[cells, pair]
        share = n / n.sum()
        mean, flow, slope = (of[cells, pair].T / n for of in (sums.difference, sums.flow, sums.slope))
        ss, sn, nn = sums.visits[cells, pair].T
        own = np.maximum(ss - 2.0 * mean * sn + mean**2 * nn, 0.0) / n**2
        noise = own + np.median(own * n) / n  # a cell that was visited once has none of its own
        covariance = np.diag(noise + (LEFT_OUT * flow) ** 2) + slope.T @ unknown @ slope
        scale = np.sqrt(np.diag(covariance))
        squares = share * (mean / scale) ** 2
        # The probability of a larger sum of correlated chi-squares, as of one with the same mean, 1, and variance, twice `half`.
        half = float(share @ (covariance / np.outer(scale, scale)) ** 2 @ share)
        p_value = min(1.0, pairs * float(scipy.special.gammaincc(0.5 / half, 0.5 * squares.sum() / half)))
        row, column = divmod(int(cells[np.argmax(squares)]), grid.fuel.size - 1)
        ends = (grid.fuel[column : column + 2].tolist(), grid.speed[row : row + 2].tolist())
        where = {axis: (low, high) for axis, (low, high) in zip(axes, ends, strict=True)}
        if not worst.ratio >= (ratio := float(np.sqrt(squares.sum()))):  # the first is better than NaN
            worst = BalanceAgreement(ratio=ratio, p_value=p_value, where=where)
    return worst
