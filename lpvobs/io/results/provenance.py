"""What made a result: inputs, configuration, versions, command line."""

import json
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py

from lpvobs import __version__
from lpvobs.engines.base import AirPath
from lpvobs.errors import DataError

LIBRARIES = ("numpy", "scipy", "numba", "h5py", "pyarrow")


def expect_engine(
    path: Path, what: str, made_for: tuple[str, Mapping[str, float]], engine: AirPath, remedy: str
) -> None:
    """Raise DataError unless a gain or engine was made for the configured kind and constants; `what` says so of the file."""
    kind, constants = made_for
    if kind != engine.name:
        raise DataError(
            f"{path}: {what} a {kind} engine, but the configuration has a {engine.name} engine; {remedy} from this configuration"
        )
    for name, value in engine.engine_constants().items():
        if constants.get(name) != value:
            raise DataError(
                f"{path}: {what} another engine: the constant {name} is {constants.get(name)} in this file and {value:g} in the "
                f"configuration; {remedy} from this configuration"
            )


def versions() -> dict[str, str]:
    """Return the version of the package, of Python, and of the libraries that numbers depend on."""
    from importlib.metadata import version  # loads what reads mail

    return {"lpvobs": __version__, "python": platform.python_version()} | {name: version(name) for name in LIBRARIES}


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from, the attributes of `/provenance`; made by this process unless said."""

    inputs_sha256: Mapping[str, str]  # by file name, without folders
    config: str  # text of the configuration
    command_line: str = field(
        default_factory=lambda: shlex.join([sys.argv[0].removesuffix("/__main__.py").rpartition("/")[2], *sys.argv[1:]])
    )
    versions: Mapping[str, str] = field(default_factory=versions)


def write_refused(file: h5py.File, refused: Sequence[str]) -> None:
    """Write why logs were left out, each with its reason."""
    file.attrs["refused"] = json.dumps(list(refused))


def read_refused(file: h5py.File) -> tuple[str, ...]:
    """Return it; nothing for a result that does not say."""
    return tuple(map(str, json.loads(str(file.attrs.get("refused", "[]")))))
