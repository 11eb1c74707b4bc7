"""Where tasks run: in this process, in several on this machine, or on the workers of a Dask scheduler.

Results come back as they finish, each with the number of its task; what is made of them must not depend on that order. Only a few
tasks per worker are under way at a time, so memory does not grow with their number.
"""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, TypeVar

from lpvobs.errors import DataError, UsageError

Task = TypeVar("Task")
Result = TypeVar("Result")
Numbered = Iterator[tuple[int, Result]]

AHEAD = 2
"""Tasks handed out per worker, so that none waits for the next."""
RETRIES = 10
"""How often a task is given to another worker when the one that had it dies."""
PATIENCE = 300.0
"""[s] that a scheduler which goes away has to come back: a node of a cluster starts in two or three minutes."""


class Workers:
    """Run tasks side by side, for as long as it is open; processes start with the first tasks and stay for later ones.

    `jobs` are processes on this machine, of which 1 runs the tasks here; `scheduler` is the address of a Dask scheduler, such
    as `tcp://host:8786`, instead.
    """

    def __init__(self, jobs: int = 1, scheduler: str | None = None):
        self.jobs, self.scheduler = jobs, scheduler
        self._pool: ProcessPoolExecutor | None = None

    @property
    def alone(self) -> bool:
        """Whether this process does everything."""
        return self.jobs == 1 and self.scheduler is None

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._pool is None:
            return
        if kind is not None:  # what they are at is of no use any more
            for process in multiprocessing.active_children():
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def finished(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Numbered[Result]:
        """Yield the number and the result of each task as it finishes.

        The function is one of a module, so that other processes can import it. Raises UsageError if Dask is not installed or
        its scheduler cannot be reached; DataError if a worker dies with its task.
        """
        if self.scheduler is not None:
            return _on_cluster(function, tasks, self.scheduler)
        if self.jobs == 1 or len(tasks) < 2:
            return enumerate(map(function, tasks))
        if self._pool is None:
            # The working folder, where strangers' logs lie, is no place of modules, such as a file multiprocessing.py.
            os.environ["PYTHONSAFEPATH"] = "1"
            # Processes that start afresh: a copy of this one could inherit a lock that a thread of a library holds.
            afresh = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.jobs, afresh, _belong_to_the_parent)
        return _in_processes(function, tasks, self._pool, AHEAD * self.jobs)


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _in_processes(
    function: Callable[[Task], Result], tasks: Sequence[Task], pool: ProcessPoolExecutor, ahead: int
) -> Numbered[Result]:
    try:
        yield from _side_by_side(partial(_submitted, pool, function), enumerate(tasks), lambda: ahead)
    except BrokenProcessPool:
        raise DataError(
            "a worker process died, perhaps for lack of memory; run again with fewer --jobs; finished logs are kept"
        ) from None


def _side_by_side(
    submitted: Callable[[Task], Future[Result]], tasks: Iterable[tuple[int, Task]], ahead: Callable[[], int]
) -> Numbered[Result]:
    """Yield the number and the result of each task as it finishes, so many of them under way at a time."""
    waiting = iter(tasks)
    under_way: dict[Future[Result], int] = {}
    while True:
        room = ahead()
        while len(under_way) < room and (following := next(waiting, None)) is not None:
            under_way[submitted(following[1])] = following[0]
        if not under_way:
            break
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            yield under_way.pop(future), future.result()


def _submitted(pool: ProcessPoolExecutor, function: Callable[[Task], Result], task: Task) -> Future[Result]:
    # Interrupts are held back for a moment; processes that start in it hold them back, too, and are left to the parent.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(function, task)
    except OSError as error:
        raise DataError(f"a worker process cannot be started ({error.strerror}); run again with --jobs 1") from None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _belong_to_the_parent() -> None:
    """Leave interrupts to the parent, and end with it, even if it is killed and cannot say so."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _on_cluster(function: Callable[[Task], Result], tasks: Sequence[Task], address: str) -> Numbered[Result]:
    """Yield the number and the result of each task; what a scheduler had when it went away is given to the next one."""
    left, patience = dict(enumerate(tasks)), 0.0
    while left:
        client = _client(address, patience)
        with client:
            try:
                for number, result in _through(client, function, left):
                    del left[number]
                    yield number, result
            except CancelledError:  # what becomes of tasks when their scheduler has gone
                pass
            except Exception:  # a client that has given its scheduler up has many ways to say so
                if client.status == "running":  # the scheduler is there: the task has failed
                    raise
        patience = PATIENCE


def _through(client: Any, function: Callable[[Task], Result], left: dict[int, Task]) -> Numbered[Result]:
    from distributed.scheduler import KilledWorker

    submitted = partial(client.get_executor(pure=False, retries=RETRIES).submit, function)
    try:
        yield from _side_by_side(submitted, [*left.items()], lambda: AHEAD * max(sum(client.nthreads().values()), 1))
    except KilledWorker:
        raise DataError(
            "several workers died on the same log, perhaps for lack of memory; give the workers more memory and run again; "
            "finished logs are kept"
        ) from None


def _client(address: str, patience: float) -> Any:
    """Return a client of a scheduler, waited for as long as that [s]."""
    try:
        from distributed import Client
    except ImportError:
        raise UsageError("--scheduler needs Dask; install it with: pip install 'lpvobs[cluster]'") from None
    until = time.monotonic() + patience
    while True:
        try:
            return Client(address, timeout="5s", set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            if time.monotonic() > until:
                raise UsageError(
                    f"--scheduler {address}: the scheduler cannot be reached ({error}); start `dask scheduler`, or check "
                    "the address; finished logs are kept"
                ) from None
            time.sleep(1.0)
