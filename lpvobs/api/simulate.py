"""`simulate`: a cycle through the simulated engine into a log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lpvobs.api.files import File, Progress, as_path, silent, writing
from lpvobs.engines.registry import ENGINES
from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import Config, Effects, load_config, load_effects
from lpvobs.io.logs.origins import own_origin
from lpvobs.io.logs.parquet import write_log
from lpvobs.io.results.engines import read_engine
from lpvobs.kinds import Count, Seconds
from lpvobs.simulation.plants import PLANTS, Simulator
from lpvobs.simulation.simulate import SimulatedLog


@dataclass(frozen=True, kw_only=True)
class SimulateOutput:
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
) -> SimulatedLog:
    """Drive the simulated diesel over a cycle and write the log that its sensors record.

    Raises UsageError for a configuration without `[simulation]`, an unknown cycle, an impossible rate, or an effect that cannot
    show on this drive; DataError if the log cannot be written.

    Parameters
    ----------
    config : path
        TOML file with engine and `[simulation]`.
    cycle : str
        `etc` (surrogate), `etc_part1`, `ftp75`, `ftp75_cold`, `nedc`, `whtc`, `wltc`, or the path of a table.
    out : path
        The Parquet log to write.
    effects : path, optional
        TOML file of what is wrong with engine and sensors, see `configs/effects`.
    engine : path, optional
        Made by `calibrate` from the same configuration: drives its constants. By default what `[engine] file` names.
    rate : float
        [Hz]
    seed : int
        Of noise and road.
    vehicle, date : str, optional
        Whose log it is and when it was driven, such as 2025-01-31, kept in the log for `track`.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Returns
    -------
    SimulatedLog
        `channels` as written, each of shape (N,) in the unit that `units` names, and the noise-free `truth`.

    Notes
    -----
    The plant is that of Wahlström and Eriksson (the paper's reference 16), Eq. (1) and (2) with six further states.
    """
    with writing(out, [config, cycle, effects, engine]) as target:
        configuration, plant = plant_of(config, engine)
        origin = own_origin(vehicle, date, configuration.air_path)
        wanted = Effects() if effects is None else load_effects(as_path(effects))[0]
        log = plant.run(
            configuration.engine,
            configuration.simulation,
            cycle,
            rate,
            seed,
            wanted.surface,
            progress or silent,
            effects=wanted.injected,
            auxiliary=wanted.auxiliary,
            sensors=configuration.sensors,
        )
        write_log(target, log.channels, log.units, origin)
    return log


def plant_of(config: File, engine: File | None = None) -> tuple[Config, Simulator]:
    """Return a configuration with the constants of a calibrated engine, and its plant; raises UsageError where it has none."""
    configuration, _ = load_config(as_path(config))
    plant = configuration.kind.plant
    if not plant:
        able = ", ".join(f"configs/{kind.example}" for kind in ENGINES.values() if kind.plant)
        raise UsageError(f"{config}: air_path = '{configuration.air_path}': no plant simulates it; see {able}")
    if configuration.simulation is None:
        raise UsageError(
            f"{config}: has no [simulation] tables; simulate needs them, see configs/{configuration.kind.example}"
        )
    calibrated = configuration.engine_file(as_path(config)) if engine is None else as_path(engine)
    if calibrated is not None:
        air_path = configuration.engine_path()
        there = air_path.deviating(read_engine(calibrated, air_path).deviation)
        configuration = replace(configuration, engine=there.engine)
    return configuration, PLANTS[plant]
