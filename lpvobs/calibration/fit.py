"""The engine's unknowns from bench rows, or from logs whose air flow is known: amplitudes, what is left, mean and covariance.

The rows are jointly Gaussian, z ~ N(J mean, J C J^T + D): C holds the prior of the unknowns at some amplitudes, D the errors of the
references and, of each kind of row, what no correction follows. Amplitudes and these are the most likely ones of a short list.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from lpvobs.calibration.bench import Rows, Table, rows_of
from lpvobs.engines.base import AirPath
from lpvobs.engines.unknowns import LeftAtNodes, Unknowns
from lpvobs.maps.grid import Grid
from lpvobs.observer.equations import mean_flow
from lpvobs.observer.estimate import PASSES, EngineFound, Point
from lpvobs.observer.information import solve
from lpvobs.observer.parts import StateGain, added_up, inform
from lpvobs.observer.prior import AMPLITUDE_SPREAD, AMPLITUDES, prior_of, swept
from lpvobs.records import Array, Recording

Floats = Sequence[float]
Told = Callable[[float], None]  # takes the fraction done
LEFT = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
"""Of the flow, what a component's correction does not follow: what is tried."""
STEPS = 6  # of Gauss-Newton on the constants
SMALL_STEP = 1e-4  # relative change of a constant from which on the engine stays where it is linearised


@dataclass(frozen=True, eq=False)
class Calibration:
    """What is known of an engine."""

    unknowns: Unknowns  # mean and covariance, deviations counted from the configured constants
    prior: Unknowns  # the same before
    amplitudes: Mapping[str, float]  # of the corrections by group
    rows: Rows  # where the engine was found, so that z is what its formulas leave there
    before: Array  # (m,) [kg/s], z of the same rows at the configured constants; NaN where those give no flow
    left: Mapping[str, float]  # by kind of row, share of the flow that no correction follows
    held_out: Array  # (m,) [kg/s], each row less what all other points say of it
    held_out_error: Array  # (m,) its standard deviation
    residual: Array  # (m,) [kg/s], what the engine found leaves of each row


def calibrated(air_path: AirPath, prior: Unknowns, tables: Sequence[Table]) -> Calibration:
    """Return the engine as bench points and tables of components show it; `air_path` is as configured."""
    point: dict[str, float] = {}
    before: dict[tuple[int, int], float] = {}
    amplitudes: Floats = [0.3] * len(prior.groups())
    left: Floats = []
    for step in range(STEPS):
        there = air_path.deviating(point) if point else air_path
        seen = prior.seen_from(point)
        rows = rows_of(there, seen, tables)
        before = before or dict(zip(_marks(rows), rows.z.tolist(), strict=True))
        left = left or [LEFT[3]] * len(rows.kind)
        if step < 2:
            amplitudes, left = likeliest(seen, rows.measured(), amplitudes, left)
        found = EngineFound(seen, point, *posterior(seen, rows, amplitudes, left))
        point = found.deviation()
        if np.abs(found.mean[: len(prior.constants)]).max(initial=0.0) < SMALL_STEP:
            break
    held_out, error = left_out(seen, rows, amplitudes, left)
    by_group = dict(zip(prior.groups(), amplitudes, strict=True))
    z = np.array([before.get(mark, np.nan) for mark in _marks(rows)])
    shares = dict(zip((kind.name for kind in rows.kind), left, strict=True))
    residual = rows.z - rows.J @ found.mean
    return Calibration(found.after(), prior, by_group, rows, z, shares, held_out, error, residual)


def _marks(rows: Rows) -> list[tuple[int, int]]:
    return list(zip(rows.of.tolist(), rows.point.tolist(), strict=True))


def spread_of(unknowns: Unknowns, rows: Rows, amplitudes: Floats, left: Floats) -> Array:
    """Return the covariance of the rows, shape (m, m)."""
    shares = np.array(left)[rows.of]
    own = np.diag(rows.error**2 + (shares * rows.reference) ** 2) + rows.shared @ rows.shared.T
    return rows.J @ unknowns.scaled(amplitudes) @ rows.J.T + own


