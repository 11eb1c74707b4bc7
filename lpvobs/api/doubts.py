"""What speaks against a log or the engine that a map was made with: said beside the map, or instead of it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from lpvobs.errors import DataError
from lpvobs.io.configuration.config import Config
from lpvobs.maps.excitation import corners
from lpvobs.observer.balance_agreement import DISAGREE, BalanceAgreement, BalanceSums, Judged, agreement
from lpvobs.observer.estimate import EngineFound, MapEstimate
from lpvobs.records import Array

NEXT_TO_NOTHING = 0.2  # share of the air flow that a connected sensor reads at least
READS = 0.4
"""Share of the balances' flow that a sensor in the right unit reads at least, and the inverse is what it reads at most. On 30 right
drives it was 0.52 to 1.06; g/s called kg/h make 0.28 of that."""
FOLLOWS = 0.6
"""Correlation of what reading and flow change by within a second, at least. On 12 right drives of engines of another structure, not
calibrated, it was 0.84 to 1.00; a reading late by half a second makes it 0.44, one that is held for a second 0.47."""
SURE, OFF = 6.0, 0.15
"""Standard deviations, and share of it, by which logs may ask for a volume beyond its tolerance. Of 50 right drives of 20 Hz, with
V_im anywhere within its 15 %, one asked for a value 27 % smaller; a late channel looks like another volume. A V_im that is 20 % off
raised the map's error by a quarter at most, on six drives each."""


@dataclass(frozen=True)
class Doubts:
    """The agreement of the balances over all logs, its ratio by log, and a line for everything that is suspicious."""

    agreement: BalanceAgreement
    ratios: Mapping[str, float]
    says: tuple[str, ...]
    # (p,) share of the time that each node stands for, and the mean true air flow there [kg/s]
    driven: tuple[Array, float]
    reading: Array  # (p_2, p_1) [kg/s] mean reading in the cells around each node, NaN where nobody drove


class Doubting:
    """Looks at one log after the other, and adds up what speaks against logs and engine."""

    def __init__(self, config: Config, engine: Judged):
        self._config, self._engine = config, engine
        unknown = engine.unknowns.reduced(engine.unknowns.covariance)
        axes = [axis.channel for axis in engine.air_path.axes]
        self._agreement = partial(agreement, config.grid(), unknown=unknown, axes=axes)
        self._total: BalanceSums | None = None
        self._ratios: dict[str, float] = {}
        self._says: list[str] = []

    def look(self, name: str, sums: BalanceSums) -> None:
        """Look at a log."""
        own = self._agreement(sums)
        self._ratios[name] = own.ratio
        self._says.extend(f"{name}: {text}" for text in _said(self._config, sums, own))
        self._total = sums if self._total is None else self._total + sums

    def doubts(self, estimate: MapEstimate) -> Doubts:
        """Return what speaks against them; raises DataError if the map is larger than a sensor can be wrong."""
        total, says = self._total, self._says
        assert total is not None
        refuse_too_large(estimate, total, self._config.estimate.largest_error, says)
        # of a map that is refused they tell nothing
        further = [*_another_volume(self._engine.air_path.volumes, estimate.engine), self._config.kind.caveat]
        return Doubts(
            self._agreement(total),
            self._ratios,
            (*says, *filter(None, further)),
            _driven(estimate, total),
            _readings(estimate, total),
        )


def _driven(estimate: MapEstimate, sums: BalanceSums) -> tuple[Array, float]:
    nodes = corners(*estimate.grid.shape)
    known = np.isfinite(estimate.theta.ravel()[nodes])
    share = known * (sums.blocks / np.maximum(known.sum(1), 1))[:, None]
    weights = np.bincount(nodes.ravel(), share.ravel(), minlength=estimate.grid.size) / max(share.sum(), 1.0)
    reads = float(sums.reading[known.any(1)].sum()) / max(share.sum(), 1.0)
    return weights, reads - float(weights @ np.nan_to_num(estimate.theta.ravel()))


def _readings(estimate: MapEstimate, sums: BalanceSums) -> Array:
    total, count = (
        np.bincount(corners(*estimate.grid.shape).ravel(), np.repeat(each, 4), minlength=estimate.grid.size)
        for each in (sums.reading, sums.blocks)
    )
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan).reshape(estimate.grid.shape)


