"""From logs to the map: the default method.

Scheduling parameters from smoothed signals; the state by the observer of Eq. (26) with the map's part left out, a gain
whose last column is zero; then the map by weighted least squares behind that state, from every balance of the engine. It is not the
map equation of Eq. (26): `information` says how it departs. Theorem 1 is proven for one balance and constant Gamma; it is not
claimed for several balances. The certificate is about the state, and the state is nearly its newest measurement: of a gain of
20 000 1/s and samples 10 ms apart, 99.5 % (1 - 1 / (1 + h L)). What the state owes to the engine's model instead is wrong with the
model: with 2000 1/s a turbine of another shape moved the map by 0.3 % of the air flow, through the pressure before it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from lpvobs.engines.base import AirPath
from lpvobs.engines.unknowns import Unknowns, unknowns_of
from lpvobs.errors import DataError
from lpvobs.maps.excitation import Excitation, of_cells
from lpvobs.maps.grid import Grid
from lpvobs.maps.quadratic import BOTH, NODES, terms_at_nodes
from lpvobs.observer.information import AlongFlow, Solution, considered, solve
from lpvobs.observer.log_run import LogRun
from lpvobs.observer.parts import LogInformation, StateGain, added_up, inform
from lpvobs.observer.prior import prior_of
from lpvobs.observer.settings import EstimateSettings
from lpvobs.observer.smoothing import smooth
from lpvobs.observer.windows import Columns, Moments
from lpvobs.records import Array, Item, Log, Recording

PASSES = 12
"""Over the logs, at most, until the engine is linearised where it is found. Of forty engines with constants drawn within 1, 2 or
3 %, none needed more than nine; after three, two maps were off by 10 and 16 % that end at 1.1 %."""
LINEAR, MILD = 0.001, 0.05
"""Relative change within which the balances count as linear in a constant: a steep one (near stall a compressor is not, beyond),
and any other. With 0.003 for the steep ones, one engine of ten whose constants were off by twice their tolerance stayed where it
was, and its map was off by 16.8 % (now 1.2 %). Flows are linear in most others, and what the product of two leaves is under
0.3 %. At 0.003 for all, EGR constants crept on from pass to pass where the flow reverses within a window: on FTP75 without noise
0.45 % became 1.8 %."""


@dataclass(frozen=True)
class EngineFound:
    """What the logs say of the engine."""

    unknowns: Unknowns  # with their prior
    point: Mapping[str, float]  # relative deviations of the constants at which the balances were linearised
    mean: Array  # (q,) seen from there
    covariance: Array  # (q, q)
    amplitudes: tuple[float, ...] = ()  # of the groups of corrections
    step: Array | None = None  # (q,) to where the engine is linearised next; None: the mean

    def moved(self) -> dict[str, float]:
        """Return by how much each constant has moved from the point."""
        return dict(zip(self.unknowns.constants, self.mean.tolist(), strict=False))

    def deviation(self) -> dict[str, float]:
        """Return the relative deviation of every constant from the configured one."""
        return {name: (1.0 + self.point.get(name, 0.0)) * (1.0 + share) - 1.0 for name, share in self.moved().items()}

    def after(self) -> Unknowns:
        """Return what is known now, deviations counted from the configured values."""
        mean = self.mean.copy()
        mean[: len(self.unknowns.constants)] = list(self.deviation().values())
        return replace(self.unknowns, mean=mean, covariance=self.covariance, learned=True)

    def before(self) -> Unknowns:
        """Return the prior, deviations counted from the configured values."""
        return self.unknowns.seen_from({name: 1.0 / (1.0 + share) - 1.0 for name, share in self.point.items()})


@dataclass(frozen=True)
class Point:
    """Where an engine is linearised."""

    configured: AirPath
    settings: EstimateSettings  # with a tolerance for every constant of the balances
    deviation: Mapping[str, float] = field(default_factory=dict)  # of the engine's constants from the configured ones
    known: Unknowns | None = None  # what a calibration has found; None for the tolerances of the settings

    @property
    def air_path(self) -> AirPath:
        """The engine there."""
        return self.configured.deviating(self.deviation) if self.deviation else self.configured

    @property
    def unknowns(self) -> Unknowns:
        """The engine's unknowns, seen from there."""
        known = self.known or unknowns_of(self.settings.tolerance, self.configured.components)
        return known.seen_from(self.deviation)

    def columns(self, grid: Grid) -> Columns:
        """Return what there is to solve for."""
        return Columns(grid.size, self.unknowns.size, len(self.configured.balance_names))

    def moved(self, found: EngineFound | None) -> "Point":
        """Return the point that an estimate has found, or this one where its linearisation holds."""
        if found is None or not self.configured.calmed:  # balances are linear in what is not known
            return self
        nearer = found if found.step is None else replace(found, mean=found.step)
        # Flows are linear in a volume wherever it is, so it stays where the estimate began, as the gain is certified.
        steep, volumes = self.configured.steep, self.configured.volumes
        most = {name: LINEAR if name in steep else np.inf if name in volumes else MILD for name in nearer.moved()}
        moved = [name for name, share in nearer.moved().items() if abs(share) > most[name]]
        if not moved:
            return self
        moved += [name for name in steep if name in most and name not in moved]
        deviation = nearer.deviation()
        return replace(self, deviation={**self.deviation, **{name: deviation[name] for name in moved}})


