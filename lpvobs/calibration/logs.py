"""An engine from logs whose air flow is known: a sensor that is in order that day, or a reference meter in its place."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpvobs.engines.unknowns import Unknowns
from lpvobs.maps.grid import Grid
from lpvobs.observer.estimate import PASSES, EngineFound, Point
from lpvobs.observer.information import NO_LEVEL, Prior, solve
from lpvobs.observer.parts import StateGain, added_up, inform
from lpvobs.observer.windows import Columns
from lpvobs.records import Array, Recording

NO_ERROR = 1e-9
"""[kg/s], standard deviation of a node of the map where the sensor is right."""


@dataclass(frozen=True)
class Taught:
    """What logs of known air flow say of an engine."""

    unknowns: Unknowns  # mean and covariance, deviations counted from the configured constants
    prior_error: Array  # (q,) standard deviations before, at the amplitudes found
    amplitudes: dict[str, float]  # of the groups whose amplitude was not known before


def taught(
    start: Point, grid: Grid, gain: StateGain, logs: Sequence[Recording], progress: Callable[[float], None]
) -> Taught:
    """Return the engine as logs show it whose sensor makes no error, from what is known of it before.

    Sums are kept over the cells of the grid; each log is gone through once a pass.
    """
    point = start
    for turn in range(PASSES):
        unknowns = point.unknowns
        layout = Columns(grid.size, unknowns.size, len(point.configured.balance_names))
        parts = []
        for count, log in enumerate(logs, 1):
            parts.append(inform(point.air_path, grid, gain, log, point.settings, unknowns))
            progress((turn + count / len(logs)) / PASSES)
        total = added_up(grid, layout, sorted(parts, key=lambda part: part.run.sha256))
        solution = solve(layout, total, Prior(NO_ERROR, unknowns, (NO_LEVEL,) * layout.balances))
        own = solution.engine
        found = EngineFound(unknowns, point.deviation, solution.mean[own], solution.covariance[own, own])
        moved = point.moved(found)
        if moved is point:
            break
        point = moved
    mean = found.mean.copy()
    mean[: len(unknowns.constants)] = list(found.deviation().values())
    before = start.unknowns
    return Taught(
        unknowns=replace(before, mean=mean, covariance=found.covariance, learned=True),
        prior_error=np.sqrt(np.diag(before.scaled(solution.amplitudes))),
        amplitudes=dict(zip(before.groups(), solution.amplitudes, strict=True)),
    )
