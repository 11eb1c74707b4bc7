"""One verb that keeps an account of its processor's seconds: `python benchmarks/account.py FILE VERB...`; see `where.py`."""

import builtins
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

KINDS = ("loading libraries", "kernels", "writing")


@dataclass
class Account:
    """Seconds of the processor by kind; what happens within another kind counts as itself alone."""

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(KINDS, 0.0))
    open: list[list[Any]] = field(default_factory=list)

    @contextmanager
    def under(self, kind: str) -> Iterator[None]:
        """Book what is done meanwhile; within the same kind nothing is opened, so that it costs next to nothing."""
        if self.open and self.open[-1][0] == kind:
            yield
            return
        self.open.append([kind, 0.0])
        begin = time.process_time()
        try:
            yield
        finally:
            took = time.process_time() - begin
            self.seconds[kind] += took - self.open.pop()[1]
            if self.open:
                self.open[-1][1] += took

    def booked(self, kind: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the function with its calls booked."""

        def call(*args: Any, **kwargs: Any) -> Any:
            with self.under(kind):
                return function(*args, **kwargs)

        return call


def inside(account_file: Path, arguments: list[str]) -> None:
    """Run one verb in this process and write its account."""
    account = Account()
    builtins.__import__ = account.booked("loading libraries", builtins.__import__)
    from lpvobs.cli.main import run  # noqa: PLC0415 booked
    from lpvobs.io.safety import atomic  # noqa: PLC0415

    plain = atomic.replacing

    @contextmanager
    def replacing(target: Path) -> Iterator[Path]:
        with account.under("writing"), plain(target) as temporary:
            yield temporary

    atomic.replacing = replacing  # before the modules that write take it by name
    from numba.core.dispatcher import Dispatcher  # noqa: PLC0415

    Dispatcher.compile = account.booked("kernels", Dispatcher.compile)
    sys.argv = ["lpvobs", *arguments]
    try:
        run()
    finally:
        account_file.write_text(json.dumps(account.seconds | {"all": time.process_time()}), encoding="utf-8")


if __name__ == "__main__":
    inside(Path(sys.argv[1]), sys.argv[2:])
