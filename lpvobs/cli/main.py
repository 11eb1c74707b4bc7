"""The `lpvobs` command: its verbs, joined here."""

import gc
import os
import re
import sys
from typing import Annotated

import typer

from lpvobs import __version__
from lpvobs.cli import loop, maps, proofs, recordings, results
from lpvobs.cli.common import guarded, visible
from lpvobs.cli.signals import ignore_signals
from lpvobs.cli.streams import Outlet, take_streams
from lpvobs.errors import DataError, UsageError

app = typer.Typer(
    name="lpvobs",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Estimate the error of a mass air flow sensor as a map over fuel quantity and engine speed, from recorded drive cycles.",
    epilog="Usual order of the verbs: simulate, synth-gain, estimate, extrapolate, report. The --help of each verb has an example.",
)
VERBS = (
    recordings.simulate, recordings.ingest, recordings.profile, recordings.inspect, maps.calibrate, proofs.synth_gain,
    proofs.verify, maps.estimate, maps.extrapolate, loop.trace, loop.refine, maps.export, results.compare, results.track,
    results.report, proofs.selftest,
)  # fmt: skip
for verb in VERBS:
    told = str(verb.__doc__).splitlines()[0].partition(". ")[0].rstrip(".") + "."  # its first sentence
    app.command(verb.__name__.replace("_", "-"), short_help=told)(guarded(verb))


def _version(wanted: bool) -> None:
    if wanted:
        print(__version__)
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version of lpvobs and exit.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Take the options that belong to no verb."""


def run() -> None:
    """Run the command line."""
    for library in ("OPENBLAS", "OMP", "MKL"):
        # Whatever the environment says: threads sum in another order, so their number would show in the bytes of the results.
        # The matrices are small, and threads would cost more than they gain.
        os.environ[f"{library}_NUM_THREADS"] = "1"
    out = take_streams()
    try:
        sys.exit(app(prog_name="lpvobs", standalone_mode=False))
    except SystemExit as end:
        sys.exit(end.code or _flushed(out))
    except Exception as error:
        sys.exit(_misused(error))
    finally:
        ignore_signals()
        sys.stdout.flush()
        gc.freeze()  # all goes now: to look for what nobody refers to would take a fifth of a short verb's time


def _misused(error: Exception) -> int:
    """Print why a command line cannot be understood, in one line, and return the exit code; raise again what is nothing of that."""
    says = getattr(error, "format_message", None)
    if says is None:
        raise error
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "lpvobs"
    if not context or context.get_help() != says():  # without any argument the message is the help
        words = re.sub(r"not a valid int\w*( range)?", "not a whole number", " ".join(visible(says()).split()))
        print(f"lpvobs: {words.rstrip('.')}; see `{command} --help`", file=sys.stderr)
    else:
        print(says(), file=sys.stderr)
    return UsageError.exit_code


def _flushed(out: Outlet) -> int:
    """Return the exit code of a verb that has done its work: not 0 where nobody could read what it said."""
    sys.stdout.flush()
    if out.lost is None:
        return 0
    print(
        f"lpvobs: stdout: {out.lost.strerror}; printed text is missing, but all files are complete; free disk space",
        file=sys.stderr,
    )
    return DataError.exit_code
