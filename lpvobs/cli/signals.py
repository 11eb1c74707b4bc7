"""SIGINT and SIGTERM unwind the program like exceptions, once, so that what it has begun is cleared away."""

import signal
import sys
from traceback import walk_stack
from types import FrameType

WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
MOMENT = 0.02  # s


class Stopped(BaseException):
    """A signal arrived. Not an Exception and not KeyboardInterrupt: nobody on the way catches it for another purpose."""

    def __init__(self, number: int):
        super().__init__(f"{WORDS[signal.Signals(number)]}; the unfinished step changed no file")
        self.number, self.exit_code = number, 128 + number


_received: list[Stopped] = []


def catch_signals() -> None:
    """Let the first signal unwind the program, and no second one disturb it in that."""
    sys.unraisablehook = _again
    for number in WORDS:
        signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> None:
    ignore_signals()
    _received[:] = [Stopped(number)]
    # A compiled library that is being loaded prints an exception before it raises its own.
    sys.excepthook = lambda *_: None
    raise _received[0]


def received() -> Stopped | None:
    """Return the signal that has arrived, if one has: code that lost it, as a callback does, may fail for that reason."""
    return _received[0] if _received else None


def _again(lost: "sys.UnraisableHookArgs") -> None:
    """Repeat, in a moment, a signal that fell into a finaliser or a callback, where an exception ends nothing."""
    if lost.exc_type is Stopped:
        signal.signal(signal.SIGALRM, _late)
        signal.setitimer(signal.ITIMER_REAL, MOMENT)
    else:
        sys.__unraisablehook__(lost)


def _late(alarm: int, frame: FrameType | None) -> None:
    """Stop, unless the moment was too short and the exception would be lost once more."""
    if any(above.f_code is _again.__code__ for above, _ in walk_stack(frame)):
        signal.setitimer(signal.ITIMER_REAL, MOMENT)
    else:
        _stop(_received[0].number, frame)


def ignore_signals() -> None:
    """Finish what little is left undisturbed."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in WORDS:
        signal.signal(number, signal.SIG_IGN)