def _said(config: Config, sums: BalanceSums, own: BalanceAgreement) -> Iterable[str]:
    """Yield what is suspicious in a log."""
    for check, share in zip(config.kind.suspects.checks, (sums.broken / sums.blocks.sum()).tolist(), strict=True):
        if share > check.most:
            yield (
                f"{check.says} for {100 * share:.0f} % of the time, which a healthy engine never shows; check "
                f"whether the two channels are exchanged, or whether one has a wrong unit or reference pressure"
            )
    reads = 1.0  # what the sensor reads over the flow of the first pair of balances, if there is one
    if sums.flow.shape[1] and (flow := float(sums.flow[:, 0].sum())) > 0.0:
        reads = float(sums.reading @ (sums.pairs[:, 0] / np.maximum(sums.blocks, 1.0))) / flow
    if not READS <= reads <= 1.0 / READS:
        yield (
            f"{config.kind.air_path.sensor} reads {reads:.2g} times the air flow that the engine model gives; check its "
            f"unit: g/s labelled kg/h gives a factor of 0.28, kg/h labelled g/s a factor of 3.6"
        )
    if (follows := sums.follows()) < FOLLOWS:
        yield (
            f"{config.kind.air_path.sensor} does not follow the engine (correlation {follows:.2f} with the air flow "
            f"over a second, expected at least {FOLLOWS:g}); check whether the channel is late, held, or of another recording"
        )
    mistake = sums.mended_by()
    if mistake is not None:
        yield (
            f"the log probably has {config.kind.suspects.mix_ups[mistake].says}, because the air flow balances agree far better "
            f"with them exchanged back; correct the log"
        )
    elif own.ratio > DISAGREE:
        place = ", ".join(f"{axis} {low:g} to {high:g}" for axis, (low, high) in own.where.items())
        yield (
            f"the air flow balances differ by {own.ratio:.1f} times what noise and tolerances allow, most at {place}; check "
            f"the constants in [engine], whether the log is of this engine, and whether the engine has a fault"
        )


def _another_volume(volumes: Sequence[str], found: EngineFound | None) -> Iterable[str]:
    """Yield the volumes that the logs want far from what they are known to be."""
    # Of variances p before and q after them, logs alone put a constant p/(p - q) times as far as it moved, with the variance
    # p q/(p - q): how far it may be off does not make them less sure.
    known = () if found is None else found.unknowns.constants
    for name in volumes:
        if found is None or name not in known:
            continue
        i = known.index(name)
        before, moved = float(found.unknowns.covariance[i, i]), float(found.mean[i] - found.unknowns.mean[i])
        if not before > 0.0:
            continue  # a volume that is known exactly
        gained = max(before - float(found.covariance[i, i]), 1e-9 * before)
        off, alone = moved * before / gained, before * float(found.covariance[i, i]) / gained
        tolerance = np.sqrt(3.0 * before)
        beyond = abs(off) - tolerance
        if beyond > max(OFF, SURE * np.sqrt(alone)):
            which = "larger" if off > 0.0 else "smaller"
            yield (
                f"{name}: fast transients fit better with a value {100 * abs(off):.0f} % {which}, but its tolerance is "
                f"{100 * tolerance:.0f} %; check {name} in [engine]"
            )


def refuse_too_large(estimate: MapEstimate, sums: BalanceSums, most: float, says: Sequence[str]) -> None:
    """Raise DataError for a map that is larger on average, against the air flow, than a sensor can be wrong."""
    nodes = estimate.theta.ravel()[corners(*estimate.grid.shape)]
    known = np.isfinite(nodes).any(axis=1)
    error = np.nanmean(nodes[known], axis=1) * sums.blocks[known]
    air = float(np.abs(sums.reading[known] - error).sum())
    size = float(np.abs(error).sum())
    if not size > most * air:
        return
    why = "no sensor has such a large error: check the sensor's unit and the constants in [engine], first the volumes"
    if abs(float(sums.reading[known].sum())) < NEXT_TO_NOTHING * air:
        why = "the sensor reads almost zero, as if it were unplugged: connect the sensor and drive again"
    elif says:
        why = says[0]
    raise DataError(
        f"the estimated sensor error is {100 * size / air:.0f} % of the air flow on average, expected at most {100 * most:g} % "
        f"(largest_error in [estimate]); {why}"
    )
