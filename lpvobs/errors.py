"""What can go wrong, each with the exit code of the command line.

A message is one line: what is wrong, where (file, channel, first time stamp), what was expected, what to do.
"""

from typing import ClassVar


class LpvobsError(Exception):
    """A failure that the user can mend; anything else that escapes is a fault of the program (exit code 4)."""

    exit_code: ClassVar[int] = 4


class NotProven(LpvobsError):
    """A gate failed, or a certificate does not hold."""

    exit_code = 1


class UsageError(LpvobsError):
    """The command line or the configuration asks for something that does not exist."""

    exit_code = 2


class DataError(LpvobsError):
    """A log, gain or result cannot be used."""

    exit_code = 3
