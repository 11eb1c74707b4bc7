"""`refine`: the model of a result with the effects that the logs prove."""

from collections.abc import Iterable

from lpvobs.api.closed_loop import Sources, refine_result
from lpvobs.api.files import File, Progress, as_path, as_paths, silent, some_logs, writing
from lpvobs.api.pooled import Traced
from lpvobs.io.logs.finding import find_logs


def refine(
    result: File,
    logs: File | Iterable[File],
    out: File,
    *,
    hold_out: File | Iterable[File] = (),
    freeze_map: bool | None = None,
    progress: Progress | None = None,
) -> Traced:
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
    paths, unseen = some_logs(logs), find_logs(as_paths(hold_out))
    with writing(out, [result, *paths, *unseen]) as target:
        return refine_result(Sources(as_path(result), paths, unseen, freeze_map), target, progress or silent)