ERROR = "error of the mass air flow sensor, reading minus truth"
ORIGIN = "where the value comes from"
PER_CONSTANT = "change of the map per relative error of the constant"


@dataclass(frozen=True)
class NodeMap:
    """The map and how good it is."""

    method: str
    grid: Grid
    # NaN where nothing supports it
    theta: Annotated[Array, Item("kg/s", ERROR, BOTH, "delta_W_c", gaps=True)]
    standard_error: Annotated[Array, Item("kg/s", "standard error of delta_W_c", BOTH, gaps=True)]
    supported: Annotated[NDArray[np.bool_], Item("1", ORIGIN, BOTH, "support", meanings={0: "none", 1: "estimated"})]
    # the smallest eigenvalue of every cell, shape (p_2 - 1, p_1 - 1)
    excitation: Annotated[Array, Item("s", "persistency of excitation, delta_1 of Eq. (29)", BOTH, "delta_1")]
    covariance: Annotated[
        Array, Item("kg^2/s^2", "covariance of the nodes; NaN where the method has none", NODES, gaps=True)
    ]
    noise: Annotated[Array, Item("kg^2/s^2", "part of it that no engine constant explains", NODES, gaps=True)]
    # what the method would find for each term of `maps.quadratic`
    design: Annotated[Array, Item("1", "node values that stand for each term", ("node", "term"))]
    # and the modes of a calibrated engine; none where the method does not tell
    constants: Annotated[tuple[str, ...], Item("1", "uncertain constant of the engine", name="constant")]
    # the other constants being known
    sensitivity: Annotated[Array, Item("kg/s", PER_CONSTANT, ("constant", *BOTH), "delta_W_c", gaps=True)]


@dataclass(frozen=True)
class MapEstimate(NodeMap):
    """The map as it was estimated from logs."""

    runs: tuple[LogRun, ...]
    engine: EngineFound | None = None  # what the logs say of the engine; None where the method does not tell
    along_flow: AlongFlow | None = None  # of the sensor's error; None where the engine is not estimated


def estimate_default(
    air_path: AirPath, grid: Grid, gain: StateGain, logs: Sequence[Recording], settings: EstimateSettings
) -> MapEstimate:
    """Return the map from one or more logs by the default method."""
    point = Point(air_path, settings.of_engine(air_path.usual_tolerance))
    for _ in range(PASSES):
        parts = [inform(point.air_path, grid, gain, log, point.settings, point.unknowns) for log in logs]
        found = of_parts(grid, parts, point)
        moved = point.moved(found.engine)
        if moved is point:
            break
        point = moved
    return found


def of_parts(grid: Grid, parts: Sequence[LogInformation], point: Point) -> MapEstimate:
    """Return the map from the parts of logs, added in the order of the logs' digests."""
    in_order = sorted(parts, key=lambda part: part.run.sha256)
    return replace(merged(grid, in_order, point)[0], runs=tuple(part.run for part in parts))


