"""`simulate --bench`: stationary points of the simulated engine into a table."""

from lpvobs.api.files import File, Progress, silent, writing
from lpvobs.api.simulate import plant_of
from lpvobs.io.logs.bench import write_table
from lpvobs.simulation.stationary import BenchTable


def simulate_bench(
    config: File, points: int, out: File, *, seed: int = 1, engine: File | None = None, progress: Progress | None = None
) -> BenchTable:
    """Bring the simulated engine to rest at many operating points and write the table that a test bench records.

    Raises UsageError for a configuration without `[simulation]`, or an impossible number of points; DataError if the engine
    does not come to rest, or the table cannot be written.

    Parameters
    ----------
    config : path
        TOML file with engine and `[simulation]`.
    points : int
        1 to 1000. A third has the EGR valve shut, some have cold combustion air.
    out : path
        The table to write: Parquet with units, or CSV with the units in a second line where the name ends in `.csv`.
    seed : int
        Of noise and of where the points lie.
    engine : path, optional
        As for `simulate`.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Returns
    -------
    BenchTable
        `channels` as written, each of shape (N,), in the unit that `units` names: the engine's channels but the air flow sensor,
        averaged over 30 s, and `W_reference`, `sd_W_reference`, `W_egr_reference`, `W_f` [kg/s].
    """
    with writing(out, [config, engine]) as target:
        configuration, plant = plant_of(config, engine)
        table = plant.bench(configuration.engine, configuration.simulation, points, seed, progress or silent)
        write_table(target, table.channels, table.units)
    return table
