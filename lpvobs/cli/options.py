"""What verbs take: options that several share, and what shells offer behind them.

The offers are written out, because a shell does not wait until the libraries behind them are loaded.
"""

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


def option(metavar: str, told: str, *names: str, offers: tuple[str, ...] = (), default: Any = None, **more: Any) -> Any:
    """Return an option that completes what it offers, else files; whoever reads a file says what is wrong with it."""

    def fitting(incomplete: str) -> list[str]:
        return [name for name in offers if name.startswith(incomplete)]

    more |= {"autocompletion": fitting} if offers else {}
    return typer.Option(default, *names, readable=False, metavar=metavar, help=told, **more)


needed = partial(option, default=...)
"""Return an option that has to be given."""


def argument(metavar: str, told: str) -> Any:
    """Return what has no name before it; it may be left out where the brackets say so."""
    return typer.Argument(None if metavar[0] == "[" else ..., readable=False, metavar=metavar, help=told)


def flag(name: str, told: str, default: bool | None = False, **more: Any) -> Any:
    """Return an option without a value."""
    return typer.Option(default, name, help=told, **more)


CONFIG = option(
    "TOML",
    "The configuration: engine, map grid, settings of the gain, treatment of defects. By default lpvobs.toml in this folder or the "
    "nearest folder above.",
)
GAIN = option("GAIN.h5", "An observer gain made by synth-gain. Without it, the command makes and proves a gain first.")
JOBS = option("N", "Number of logs processed at once. By default 1 for few logs, else the number of processors.", min=1)
SCHEDULER = option(
    "tcp://HOST:PORT",
    "Process the logs on the workers of this Dask scheduler. The workers must find the logs under the same paths.",
)
VEHICLE = option("NAME", "Name of the vehicle. It is stored in the log, where track reads it.")
DATE = option("YYYY-MM-DD", "Date of the drive. It is stored in the log, where track reads it.")
LOGS = argument("LOG...", "Parquet logs, patterns such as logs/*.parquet, or folders of logs.")
REGION = option("AXIS=FROM:TO,...", "Also print the mean over this region of the map. Put a comma between two axes.")
JSON = flag("--json", "Print one JSON object to stdout instead of text.")
ENGINE = option("ENGINE.h5", "An engine made by calibrate to start from. By default the result's own engine.")
OWN_ENGINE = option(
    "ENGINE.h5",
    "An engine made by calibrate with the same configuration as --config. Without it, the configured engine is used.",
)
MAP = flag(
    "--freeze-map/--free-map",
    "Keep the stored map, or estimate it again together with the effects. By default the map is kept if it was estimated from "
    "other logs.",
    default=None,
)
