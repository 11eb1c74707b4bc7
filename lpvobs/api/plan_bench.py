"""`calibrate --plan`: which further bench points would make an engine known best."""

from collections.abc import Sequence

from lpvobs.api.files import File, Progress, as_path, silent
from lpvobs.api.simulate import plant_of
from lpvobs.calibration.bench import bench_table, best_points, rows_of
from lpvobs.engines.channels import AMBIENT
from lpvobs.io.configuration.config import load_config
from lpvobs.io.results.engines import read_engine
from lpvobs.report.engines import PlannedPoint

FEASIBLE, BEST = 120, 8
"""Stationary points that are looked at, and those that are named: a morning on the bench."""


def plan_bench(config: File, engine: File, *, progress: Progress | None = None) -> Sequence[PlannedPoint]:
    """Return the bench points that would make the air flow of a calibrated engine known best, the best first.

    Points are chosen one after the other (greedily) so that the mean variance of the flow over all feasible points becomes least
    (A-optimal). Feasible are stationary points of the simulated engine over its range of speed, load, EGR and air temperature.

    Parameters
    ----------
    config : path
        With `[simulation]`.
    engine : path
        Made by `calibrate` from the same configuration.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Raises
    ------
    UsageError
        If nothing simulates the engine.
    DataError
        If the engine cannot be used, or does not come to rest.
    """
    stored = read_engine(as_path(engine), load_config(as_path(config))[0].engine_path())
    configuration, plant = plant_of(config, engine)
    air_path = configuration.engine_path()
    found = plant.bench(configuration.engine, configuration.simulation, FEASIBLE, 1, progress or silent).channels
    rows = rows_of(air_path, stored.unknowns.seen_from(stored.deviation), [bench_table(air_path, found)])
    chosen, told = best_points(rows, stored.unknowns.covariance, stored.left, BEST)
    set_by = [axis.channel for axis in air_path.axes]
    set_by += [name for part in air_path.measured_parts for name in part.without] + list(AMBIENT)
    return [
        PlannedPoint(
            point={name: float(found[name][point]) for name in set_by},
            units={name: air_path.channels[name].unit for name in set_by},
            before=float(before),
            after=float(after),
        )
        for point, before, after in zip(chosen, told[:-1], told[1:], strict=True)
    ]
