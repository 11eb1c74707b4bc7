"""The C sources of an observer: fixed files of this folder, the engine's `model.c`, and tables filled in here; and its FMU.

The FMU (FMI 2.0, co-simulation) holds description, sources, and a shared library for 64-bit Linux.
"""

import hashlib
import re
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from math import ceil
from pathlib import Path
from shutil import which
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from lpvobs import __version__
from lpvobs.engines.base import AirPath, EngineKind
from lpvobs.engines.channels import Channel
from lpvobs.engines.followers import Follower
from lpvobs.errors import UsageError
from lpvobs.io.results.gains import StoredGain
from lpvobs.io.templates import filled
from lpvobs.maps.grid import Grid
from lpvobs.observer.smoothing import LEAST
from lpvobs.records import Array

FOLDER = "lpvobs.io.control_unit"
JITTER = 1.5  # samples may come closer than at the stated rate by this factor before a window is cut
MEMORY = 100.0
"""[s] Beyond this the gain of a node falls no further: a sensor that ages is followed within minutes of driving there."""
PACE = 8.0
"""A falling gain is this over the time that its nodes have been driven: of 1 to 32 the best map on the cycles that were tried."""
NAME = "lpvobs"
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
SAME_DAY = (1980, 1, 1, 0, 0, 0)  # stamp of every file inside: the same inputs give the same bytes