def merged(grid: Grid, parts: Iterable[LogInformation], point: Point) -> tuple[MapEstimate, Solution]:
    """Return the map from the parts of logs, and the solution behind it."""
    # The parts are looked at once, one after the other; the bits of a sum depend on their order, so give them in the order
    # of the logs' digests.
    return of_sums(grid, *added_up(grid, point.columns(grid), parts), point)


def of_sums(grid: Grid, total: Moments, runs: Sequence[LogRun], point: Point) -> tuple[MapEstimate, Solution]:
    """Return the map from the sums of logs, and the solution behind it."""
    unknowns, settings, layout = point.unknowns, point.settings, point.columns(grid)
    prior = prior_of(grid, settings.prior_map, unknowns)
    solution, engine = solve(layout, total, prior), layout.engine
    if settings.constants == "consider":
        solution = considered(solution, total, prior)
    theta, covariance, noise = _since_known(grid, solution, unknowns)
    nodes, of_engine = slice(layout.nodes), solution.covariance[engine, engine]
    coupled = covariance[nodes, engine] @ unknowns.reduction
    amplitudes, step = solution.scales.amplitudes, solution.stiff[engine]
    estimate = replace(
        finished("observer", grid, theta, covariance[nodes, nodes], runs, of_cells(grid, total.gram), settings),
        noise=noise,
        design=solution.design,
        constants=unknowns.coordinates,
        sensitivity=np.asarray(np.linalg.solve(unknowns.reduced(of_engine), coupled.T)).reshape(-1, *grid.shape),
        # Far from where it is linearised, a compressor of other constants looks like one that needs large corrections, and
        # stays there. So the constants take each step, and only the last solution has corrections as large as they may be.
        engine=EngineFound(unknowns, point.deviation, solution.mean[engine], of_engine, amplitudes, step),
        along_flow=solution.along_flow,
    )
    return estimate, solution


def _since_known(grid: Grid, solution: Solution, unknowns: Unknowns) -> tuple[Array, Array, Array]:
    """Return theta (p,), the covariance of all columns and the map's noise, as the change since the air flow was known."""
    left, own, p = unknowns.at_nodes, solution.layout.engine, solution.layout.nodes
    if left is None:
        return solution.theta, solution.covariance, solution.noise
    if not (np.array_equal(left.fuel, grid.fuel) and np.array_equal(left.speed, grid.speed)):
        raise DataError(
            "the engine was calibrated on logs with other map nodes than this configuration has; run `lpvobs calibrate` again "
            "with this configuration"
        )
    onto = np.eye(solution.layout.solved)
    onto[:p, own] = -left.response
    covariance = onto @ solution.covariance @ onto.T
    covariance[:p, :p] += left.covariance
    theta = solution.theta - left.mean - left.response @ (solution.mean[own] - unknowns.mean)
    return theta, covariance, solution.noise + left.covariance


def calmed(air_path: AirPath, log: Log, half_width: float) -> tuple[Log, dict[str, Array]]:
    """Return the log with smoothed states and temperatures, and the time derivative of each of those."""
    columns = np.stack([log[name] for name in air_path.smoothed])
    values, slopes = smooth(log.time, columns, log.segments, half_width)
    channels = {**log.channels, **dict(zip(air_path.smoothed, values, strict=True))}
    return replace(log, channels=channels), dict(zip(air_path.smoothed, slopes, strict=True))


def finished(
    method: str,
    grid: Grid,
    theta: Array,
    covariance: Array,
    runs: Sequence[LogRun],
    excited: Excitation,
    settings: EstimateSettings,
) -> MapEstimate:
    """Return the estimate with the nodes marked that the drives inform."""
    error = np.sqrt(np.diag(covariance)).reshape(grid.shape)
    # no error is beyond where a method states none
    supported = (excited.nodes() >= settings.least_information).reshape(grid.shape) & ~(error > settings.widest)
    return MapEstimate(
        method=method,
        grid=grid,
        theta=np.where(supported, theta.reshape(grid.shape), np.nan),
        standard_error=np.where(supported, error, np.nan),
        covariance=covariance,
        noise=covariance,
        design=terms_at_nodes(grid),
        supported=supported,
        excitation=excited.cells(),
        runs=tuple(runs),
        constants=(),
        sensitivity=np.empty((0, *grid.shape)),
    )
