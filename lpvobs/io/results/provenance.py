"""What made a result: inputs, configuration, versions, command line."""

import json
import platform
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import h5py

from lpvobs import __version__

LIBRARIES = ("numpy", "scipy", "numba", "h5py", "pyarrow")


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from."""

    inputs: Mapping[str, str]  # file name (without folders) to SHA-256
    config: str  # text of the configuration

    def write(self, file: h5py.File) -> None:
        """Write the attributes of `/provenance`."""
        group = file.create_group("provenance")
        group.attrs["inputs_sha256"] = json.dumps(dict(self.inputs))
        group.attrs["config"] = self.config
        group.attrs["command_line"] = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
        group.attrs["versions"] = json.dumps(versions())


def versions() -> dict[str, str]:
    """Return the version of the package, of Python, and of the libraries that numbers depend on."""
    return {"lpvobs": __version__, "python": platform.python_version()} | {name: version(name) for name in LIBRARIES}


def read_provenance(file: h5py.File) -> Provenance:
    """Return the inputs and the configuration behind a stored result."""
    attributes = file["provenance"].attrs
    return Provenance(table_of(attributes["inputs_sha256"]), str(attributes["config"]))


def table_of(text: str) -> dict[str, str]:
    """Return a JSON object of strings; raises ValueError for anything else."""
    found = json.loads(text)
    if not isinstance(found, dict):
        raise ValueError("expected a table of strings")
    return {str(key): str(value) for key, value in found.items()}
