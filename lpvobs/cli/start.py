"""The console script: signals are caught before the libraries are loaded, which takes longer than a short verb."""

import gc
import sys

from lpvobs.cli.signals import catch_signals, received

UNTIL_GARBAGE = 30_000
"""New objects until garbage is looked for, instead of 700: loading libraries makes hundreds of thousands, all of which stay. A
fifth of a short verb's time went into that search."""


def run() -> None:
    """Run the command line; a signal ends it with one line also before and after the verb, which says so itself."""
    catch_signals()
    gc.set_threshold(UNTIL_GARBAGE)
    try:
        from lpvobs.cli.main import run as run_verb

        run_verb()
    except SystemExit:
        raise
    except BaseException:
        stop = received()  # whatever has come of it on the way
        if stop is None:
            raise
        print(f"lpvobs: {stop}", file=sys.stderr)
        sys.exit(stop.exit_code)
