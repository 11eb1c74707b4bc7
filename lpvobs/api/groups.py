"""Stored parts of logs, some at a time: added up, and compared with the map of all.

Groups are the same however many processes take part, and are added in the order of the digests, so the bits of a sum are, too.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lpvobs.api.jobs import Result, Workers
from lpvobs.io.results.parts import StoredPart
from lpvobs.maps.grid import Grid
from lpvobs.observer.balance_agreement import BalanceSums
from lpvobs.observer.disagreement import Difference, difference
from lpvobs.observer.estimate import Point
from lpvobs.observer.information import Solution
from lpvobs.observer.log_run import LogRun
from lpvobs.observer.parts import LogInformation, added_up
from lpvobs.observer.windows import Moments
from lpvobs.records import Additive

TOGETHER = 25  # logs in a group


@dataclass(frozen=True, eq=False)
class Together(Additive):
    """What some logs say, added in the order of their digests, and what is kept of each."""

    total: Moments
    runs: tuple[LogRun, ...]
    balances: tuple[BalanceSums, ...]
    kept: tuple[tuple[NDArray[np.uint8], ...], ...]


def together(read: Callable[[str], StoredPart], grid: Grid, point: Point, found: Mapping[str, str]) -> Together:
    """Return what some logs say; `found` has the name of each by its digest."""
    balances, kept = [], []

    def parts() -> Iterator[LogInformation]:
        for part, stored in in_order(read, found):
            balances.append(stored.balances)
            kept.append(stored.kept)
            yield part

    total, runs = added_up(grid, point.columns(grid), parts())
    return Together(total, runs, tuple(balances), tuple(kept))


def in_order(
    read: Callable[[str], StoredPart], found: Mapping[str, str]
) -> Iterator[tuple[LogInformation, StoredPart]]:
    """Yield the parts in the order given, each under the name that its log has now, and all that was stored."""
    for sha256, name in found.items():
        stored = read(sha256)
        yield replace(stored.part, run=replace(stored.part.run, name=name)), stored


def differences(
    read: Callable[[str], StoredPart], common: Solution, prior: float, found: Mapping[str, str]
) -> list[Difference]:
    """Return how each of some logs differs from the map of all."""
    return [difference(common, part, prior) for part, _ in in_order(read, found)]


def by_group(
    workers: Workers, found: Mapping[str, str], function: Callable[[Mapping[str, str]], Result]
) -> Iterator[Result]:
    """Yield what a function makes of stored parts, of `TOGETHER` logs at a time, in the order of their digests."""
    logs = sorted(found.items())
    groups = [dict(logs[i : i + TOGETHER]) for i in range(0, len(logs), TOGETHER)]
    here = workers if workers.scheduler is None else Workers()  # other machines do not see the parts
    early: dict[int, Result] = {}
    turn = 0
    for number, result in here.finished(function, groups):
        early[number] = result  # handed on in its turn: the sums of all groups at once would need much memory
        while turn in early:
            yield early.pop(turn)
            turn += 1