def likeliest(unknowns: Unknowns, rows: Rows, amplitudes: Floats, left: Floats) -> tuple[Floats, Floats]:
    """Return the amplitudes and the shares left that make the rows most likely, sought one after the other."""
    groups, away = len(amplitudes), rows.z - rows.J @ unknowns.mean
    if not rows.z.size:  # tables alone: they are smoothed, and say nothing of what an engine has beyond
        return [1.0] * groups, [0.0] * len(left)

    def cost(tried: Sequence[float]) -> float:
        factor = np.linalg.cholesky(spread_of(unknowns, rows, tried[:groups], tried[groups:]))
        white = scipy.linalg.solve_triangular(factor, away, lower=True, check_finite=False)
        far = float(np.sum((np.log(tried[:groups]) / AMPLITUDE_SPREAD) ** 2))
        return float(np.log(np.diag(factor)).sum()) + 0.5 * float(white @ white) + 0.5 * far

    best = swept([*amplitudes, *left], [AMPLITUDES] * groups + [LEFT] * len(left), cost)
    return best[:groups], best[groups:]


def posterior(unknowns: Unknowns, rows: Rows, amplitudes: Floats, left: Floats) -> tuple[Array, Array]:
    """Return mean and covariance of the unknowns, given the rows."""
    C = unknowns.scaled(amplitudes)
    across = rows.J @ C
    gain = np.linalg.solve(spread_of(unknowns, rows, amplitudes, left), across).T
    covariance = C - gain @ across
    return unknowns.mean + gain @ (rows.z - rows.J @ unknowns.mean), 0.5 * (covariance + covariance.T)


def left_out(unknowns: Unknowns, rows: Rows, amplitudes: Floats, left: Floats) -> tuple[Array, Array]:
    """Return each row less what all other points say of it, and the standard deviation of that, each of shape (m,)."""
    inverse = np.linalg.inv(spread_of(unknowns, rows, amplitudes, left))
    white = inverse @ (rows.z - rows.J @ unknowns.mean)
    away, error = np.empty(rows.z.size), np.empty(rows.z.size)
    for number in np.unique(rows.point).tolist():
        own = np.flatnonzero(rows.point == number)
        block = np.linalg.inv(inverse[np.ix_(own, own)])
        away[own], error[own] = block @ white[own], np.sqrt(np.diag(block))
    return away, error


USUALLY_LEFT = 0.02
"""Share of the mean air flow that formulas and corrections leave at a node of the map, where no bench tells: the deviation of what
logs of known air flow are asked for there. On four engines of another structure the map was off by 0.81 % of the air flow without
it, by 0.76 % with a share of 0.005, 0.47 % with 0.02, 0.43 % with 0.05, and 0.46 % without any bound."""


@dataclass(frozen=True)
class Taught:
    """What logs of known air flow say of an engine."""

    unknowns: Unknowns  # mean and covariance, deviations counted from the configured constants
    prior_error: Array  # (q,) standard deviations before, at the amplitudes found
    amplitudes: dict[str, float]  # of the groups whose amplitude was not known before


def taught(
    start: Point, grid: Grid, gain: StateGain, logs: Sequence[Recording], told: Told, left: float = USUALLY_LEFT
) -> Taught:
    """Return the engine as logs show it whose sensor makes no error, from what is known of it before.

    `left` is the share of the air flow that formulas and corrections do not follow.
    """
    # Sums are kept over the cells of the grid; each log is gone through once a pass.
    point = start
    for turn in range(PASSES):
        unknowns, layout, parts = point.unknowns, point.columns(grid), []
        for count, log in enumerate(logs, 1):
            parts.append(inform(point.air_path, grid, gain, log, point.settings, unknowns))
            told((turn + count / len(logs)) / PASSES)
        total, _ = added_up(grid, layout, sorted(parts, key=lambda part: part.run.sha256))
        # No formula is better than the least share, even where a bench shows nothing left.
        away = max(left, LEFT[1]) * mean_flow(layout, total)
        solution = solve(layout, total, replace(prior_of(grid, away, unknowns), may_follow=False))
        own = layout.engine
        found = EngineFound(unknowns, point.deviation, solution.mean[own], solution.covariance[own, own])
        moved = point.moved(found)
        if moved is point:
            break
        point = moved
    # A later map has a wide prior at its nodes. So has this one: then both hold the same share of what a balance repeats.
    exactly = replace(unknowns, mean=found.mean, covariance=np.zeros_like(found.covariance), learned=True)
    left_over = solve(layout, total, replace(prior_of(grid, point.settings.prior_map, exactly), may_follow=False))
    # What the engine's formulas leave is the map at known unknowns, and how it goes with them.
    at_nodes = LeftAtNodes(grid.fuel, grid.speed, left_over.theta, -left_over.response, left_over.noise)
    before = start.unknowns
    return Taught(
        unknowns=replace(found.after(), at_nodes=at_nodes),
        prior_error=np.sqrt(np.diag(before.scaled(solution.scales.amplitudes))),
        amplitudes=dict(zip(before.groups(), solution.scales.amplitudes, strict=True)),
    )
