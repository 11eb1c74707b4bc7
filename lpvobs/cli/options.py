"""What verbs take: options that several share, and what shells offer behind them.

The offers are written out, because a shell does not wait until the libraries behind them are loaded.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

CYCLES = ("etc", "etc_part1", "ftp75", "ftp75_cold", "nedc", "whtc", "wltc")
METHODS = ("observer", "published", "ekf", "batch")
EXTRAPOLATIONS = ("kriging", "quadratic")
CONSTANTS = ("joint", "consider")
FORMATS = ("dcm", "csv", "netcdf", "c99", "fmu")
MAP_GAINS = ("falling", "constant")
PROFILES = ("kit-obd", "liu-ice")


def offer(names: tuple[str, ...]) -> Callable[[str], list[str]]:
    """Return a function that completes one of the names; where none fits, shells complete files."""

    def fitting(incomplete: str) -> list[str]:
        return [name for name in names if name.startswith(incomplete)]

    return fitting


def option(metavar: str, told: str, *names: str, offers: tuple[str, ...] = (), **more: Any) -> Any:
    """Return an option that completes what it offers; whoever reads a file says what is wrong with it."""
    return typer.Option(
        *names, readable=False, metavar=metavar, help=told, autocompletion=offer(offers) if offers else None, **more
    )


def argument(metavar: str, told: str) -> Any:
    """Return the same without a name before it."""
    return typer.Argument(readable=False, metavar=metavar, help=told)


CONFIGURATION = "Engine, map grid, gain, policies; by default lpvobs.toml in this folder or the nearest one above it."
ConfigOption = Annotated[Path | None, option("TOML", CONFIGURATION, "--config")]
GainOption = Annotated[
    Path | None, option("GAIN.h5", "A gain made by synth-gain; without it, one is made and proven first.")
]
LogsArgument = Annotated[list[Path], argument("LOG...", "Parquet logs, patterns, or folders of logs.")]
RegionOption = Annotated[
    str | None, option("AXIS=FROM:TO,...", "Mean over this part of the map; a second axis follows after a comma.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object to stdout instead of text.")]
MADE_WITH = "An engine made by calibrate to start from; by default, the one that the result was made with."
MapOption = Annotated[
    bool | None,
    typer.Option(
        "--freeze-map/--free-map",
        help="The map stands, or is estimated together with the effects. By default it stands on logs that did not make it.",
    ),
]
