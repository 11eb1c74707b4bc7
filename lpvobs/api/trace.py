"""`trace`: what the model of a result lacks."""

from dataclasses import dataclass

from lpvobs.api.closed_loop import Traced, close
from lpvobs.api.files import File, Files, Progress, as_path, shown, some_logs, updating
from lpvobs.discovery.outcome import Outcome
from lpvobs.io.results.results import update
from lpvobs.kinds import Refused


@dataclass(frozen=True, kw_only=True)
class TraceOutput(Outcome):
    """What the model lacks."""

    map_frozen: bool
    refused: Refused


def trace(
    result: File,
    logs: Files,
    *,
    freeze_map: bool | None = None,
    engine: File | None = None,
    progress: Progress | None = None,
) -> Traced:
    """Find what the model of a result lacks on logs, and write `/trace` into the result.

    Raises UsageError if some logs made the map, others did not, and nothing says what holds; if a log is there twice; DataError
    if the result cannot be used, or no log can.

    Parameters
    ----------
    result : path
    logs : path or several
        Parquet logs, patterns, or folders of logs; pooled.
    freeze_map : bool, optional
        Whether the map stands; by default on logs that did not make it, while on those that did it is estimated jointly.
    engine : path, optional
        Made by `calibrate`; by default the engine that the result was made with.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Returns
    -------
    Traced
        `found`: its `verdict` is `none`, `effect` or `unexplained`, its `findings` have sizes and intervals in the units they name,
        onset and end [s]; `map_frozen`; `refused`: why logs were left out.
    """
    paths = some_logs(logs)
    with updating(result) as path:
        calibrated = None if engine is None else as_path(engine)
        closed = close(path, paths, (), freeze_map, shown(progress), calibrated=calibrated)
        update(closed.stored, closed.write_trace)
    return closed.traced
