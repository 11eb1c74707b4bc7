"""The `lpvobs` command: one short file per verb, joined here."""

import sys
from typing import Annotated

import typer

from lpvobs import __version__
from lpvobs.cli import estimate, extrapolate, inspect, report, simulate, synth_gain, verify
from lpvobs.cli.common import SIGINT_CODE, catch_sigterm

app = typer.Typer(
    name="lpvobs",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Estimate the error of a mass air flow sensor as a map over fuel quantity and engine speed, from recorded drive cycles.",
    epilog="Chain: simulate, synth-gain, estimate, extrapolate, report. Each verb's --help has an example.",
)
app.command("simulate")(simulate.simulate)
app.command("inspect")(inspect.inspect)
app.command("synth-gain")(synth_gain.synth_gain)
app.command("verify")(verify.verify)
app.command("estimate")(estimate.estimate)
app.command("extrapolate")(extrapolate.extrapolate)
app.command("report")(report.report)


def _version(wanted: bool) -> None:
    if wanted:
        print(__version__)
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and leave.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Take the options that belong to no verb."""


def run() -> None:
    """Run the command line; the console script."""
    catch_sigterm()
    try:
        app()
    except KeyboardInterrupt:
        sys.exit(SIGINT_CODE)
