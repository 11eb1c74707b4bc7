"""What verbs take: how a function becomes a command, options that several share, and what shells offer behind them.

The offers are written out, because a shell does not wait until the libraries behind them are loaded.
"""

import inspect
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin

import click

CYCLES = ("etc", "etc_part1", "ftp75", "ftp75_cold", "nedc", "whtc", "wltc")
METHODS = ("observer", "published", "ekf", "batch")
EXTRAPOLATIONS = ("kriging", "quadratic")
CONSTANTS = ("joint", "consider")
FORMATS = ("dcm", "cdfx", "csv", "netcdf", "lab", "c99", "fmu")
UNITS = ("kg/s", "kg/h", "g/s", "mg/stroke", "%", "factor")
MAP_GAINS = ("falling", "constant")
PROFILES = ("kit-obd", "liu-ice")
PERIODS = ("day", "week", "month", "year")


def command(name: str, told: str, verb: Callable[..., None]) -> click.Command:
    """Return a verb as a command: the default of each parameter makes an option or an argument of its name and type."""
    taken = [each.default(each.name, each.annotation) for each in inspect.signature(verb).parameters.values()]
    return click.Command(name, callback=verb, params=taken, help=inspect.getdoc(verb), short_help=told)


def option(metavar: str, told: str, *names: str, offers: tuple[str, ...] = (), default: Any = None, **more: Any) -> Any:
    """Return an option that completes what it offers; whoever reads a file says what is wrong with it."""

    def made(name: str, annotation: Any) -> click.Option:
        kind, several = _read_as(annotation)
        given: dict[str, Any] = {"type": kind, "multiple": several, "metavar": metavar, "help": told}
        known = {"default": default, "show_default": default not in (None, "")}
        given |= {"required": True} if default is ... else known
        if offers:
            given["shell_complete"] = lambda context, parameter, begun: [one for one in offers if one.startswith(begun)]
        declared = [name, *(names or [f"--{name.replace('_', '-')}"])]
        return click.Option(declared, **given | more)

    return made


needed = partial(option, default=...)
"""Return an option that has to be given."""


def argument(metavar: str, told: str, default: Any = ...) -> Any:
    """Return what has no name before it."""

    def made(name: str, annotation: Any) -> click.Argument:
        kind, several = _read_as(annotation)
        count = -1 if several else 1
        return click.Argument([name], type=kind, nargs=count, metavar=metavar, help=told, required=default is ...)

    return made


def flag(name: str, told: str, default: bool | None = False, **more: Any) -> Any:
    """Return an option without a value."""
    return lambda parameter, _: click.Option([parameter, name], is_flag=True, default=default, help=told, **more)


def _read_as(annotation: Any) -> tuple[Any, bool]:
    """Return the type that words are turned into, and whether there may be several."""
    given = (
        [each for each in get_args(annotation) if each is not NoneType]
        if NoneType in get_args(annotation)
        else [annotation]
    )
    several = get_origin(given[0]) is list
    single = get_args(given[0])[0] if several else given[0]
    return click.Path(readable=False, path_type=Path) if single is Path else single, several


AT_LEAST_ONE = click.IntRange(min=1)
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
REGION = option("AXIS=FROM:TO,...", "Print the mean over this region of the map, too; a comma before a second axis.")
JSON = flag("--json", "Print one JSON object to stdout instead of text.")
ENGINE = option(
    "ENGINE.h5", "An engine made by calibrate to start from; by default, the one that the result was made with."
)
MAP = flag(
    "--freeze-map/--free-map",
    "Take the map as right, or estimate it with the effects. By default it is right for logs that did not make it.",
    default=None,
)