@dataclass(frozen=True)
class Unit:
    """All that an observer in C is made from."""

    kind: EngineKind
    air_path: AirPath  # with the constants of the engine that the map goes with
    corrections: Mapping[str, Array]  # values by component, row by row over its axes, where something is known of them
    channels: Mapping[str, Channel]  # with their limits as configured
    grid: Grid  # p nodes
    stored: StoredGain
    theta: Array  # (p,) [kg/s], the map at the start
    driven: Array  # (p,) [s], how long its nodes have been driven
    half_width: float  # [s], of the window
    gap: float  # [s], longest step inside a segment
    gamma: float  # [1/s], largest gain of the map
    rate: float  # [Hz], of the samples at most
    falling: bool  # whether the map's gain falls with the time that its nodes have been driven
    origin: str  # digests of gain and result
    start: str  # where the map is from

    @property
    def ring(self) -> int:
        """Samples that wait for their window or belong to one, at most."""
        return 2 * (ceil(JITTER * self.half_width * self.rate) + LEAST) + 2

    @property
    def followers(self) -> Mapping[str, Follower]:
        """Signals that corrections read and no sensor shows."""
        return self.air_path.followers if self.corrections else {}

    def bytes_of_state(self, real: int) -> int:
        """Return the size of the C state with reals of so many bytes; the compiler fills up to a multiple of eight."""
        n, p = len(self.air_path.state_names), self.grid.size
        reals = self.ring * len(self.channels) + len(self.followers) + n + p * (1 + self.falling) + 2
        return -(-(8 * (self.ring + 2) + real * reals + 4 * 6) // 8) * 8


def sources(unit: Unit) -> dict[str, str]:
    """Return the text of every file by name."""
    made = {name: own_text(name) for name in ("lpvobs.h", "lpvobs.c", "lpvobs_bench.c")}
    model = files(unit.kind.air_path.__module__.rpartition(".")[0]) / "model.c"
    made["lpvobs_model.c"] = model.read_text(encoding="utf-8")
    values: dict[str, Any] = {
        "unit": unit,
        "path": unit.air_path,
        "names": list(unit.channels),
        "numbers": {key: np.asarray(value, dtype=float) for key, value in _numbers(unit).items()},
        "arrays": _arrays(unit),
        "memory": MEMORY,
        "pace": PACE,
        "length": len(_version(unit, "")) + 1,
    }
    how = {"sizes": lambda array: "".join(f"[{size}]" for size in array.shape), "initialiser": _initialiser}
    header, tables = (filled(FOLDER, name, how, **values) for name in ("lpvobs_config.h", "lpvobs_tables.c"))
    digest = hashlib.sha256("\0".join((header, tables, *made.values())).encode()).hexdigest()
    # `@VERSION@` stands in the tables where the version comes, which is a digest of them, too
    return made | {"lpvobs_config.h": header, "lpvobs_tables.c": tables.replace("@VERSION@", _version(unit, digest))}


def own_text(name: str) -> str:
    """Return the text of a file of this folder."""
    return (files(FOLDER) / name).read_text(encoding="utf-8")


def _version(unit: Unit, digest: str) -> str:
    return f"lpvobs {__version__}, {unit.origin}, sources {digest[:16]:16}"


def _numbers(unit: Unit) -> Mapping[str, float | Array]:
    """Return the members of `lpvobs_constants`: the engine's own, then nodes and values of every correction of a flow."""
    if unit.kind.in_c is None:
        raise UsageError(
            f"a {unit.kind.name} engine has no model in C; export the map instead with --format dcm or csv"
        )
    found = dict(unit.kind.in_c(unit.air_path))
    for component in unit.air_path.components:
        if component.name in unit.corrections and component.unit == "1":  # others are lags of sensors
            for name, nodes in component.axes.items():
                found[f"{component.name}_{name.replace('/', '_over_')}"] = nodes.values
            values = unit.corrections[component.name]
            found[component.name] = values if component.axes else values[0]
    return found


def _arrays(unit: Unit) -> dict[str, tuple[str, Array]]:
    """Return the tables with their types, by name."""
    path, region, names = unit.air_path, unit.stored.gain.region, list(unit.channels)
    measured = [*unit.stored.outputs, path.sensor]
    states = [path.state_names.index(name) for name in unit.stored.outputs]
    sums = [[region.names.index(name) for name in pair] for pair in region.nonnegative_sums]
    found = {
        "L": ("real_t", unit.stored.gain.L),
        "region": ("real_t", np.array([region.lower, region.upper]).T),
        "range": ("real_t", np.array([[item.low, item.high] for item in unit.channels.values()])),
        "fuel": ("real_t", unit.grid.fuel),
        "speed": ("real_t", unit.grid.speed),
        "map": ("real_t", unit.theta),
        "smoothed": ("uint32_t", np.array([names.index(name) for name in path.smoothed])),
        "output_state": ("uint32_t", np.array([*states, len(path.state_names)])),
        "output_channel": ("uint32_t", np.array([names.index(name) for name in measured])),
    }
    if unit.followers:
        found["followed"] = ("uint32_t", np.array([names.index(item.channel) for item in unit.followers.values()]))
        found["kept"] = ("real_t", np.exp([-1.0 / item.tau for item in unit.followers.values()]))  # after a second
    if sums:
        found["sums"] = ("uint32_t", np.array(sums))
    if unit.falling:
        found["driven"] = ("real_t", unit.driven)
    return found


def _initialiser(values: Array) -> str:
    if values.ndim == 0:
        return f"{values}U" if values.dtype.kind == "i" else f"R({float(values)!r})"
    return "{" + (",\n    " if values.ndim > 1 else ", ").join(map(_initialiser, values)) + "}"


def write_fmu(path: Path, unit: Unit, made: Mapping[str, str]) -> None:
    """Write an FMU of the C sources; raises UsageError without a C compiler."""
    own = {name: text for name, text in made.items() if name != "lpvobs_bench.c"}
    own["lpvobs_fmu.c"] = own_text("lpvobs_fmu.c")
    files_in_c = sorted(name for name in own if name.endswith(".c"))
    fuel, speed = (axis.unit for axis in unit.air_path.axes)
    outputs = [(f"x_{name}", "state estimate, SI") for name in unit.air_path.state_names]
    outputs += [("map_value", "kg/s: the map at the operating point"), ("innovation", "kg/s"), ("state_time", "s")]
    outputs += [
        (f"theta_{j}_{i}", f"kg/s: node at {n:g} {speed}, {u:g} {fuel}")
        for j, n in enumerate(unit.grid.speed)
        for i, u in enumerate(unit.grid.fuel)
    ]
    description = filled(
        FOLDER,
        "modelDescription.xml",
        {"quoted": quoteattr},
        version=re.findall(r'lpvobs_version.* = "(.*)"', own["lpvobs_tables.c"])[0],
        files_in_c=files_in_c,
        step=1.0 / unit.rate,
        channels=unit.channels,
        outputs=outputs,
    )
    inside = {"modelDescription.xml": description.encode(), f"binaries/linux64/{NAME}.so": _library(own, files_in_c)}
    inside |= {f"sources/{name}": text.encode() for name, text in own.items()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in sorted(inside.items()):
            file.writestr(zipfile.ZipInfo(name, SAME_DAY), content, zipfile.ZIP_DEFLATED)


def _library(sources: Mapping[str, str], files_in_c: Sequence[str]) -> bytes:
    if which("cc") is None:
        raise UsageError(
            "--format fmu: needs a C compiler, but there is no `cc`; install gcc or clang, or use --format c99"
        )
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        command = ["cc", *FLAGS, *files_in_c, "-lm", "-o", f"{NAME}.so"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise UsageError(
                f"--format fmu: the C compiler failed: {done.stderr.strip().splitlines()[-1]}; try another compiler"
            )
        return (Path(folder) / f"{NAME}.so").read_bytes()
