"""`simulate`: a cycle through the simulated engine into a log."""

from collections.abc import Callable
from pathlib import Path

from lpvobs.engines.registry import ENGINES
from lpvobs.errors import UsageError
from lpvobs.io.configuration.config import Effects, load_config, load_effects
from lpvobs.io.logs.reading import write_log
from lpvobs.simulation.plants import PLANTS
from lpvobs.simulation.simulate import SimulatedLog


def simulate_log(
    config: Path, cycle: str, out: Path, effects: Path | None, rate: float, seed: int, progress: Callable[[float], None]
) -> SimulatedLog:
    """Drive the configured engine over a cycle, write the log and return it with its truth.

    Parameters
    ----------
    config : Path
        With `[simulation]` tables.
    cycle : str
        A name, or the path of a table.
    out : Path
    effects : Path or None
        What is wrong with engine or sensors, and the road.
    rate : float
        [Hz]
    seed : int
    progress : callable
        Takes the fraction done.

    Raises
    ------
    UsageError
        For a configuration without a simulation, and as `lpvobs.simulation.simulate.simulate`.
    """
    configuration, _ = load_config(config)
    plant = configuration.kind.plant
    if not plant:
        able = ", ".join(f"configs/{kind.example}" for kind in ENGINES.values() if kind.plant)
        raise UsageError(f"{config}: air_path = '{configuration.air_path}': no plant simulates it; see {able}")
    if configuration.simulation is None:
        raise UsageError(
            f"{config}: has no [simulation] tables; simulate needs them, see configs/{configuration.kind.example}"
        )
    wanted = load_effects(effects)[0] if effects else Effects()
    log = PLANTS[plant].run(
        configuration.engine,
        configuration.simulation,
        cycle,
        rate,
        seed,
        wanted.surface,
        progress,
        effects=wanted.injected,
        auxiliary=wanted.auxiliary,
    )
    write_log(out, log.channels, log.units)
    return log
