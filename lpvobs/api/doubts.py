"""What speaks against a log or the engine that a map was made with: said beside the map, or instead of it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from lpvobs.errors import DataError
from lpvobs.io.configuration.config import Config
from lpvobs.maps.excitation import corners
from lpvobs.observer.balance_agreement import DISAGREE, BalanceAgreement, BalanceSums, Judged, agreement
from lpvobs.observer.estimate import MapEstimate

NEXT_TO_NOTHING = 0.2
"""Share of the air flow that a connected sensor reads at least."""


@dataclass(frozen=True)
class Doubts:
    """The agreement of the balances over all logs, its ratio by log, and a line for everything that is suspicious."""

    agreement: BalanceAgreement
    ratios: Mapping[str, float]
    says: tuple[str, ...]


def doubts_of(config: Config, engine: Judged, estimate: MapEstimate, logs: Iterable[tuple[str, BalanceSums]]) -> Doubts:
    """Return what speaks against logs and engine; raises DataError if the map is larger than a sensor can be wrong."""
    covariance = engine.unknowns.reduced(engine.unknowns.covariance)
    grid, axes = config.grid(), [axis.channel for axis in engine.air_path.axes]
    ratios: dict[str, float] = {}
    says: list[str] = []

    def noted(name: str, sums: BalanceSums) -> BalanceSums:
        own = agreement(grid, sums, covariance, axes)
        ratios[name] = own.ratio
        says.extend(f"{name}: {text}" for text in _said(config, sums, own))
        return sums

    total = reduce(add, (noted(name, sums) for name, sums in logs))
    refuse_too_large(estimate, total, config.estimate.largest_error, says)
    return Doubts(agreement(grid, total, covariance, axes), ratios, tuple(says))


def _said(config: Config, sums: BalanceSums, own: BalanceAgreement) -> Iterable[str]:
    """Yield what is suspicious in a log."""
    for check, share in zip(config.kind.suspects.checks, (sums.broken / sums.blocks.sum()).tolist(), strict=True):
        if share > check.most:
            yield (
                f"{check.says} for {100 * share:.0f} % of the time, which no healthy engine does; "
                f"see whether the two are exchanged, or one has another unit or reference"
            )
    mistake = sums.mended_by()
    if mistake is not None:
        yield f"{config.kind.suspects.mix_ups[mistake].says}? Without that the balances would agree far better; mend the log"
    elif own.ratio > DISAGREE:
        place = ", ".join(f"{axis} {low:g} to {high:g}" for axis, (low, high) in own.where.items())
        yield (
            f"the balances differ by {own.ratio:.1f} times what noise and tolerances allow, most at {place}; "
            f"a constant of [engine] is wrong, the log is of another engine, or the engine has a fault"
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
    why = "no sensor is that wrong: see to its unit, and to the constants in [engine], the volumes first"
    if abs(float(sums.reading[known].sum())) < NEXT_TO_NOTHING * air:
        why = "the sensor reads next to nothing, as if it were unplugged: connect it and drive again"
    elif says:
        why = says[0]
    raise DataError(
        f"the map is {100 * size / air:.0f} % of the air flow on average, expected at most {100 * most:g} % (largest_error in "
        f"[estimate]); {why}"
    )
