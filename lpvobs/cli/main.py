"""The `lpvobs` command: its verbs, joined here."""

import gc
import os
import re
import sys
from importlib import import_module
from typing import Annotated

import typer

from lpvobs import __version__
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
VERBS = {
    "recordings.simulate": "Simulate the nonlinear engine model over a drive cycle and write a log.",
    "recordings.ingest": "Convert a recording of another tool (CSV, Parquet, MAT, MDF4) into a log.",
    "recordings.profile": "Draft the profile that ingest needs from the channels of a recording.",
    "recordings.inspect": "Show the channels, units, value ranges and defects of logs.",
    "maps.calibrate": "Find an engine's constants and component corrections from bench points and logs with a healthy MAF sensor.",
    "proofs.synth_gain": "Compute the observer gain and prove that the observer is stable with it.",
    "proofs.verify": "Prove the stability of a stored observer gain again, without the solver.",
    "maps.estimate": "Estimate the error map of the mass air flow sensor from logs.",
    "maps.extrapolate": "Fill the map nodes that no log visited.",
    "loop.trace": "Find effects that the engine model lacks, from its residual.",
    "loop.refine": "Add the effects that the logs prove to the engine model, estimate again, and show the error before and after.",
    "export": "Write the map for calibration tools (DCM, CSV, netCDF), or the observer for a control unit (C99, FMU).",
    "results.compare": "Show how two maps differ, and where the difference exceeds their errors.",
    "results.track": "Follow the maps of many vehicles over time.",
    "results.report": "Show a result as tables or an HTML page, and check limits on its metrics (gates).",
    "proofs.selftest": "Test the installed package on cases with known answers.",
}
"""Short help by verb, behind its module where that has another name."""
for place, told in VERBS.items():
    shared, _, name = place.rpartition(".")
    verb = guarded(getattr(import_module(f"lpvobs.cli.{shared or name}"), name))
    app.command(name.replace("_", "-"), short_help=told)(verb)


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
