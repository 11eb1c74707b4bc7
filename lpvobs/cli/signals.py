"""SIGINT and SIGTERM unwind the program like exceptions, once, so that what it has begun is cleared away."""

import signal
import sys
from functools import partial
from types import FrameType
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from sys import UnraisableHookArgs


class Stopped(BaseException):
    """A signal arrived. Not an Exception and not KeyboardInterrupt: nobody on the way catches it for another purpose."""

    exit_code: ClassVar[int]
    word: ClassVar[str]

    def __str__(self) -> str:
        return f"{self.word}; the unfinished step changed no file"


class Interrupted(Stopped):
    """SIGINT arrived."""

    exit_code, word = 130, "interrupted"


class Terminated(Stopped):
    """SIGTERM arrived."""

    exit_code, word = 143, "terminated"


MOMENT = 0.02  # s

_KINDS: dict[int, type[Stopped]] = {signal.SIGINT: Interrupted, signal.SIGTERM: Terminated}
_received: list[Stopped] = []


def catch_signals() -> None:
    """Let the first signal unwind the program, and no second one disturb it in that."""
    sys.unraisablehook = _again
    for number in _KINDS:
        signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> None:
    ignore_signals()
    _received[:] = [_KINDS[number]()]
    raise _received[0]


def received() -> Stopped | None:
    """Return the signal that has arrived, if one has: code that lost it, as a callback does, may fail for that reason."""
    return _received[0] if _received else None


def _again(lost: "UnraisableHookArgs") -> None:
    """Repeat, in a moment, a signal that fell into a finaliser or a callback, where an exception ends nothing."""
    for number, kind in _KINDS.items():
        if lost.exc_type is kind:
            signal.signal(signal.SIGALRM, partial(_late, number))
            signal.setitimer(signal.ITIMER_REAL, MOMENT)
            return
    sys.__unraisablehook__(lost)


def _late(number: int, alarm: int, frame: FrameType | None) -> None:
    """Stop, unless the moment was too short and the exception would be lost once more."""
    above = frame
    while above is not None:
        if above.f_code is _again.__code__:
            signal.setitimer(signal.ITIMER_REAL, MOMENT)
            return
        above = above.f_back
    _stop(number, frame)


def ignore_signals() -> None:
    """Finish what little is left undisturbed."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in _KINDS:
        signal.signal(number, signal.SIG_IGN)
