"""`calibrate`: from a bench table and logs of known air flow to what is known of an engine, and which points would tell most."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lpvobs.api.estimate import gain_for
from lpvobs.api.files import File, Files, Progress, as_path, as_paths, refuse_copies, shown, within, writing
from lpvobs.api.known_engine import learned_engine
from lpvobs.calibration.bench import REFERENCE, bench_table, rows_of
from lpvobs.calibration.fit import USUALLY_LEFT, Calibration, calibrated, taught
from lpvobs.calibration.plan import best_points
from lpvobs.engines.base import AirPath
from lpvobs.engines.channels import AMBIENT
from lpvobs.engines.unknowns import TABLE_FLOW, Unknowns, unknowns_of
from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import Config, load_config
from lpvobs.io.logs.bench import named_file, read_bench, read_component_map
from lpvobs.io.logs.finding import find_logs
from lpvobs.io.logs.reading import read_log
from lpvobs.io.results.engines import ComponentPoint, EngineRow, Learning, StoredEngine, read_engine, write_engine
from lpvobs.io.results.provenance import Provenance
from lpvobs.io.safety.atomic import file_digest
from lpvobs.observer.estimate import Point
from lpvobs.records import Log
from lpvobs.report.engines import PlannedPoint

USUAL_TOLERANCE = 0.01
"""Of a constant that only a component's table tells of, and of which the configuration says nothing: as of the others."""
LEAST_SHARE = 0.3  # of a row's flow that passes a component, for the row to be a point on its correction
FROM_BENCH = 0.3  # share of the progress for the bench where there are logs as well


def calibrate(
    config: File,
    *,
    bench: Files = (),
    healthy: Files = (),
    reference: Files = (),
    maps: Iterable[str] = (),
    out: File,
    gain: File | None = None,
    prior: bool = False,
    progress: Progress | None = None,
) -> StoredEngine:
    """Find an engine's constants and the corrections of its components, with their covariance, and write them.

    Raises UsageError for a configuration that cannot be read, nothing to calibrate from, or two inputs of the same name or
    bytes; DataError if a table, a log or the gain cannot be used; NotProven if the certificate of the gain does not hold.

    Parameters
    ----------
    config : path
        What it says of the engine is the prior.
    bench : path or several
        Tables of stationary points with `W_reference` [kg/s]: Parquet with units, or CSV with the units in a second line.
    healthy, reference : path or several
        Logs whose sensor was in order on that day; logs with the channel `W_reference`, a meter in the sensor's place.
    maps : several str
        `KIND=FILE`, a table of one component: CSV with the units in a second line, Parquet with units, or `FILE.dcm:LABEL`; kinds
        are those of the engine, for the diesel `compressor`, `turbine`, `eta_vol`, `egr`.
    gain : path, optional
        For logs; without it one is made and proven first.
    prior : bool
        Write the engine as configured where there is nothing to calibrate from.
    """
    configuration, text = load_config(as_path(config))
    air_path = configuration.engine_path()
    tables, known, metered = as_paths(bench), find_logs(as_paths(healthy)), find_logs(as_paths(reference))
    parts = [named_file(item, air_path) for item in maps]
    if not (tables or known or metered or parts or prior):
        raise UsageError("no data to calibrate from; give --bench, --healthy, --reference or --map KIND=FILE")
    inputs = [*tables, *known, *metered, *dict.fromkeys(path for _, path, _ in parts)]
    refuse_copies(inputs)
    for number, path in enumerate(inputs):
        if path.name in [other.name for other in inputs[:number]]:
            raise UsageError(
                f"{path}: another input file has the same name, but the engine file tells inputs apart by name; rename one of "
                "the two files"
            )
    with writing(out, [config, *inputs, gain]) as target:
        if air_path.learns:
            if tables or metered or parts or not known:
                raise UsageError(
                    f"{as_path(config)}: this kind of engine is calibrated from logs with a healthy MAF sensor only; "
                    "give --healthy LOG and no other data"
                )
            logs = [read_log(path, air_path.channels, configuration.reading) for path in known]
            digests = {path.name: log.sha256 for path, log in zip(known, logs, strict=True)}
            shown_by = learned_engine(configuration, logs)
            stored = _engine(shown_by.air_path, unknowns_of({}, ()), Provenance(digests, text), shown_by.learning())
        elif not air_path.components:
            raise UsageError(
                f"{as_path(config)}: this kind of engine ({air_path.name}) has no components to calibrate; see docs/own-engine.md"
            )
        else:
            stored = _calibrated(configuration, text, (tables, known, metered), parts, gain, shown(progress))
        write_engine(target, stored)
    return stored


