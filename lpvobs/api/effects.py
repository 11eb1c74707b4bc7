"""What the model of a result lacks: found, and added."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from lpvobs.api.files import File, Progress, as_path, as_paths, changing, silent, some, writing

if TYPE_CHECKING:
    from lpvobs.api.pooled import Traced


def trace(
    result: File, logs: File | Iterable[File], *, freeze_map: bool | None = None, progress: Progress | None = None
) -> "Traced":
    """Find what the model of a result lacks on logs, and write `/trace` into the result.

    Parameters
    ----------
    result : path
    logs : path or several
        Parquet logs, patterns, or folders of logs; pooled.
    freeze_map : bool, optional
        Whether the map stands; by default on logs that did not make it, while on those that did it is estimated jointly.
    progress : callable, optional
        Takes the fraction done, 0 to 1.

    Returns
    -------
    Traced
        `found`: its `verdict` is `none`, `effect` or `unexplained`, its `findings` have sizes and intervals in the units they name,
        onset and end [s]; `map_frozen`; `refused`: why logs were left out.

    Raises
    ------
    UsageError
        If some logs made the map, others did not, and nothing says what holds; if a log is there twice.
    DataError
        If the result cannot be used, or no log can.
    """
    from lpvobs.io.logs.finding import find_logs
    from lpvobs.steps.trace import Sources, trace_result

    paths = find_logs(some(logs, "log"))
    with changing(as_path(result)) as path:
        return trace_result(Sources(path, paths, (), freeze_map), progress or silent)


def refine(
    result: File,
    logs: File | Iterable[File],
    out: File,
    *,
    hold_out: File | Iterable[File] = (),
    freeze_map: bool | None = None,
    progress: Progress | None = None,
) -> "Traced":
    """Add the effects that the logs prove to the model, estimate again, and write the refined result.

    Parameters
    ----------
    result, logs, freeze_map, progress
        As for `trace`.
    out : path
        The refined result to write; without a finding, the model of before.
    hold_out : path or several
        Logs that nothing is fitted to and no decision sees: the error is judged on them, too.

    Returns
    -------
    Traced
        As of `trace`, and with the error after.

    Raises
    ------
    UsageError, DataError
        As for `trace`.
    NotProven
        If an effect adds a state and the larger observer is not proven.
    """
    from lpvobs.io.logs.finding import find_logs
    from lpvobs.steps.trace import Sources, refine_result

    paths, unseen = find_logs(some(logs, "log")), find_logs(as_paths(hold_out))
    with writing(as_path(out), [as_path(result), *paths, *unseen]) as target:
        return refine_result(Sources(as_path(result), paths, unseen, freeze_map), target, progress or silent)
