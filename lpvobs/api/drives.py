"""Logs: driven by the simulated engine, made of foreign recordings, looked at."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from lpvobs.api.files import File, Progress, as_path, silent, some, writing

if TYPE_CHECKING:
    from lpvobs.simulation.simulate import SimulatedLog
    from lpvobs.api.inspect import Inspection


def simulate(
    config: File,
    cycle: str,
    out: File,
    *,
    effects: File | None = None,
    rate: float = 100.0,
    seed: int = 1,
    progress: Progress | None = None,
) -> "SimulatedLog":
    """Drive the simulated diesel over a cycle and write the log that its sensors record.

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
    rate : float
        [Hz]
    seed : int
        Of noise and road.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Returns
    -------
    SimulatedLog
        `channels` as written, each of shape (N,) in the unit that `units` names, and the noise-free `truth`.

    Raises
    ------
    UsageError
        For an unknown cycle, an impossible rate, or an effect that cannot show on this drive.
    DataError
        If the log cannot be written.

    Notes
    -----
    The plant is that of Wahlström and Eriksson (the paper's reference 16), Eq. (1) and (2) with six further states.
    """
    from lpvobs.api.simulate import simulate_log

    read = [as_path(config), as_path(cycle), *([as_path(effects)] if effects else [])]
    with writing(as_path(out), read) as target:
        return simulate_log(
            as_path(config), cycle, target, as_path(effects) if effects else None, rate, seed, progress or silent
        )


def draft_profile(source: File) -> str:
    """Return the text of a profile for `ingest`, drafted from names, units and ranges of a recording.

    Parameters
    ----------
    source : path
        CSV, Parquet, MAT or MDF4.

    Returns
    -------
    str
        TOML; what is unsure is a comment in it. Read it before using it.

    Raises
    ------
    DataError
        If the recording cannot be read.
    """
    from lpvobs.ingest.drafting import draft_profile as draft

    return draft(as_path(source))


def ingest(sources: File | Iterable[File], profile: File, out: File) -> dict[str, Any]:
    """Make a log of a foreign recording.

    Parameters
    ----------
    sources : path or several
        CSV, Parquet, MAT or MDF4 files of one drive, on one clock.
    profile : str or path
        `liu-ice`, `kit-obd`, or a TOML file.
    out : path
        The Parquet log to write.

    Returns
    -------
    dict
        What was done to every channel, each repair with its count, as the log keeps it.

    Raises
    ------
    UsageError
        If the profile cannot be used.
    DataError
        If the files cannot.
    """
    from lpvobs.api.ingest import ingest_log

    paths = some(sources, "recording")
    with writing(as_path(out), [*paths, as_path(profile)]) as target:
        return ingest_log(paths, str(profile), target)


def inspect(log: File, config: File | None = None) -> "Inspection":
    """Return what is in a log and what the policies did about its defects.

    Parameters
    ----------
    log : path
    config : path, optional
        Engine and policies; by default the engine that the log suits.

    Returns
    -------
    Inspection
        `as_content()` is plain data: channels with units, ranges in the log's units, defects.

    Raises
    ------
    DataError
        If no estimate could use the log.
    """
    from lpvobs.io.configuration.config import load_config
    from lpvobs.io.logs.reading import LogPolicies
    from lpvobs.api.inspect import inspect_log

    if config is None:
        return inspect_log(as_path(log), None, LogPolicies())
    configuration, _ = load_config(as_path(config))
    return inspect_log(as_path(log), configuration.engine_path().channels, configuration.policies)