def _calibrated(
    config: Config,
    text: str,
    paths: tuple[Sequence[Path], Sequence[Path], Sequence[Path]],
    parts: Sequence[tuple[str, Path, str]],
    gain: File | None,
    progress: Progress,
) -> StoredEngine:
    """Return the engine from tables of bench and components first, then from the logs with that as the prior."""
    tables, known, metered = paths
    air_path = config.engine_path()
    settings = config.estimate.of_engine(air_path.usual_tolerance)
    own = [name for kind, _, _ in parts for name in air_path.component_maps[kind].constants]
    told = {name: config.estimate.tolerance.get(name, USUAL_TOLERANCE) for name in own}
    digests: dict[str, str] = {}
    stored = _engine(air_path, unknowns_of({**settings.tolerance, **told}, air_path.components), Provenance({}, text))
    if tables or parts:
        measured = [bench_table(air_path, read_bench(tables, air_path))] if tables else []
        measured += [read_component_map(*part, air_path) for part in parts]
        digests = {path.name: file_digest(path) for path in [*tables, *(path for _, path, _ in parts)]}
        by_tables = calibrated(air_path, stored.unknowns, measured)
        stored = replace(
            stored,
            unknowns=by_tables.unknowns,
            prior_error=np.sqrt(np.diag(by_tables.prior.scaled(list(by_tables.amplitudes.values())))),
            amplitudes=by_tables.amplitudes,
            left=by_tables.left,
            rows=_rows(by_tables),
            points=tuple(_points(by_tables)),
        )
    if known or metered:
        progress(FROM_BENCH)
        logs = [read_log(path, air_path.channels, config.reading) for path in known]
        logs += [_metered(config, path) for path in metered]
        state = gain_for(config, [*known, *metered], gain, "observer", air_path).state
        point = Point(air_path, settings, stored.deviation, stored.unknowns)
        share = max((stored.left[name] for name in air_path.balance_names if name in stored.left), default=USUALLY_LEFT)
        found = taught(point, config.grid(), state, logs, within(progress, FROM_BENCH, 1.0), share)
        digests |= {path.name: log.sha256 for path, log in zip([*known, *metered], logs, strict=True)}
        stored = replace(
            stored,
            unknowns=found.unknowns,
            prior_error=stored.prior_error if tables or parts else found.prior_error,
            amplitudes={**stored.amplitudes, **found.amplitudes},
        )
    progress(1.0)
    return replace(stored, provenance=Provenance(digests, text))


def _engine(
    air_path: AirPath, unknowns: Unknowns, provenance: Provenance, learned: Learning | None = None
) -> StoredEngine:
    """Return an engine of which no more is known."""
    return StoredEngine(
        air_path=air_path.name,
        constants={name: float(value) for name, value in air_path.engine_constants().items()},
        unknowns=unknowns,
        prior_error=np.sqrt(np.diag(unknowns.covariance)),
        amplitudes={},
        left={},
        rows=(),
        provenance=provenance,
        learned=learned,
    )


def _metered(config: Config, path: Path) -> Log:
    """Return a log with a reference meter in the place of the sensor."""
    channels = dict(config.engine_path().channels)
    sensor = config.engine_path().sensor
    channels[REFERENCE] = channels.pop(sensor)
    log = read_log(path, channels, config.reading)
    return replace(log, channels={**log.channels, sensor: log[REFERENCE]})


def _points(found: Calibration) -> Iterator[ComponentPoint]:
    """Yield what each row says of the corrections that move it."""
    # The weights of the nodes in a row add up to one and give its inputs, too: hat functions make a straight line straight.
    rows, unknowns = found.rows, found.unknowns
    for component, own in zip(unknowns.components, unknowns.places().values(), strict=True):
        if not component.axes:
            continue
        flow = rows.J[:, own].sum(axis=1)
        on = np.abs(flow) > LEAST_SHARE * np.abs(rows.reference)
        weights = rows.J[on][:, own] / flow[on, None]
        value = weights @ unknowns.mean[own] + found.residual[on] / flow[on]
        grids = np.meshgrid(*(axis.values for axis in component.axes.values()), indexing="ij")
        inputs = [weights @ grid.ravel() for grid in grids[:2]] + [np.zeros(value.size)]
        names = [rows.kind[number].name for number in rows.of[on].tolist()]
        for row in zip(names, inputs[0].tolist(), inputs[1].tolist(), value.tolist(), strict=True):
            yield ComponentPoint(component.name, *row)


def _rows(found: Calibration) -> tuple[EngineRow, ...]:
    rows = found.rows
    names = [rows.kind[number].name for number in rows.of.tolist()]
    of_map = np.array([kind.column == TABLE_FLOW for kind in rows.kind])[rows.of]
    columns = (np.where(of_map, -1, rows.point), rows.reference, found.before, found.held_out, found.held_out_error)
    return tuple(EngineRow(*row) for row in zip(names, *(column.tolist() for column in columns), strict=True))


FEASIBLE, BEST = 120, 8  # stationary points that are looked at, and those that are named: a morning on the bench


def plan_bench(config: File, engine: File, *, progress: Progress | None = None) -> Sequence[PlannedPoint]:
    """Return the bench points that would make the air flow of an engine known best that `calibrate` made, the best first.

    They are chosen greedily so that the mean variance of the flow over all feasible points becomes least (A-optimal). Feasible are
    stationary points of the simulated engine over its range of speed, load, EGR and air temperature.

    Raises UsageError if nothing simulates the engine; DataError if the engine cannot be used, or does not come to rest.
    """
    from lpvobs.api.simulate import plant_of  # the simulator is loaded where it runs: a calibration needs none
    from lpvobs.simulation import stationary

    stored = read_engine(as_path(engine), load_config(as_path(config))[0].engine_path())
    configuration, parameters = plant_of(config, engine)
    air_path = configuration.engine_path()
    found = stationary.bench(configuration.engine, parameters, FEASIBLE, 1, shown(progress)).channels
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
