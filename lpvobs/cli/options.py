"""What verbs take: options that several share, and what shells offer behind them.

The offers are written out, because a shell does not wait until the libraries behind them are loaded.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import typer

CYCLES = ("etc", "etc_part1", "ftp75", "ftp75_cold", "nedc", "whtc", "wltc")
METHODS = ("observer", "published", "ekf", "batch")
EXTRAPOLATIONS = ("kriging", "quadratic")
CONSTANTS = ("joint", "consider")
FORMATS = ("dcm", "cdfx", "csv", "netcdf", "lab", "c99", "fmu")
UNITS = ("kg/s", "kg/h", "g/s", "mg/stroke", "%", "factor")
MAP_GAINS = ("falling", "constant")
PROFILES = ("kit-obd", "liu-ice")
PERIODS = ("day", "week", "month", "year")


def offer(names: tuple[str, ...]) -> Callable[[str], list[str]]:
    """Return a function that completes one of the names; where none fits, shells complete files."""

    def fitting(incomplete: str) -> list[str]:
        return [name for name in names if name.startswith(incomplete)]

    return fitting


def option(metavar: str, told: str, *names: str, offers: tuple[str, ...] = (), default: Any = None, **more: Any) -> Any:
    """Return an option that completes what it offers; whoever reads a file says what is wrong with it."""
    completed = offer(offers) if offers else None
    return typer.Option(default, *names, readable=False, metavar=metavar, help=told, autocompletion=completed, **more)


needed = partial(option, default=...)
"""Return an option that has to be given."""


def argument(metavar: str, told: str, default: Any = ...) -> Any:
    """Return what has no name before it."""
    return typer.Argument(default, readable=False, metavar=metavar, help=told)


def flag(name: str, told: str, default: bool | None = False, **more: Any) -> Any:
    """Return an option without a value."""
    return typer.Option(default, name, help=told, **more)


CONFIG = option(
    "TOML",
    "Engine, map grid, gain, policies; by default lpvobs.toml in this folder or the nearest one above it.",
    "--config",
)
GAIN = option("GAIN.h5", "A gain made by synth-gain; without it, one is made and proven first.")
SCHEDULER = option(
    "tcp://HOST:PORT", "Use the workers of this Dask scheduler; they must see the logs under the same paths."
)
VEHICLE = option("NAME", "The vehicle, stored in the log for track.")
DATE = option("YYYY-MM-DD", "The date of the drive, stored in the log for track.")
LOGS = argument("LOG...", "Parquet logs, patterns, or folders of logs.")
REGION = option("AXIS=FROM:TO,...", "Also print the mean over this region of the map; put a comma between two axes.")
JSON = flag("--json", "Print one JSON object to stdout instead of text.")
ENGINE = option(
    "ENGINE.h5", "An engine made by calibrate to start from; by default, the one that the result was made with."
)
MAP = flag(
    "--freeze-map/--free-map",
    "Keep the map, or estimate it again with the effects. By default it is kept for logs that it was not estimated from.",
    default=None,
)
