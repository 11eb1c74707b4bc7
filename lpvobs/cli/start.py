"""The console script: signals are caught before the libraries are loaded, which takes longer than a short verb."""

import sys

from lpvobs.cli.signals import Stopped, catch_signals


def run() -> None:
    """Run the command line; a signal ends it with one line also while it is still loading."""
    catch_signals()
    try:
        from lpvobs.cli.main import run as run_verb

        run_verb()
    except Stopped as stop:
        print(f"lpvobs: {stop}", file=sys.stderr)
        sys.exit(stop.exit_code)
