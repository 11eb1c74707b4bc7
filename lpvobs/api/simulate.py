"""`simulate`: a cycle through the simulated engine into a log, or stationary points into a table."""

from collections.abc import Sequence
from dataclasses import replace

from lpvobs.api.files import File, Progress, as_path, shown, writing
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import Config, Effects, load_config, load_effects
from lpvobs.io.logs import bench, finding, parquet
from lpvobs.io.results.engines import read_engine
from lpvobs.kinds import Count, Output, Seconds
from lpvobs.simulation import simulate as plant
from lpvobs.simulation import stationary
from lpvobs.simulation.parameters import SimulationParameters


class SimulateOutput(Output):
    """A log that was driven, or a table of stationary points, each of which was recorded for 30 s."""

    log: str
    samples: Count
    duration: Seconds
    channels: Sequence[str]


def simulate(
    config: File,
    cycle: str,
    out: File,
    *,
    effects: File | None = None,
    engine: File | None = None,
    rate: float = 100.0,
    seed: int = 1,
    vehicle: str | None = None,
    date: str | None = None,
    progress: Progress | None = None,
) -> plant.SimulatedLog:
    """Drive the simulated diesel over a cycle and write the log that its sensors record.

    Raises UsageError for a configuration without `[simulation]`, an unknown cycle, an impossible rate, or an effect that cannot
    show on this drive; DataError if the log cannot be written.

    Parameters
    ----------
    cycle : str
        `etc` (surrogate), `etc_part1`, `ftp75`, `ftp75_cold`, `nedc`, `whtc`, `wltc`, or the path of a table.
    effects : path, optional
        TOML file of what is wrong with engine and sensors, see `configs/effects`.
    engine : path, optional
        Made by `calibrate` from the same configuration: drives its constants. By default what `[engine] file` names.
    rate : float
        Samples per second [Hz].
    seed : int
        What noise and road are drawn with.
    vehicle, date : str, optional
        Whose log it is and when it was driven, such as 2025-01-31, kept in the log for `track`.

    Notes
    -----
    The plant is that of Wahlström and Eriksson (the paper's reference 16), Eq. (1) and (2) with six further states.
    """
    with writing(out, [config, cycle, effects, engine]) as target:
        configuration, parameters = plant_of(config, engine)
        origin = finding.own_origin(vehicle, date, configuration.air_path)
        wanted = Effects() if effects is None else load_effects(as_path(effects))
        log = plant.simulate(
            configuration.engine, parameters, cycle, rate, seed, wanted.surface, shown(progress),
            effects=wanted.injected, auxiliary=wanted.auxiliary, sensors=configuration.sensors,
        )  # fmt: skip
        parquet.write_log(target, log.channels, log.units, origin)
    return log


def plant_of(config: File, engine: File | None = None) -> tuple[Config, SimulationParameters]:
    """Return a configuration with the constants of a calibrated engine, and its plant; raises UsageError where it has none."""
    configuration, _ = load_config(as_path(config))
    if not configuration.kind.plant:
        able = ", ".join(f"configs/{kind.example}" for kind in ENGINES.values() if kind.plant)
        raise UsageError(
            f"{config}: there is no simulator for air_path = '{configuration.air_path}'; engines with a simulator are in {able}"
        )
    parameters = configuration.simulation
    if parameters is None:
        raise UsageError(
            f"{config}: the [simulation] tables for simulate are missing; copy them from configs/{configuration.kind.example}"
        )
    engine = engine or configuration.engine_file(as_path(config))
    if engine is not None:
        air_path = configuration.engine_path()
        there = air_path.deviating(read_engine(as_path(engine), air_path).deviation)
        configuration = replace(configuration, engine=there.engine)
    return configuration, parameters


def simulate_bench(
    config: File, points: int, out: File, *, seed: int = 1, engine: File | None = None, progress: Progress | None = None
) -> stationary.BenchTable:
    """Bring the simulated engine to rest at many operating points and write the table that a test bench records.

    Raises UsageError for a configuration without `[simulation]`, or an impossible number of points; DataError if the engine
    does not come to rest, or the table cannot be written.

    Parameters
    ----------
    points : int
        1 to 1000. A third has the EGR valve shut, some have cold combustion air.
    out : path
        The table to write: Parquet with units, or CSV with the units in a second line where the name ends in `.csv`.
    seed : int
        Of noise and of where the points lie.

    Returns
    -------
    BenchTable
        `channels` as written, each of shape (N,), in the unit that `units` names: the engine's channels but the air flow sensor,
        averaged over 30 s, and `W_reference`, `sd_W_reference`, `W_egr_reference`, `W_f` [kg/s].
    """
    with writing(out, [config, engine]) as target:
        configuration, parameters = plant_of(config, engine)
        table = stationary.bench(configuration.engine, parameters, points, seed, shown(progress))
        bench.write_table(target, table.channels, table.units)
    return table
