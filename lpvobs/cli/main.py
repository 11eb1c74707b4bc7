"""The `lpvobs` command: its verbs, joined here."""

import gc
import os
import sys
from importlib import import_module

import click
from click.shell_completion import get_completion_class

from lpvobs import __version__
from lpvobs.cli.common import visible
from lpvobs.cli.options import command, flag, option
from lpvobs.cli.signals import Stopped, catch_signals, ignore_signals
from lpvobs.cli.streams import Outlet, take_streams
from lpvobs.errors import DataError, UsageError

VERBS = {
    "simulate": "Drive the nonlinear engine over a cycle and record a log.",
    "ingest": "Make a log of a foreign recording.",
    "profile": "Draft a profile for ingest by looking at a recording.",
    "inspect": "Show channels, units, ranges and defects of logs.",
    "calibrate": "Find an engine's constants and corrections from bench points and healthy logs.",
    "synth-gain": "Find the observer gain and prove it.",
    "verify": "Prove a gain again, without the solver.",
    "estimate": "Estimate the error map of the sensor from logs.",
    "extrapolate": "Fill the nodes that no log visited.",
    "trace": "Find what the model lacks, from its residual.",
    "refine": "Add what is proven, estimate again, error before and after.",
    "export": "Write the map for calibration tools (DCM, CSV, netCDF), or the observer for a control unit (C99, FMU).",
    "compare": "How two maps differ, and where that is more than their errors.",
    "track": "Follow the maps of many vehicles over time.",
    "report": "Tables, gates and the HTML report.",
    "selftest": "Try the installed package on cases with known answers.",
}
SHARED = {
    "recordings": ("ingest", "profile", "inspect"),
    "gains": ("synth_gain", "verify"),
    "loop": ("trace", "refine"),
}
"""Modules of several verbs; the others have one of their own name."""


class _InOrder(click.Group):
    """Verbs in the order in which they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return their names."""
        return list(self.commands)


def _version(context: click.Context, option: object, wanted: bool) -> None:
    if wanted:
        print(__version__)
        context.exit()


def _show_completion(context: click.Context, option: object, shell: str | None) -> None:
    if shell is not None:
        found = get_completion_class(shell)
        if found is None:
            raise click.BadParameter(f"'{shell}' is not one of {', '.join(SHELLS)}")
        print(found(app, {}, "lpvobs", "_LPVOBS_COMPLETE").source())
        context.exit()


SHELLS = ("bash", "zsh", "fish")
TOLD = "Print what teaches your shell to complete verbs, options and names: " + ", ".join(SHELLS) + "."
app = _InOrder(
    "lpvobs",
    params=[
        flag("--version", "Print the version and leave.", callback=_version, is_eager=True)("version", bool),
        option("SHELL", TOLD, offers=SHELLS, callback=_show_completion, is_eager=True)("show_completion", str),
    ],
    callback=lambda **taken: None,
    no_args_is_help=True,
    help="Estimate the error of a mass air flow sensor as a map over fuel quantity and engine speed, from recorded drive cycles.",
    epilog="Chain: simulate, synth-gain, estimate, extrapolate, report. Each verb's --help has an example.",
)
for verb, told in VERBS.items():
    name = verb.replace("-", "_")
    module = next((module for module, verbs in SHARED.items() if name in verbs), name)
    app.add_command(command(verb, told, getattr(import_module(f"lpvobs.cli.{module}"), name)))


def run() -> None:
    """Run the command line."""
    for library in ("OPENBLAS", "OMP", "MKL"):
        # Whatever the environment says: threads sum in another order, so their number would show in the bytes of the results.
        # The matrices are small, and threads would cost more than they gain.
        os.environ[f"{library}_NUM_THREADS"] = "1"
    out = take_streams()
    catch_signals()
    try:
        sys.exit(app(prog_name="lpvobs", standalone_mode=False))
    except Stopped as stop:  # before or after the verb, which says so itself
        print(f"lpvobs: {stop}", file=sys.stderr)
        sys.exit(stop.exit_code)
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
        words = " ".join(visible(says()).split())
        print(f"lpvobs: {words.rstrip('.')}; see `{command} --help`", file=sys.stderr)
    else:
        print(says(), file=sys.stderr)
    return UsageError.exit_code


def _flushed(out: Outlet) -> int:
    """Return the exit code of a verb that has done its work: not 0 where nobody could read what it said."""
    sys.stdout.flush()
    if out.lost is None:
        return 0
    print(f"lpvobs: stdout: {out.lost.strerror}; the verb has ended, its files are whole; make room", file=sys.stderr)
    return DataError.exit_code
