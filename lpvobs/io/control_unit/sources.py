"""The C sources of an observer: fixed files of this folder, the engine's `model.c`, and tables filled in here."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from math import ceil
from string import Template

import numpy as np

from lpvobs import __version__
from lpvobs.engines.base import AirPath, EngineKind
from lpvobs.engines.channels import Channel
from lpvobs.errors import UsageError
from lpvobs.io.results.gains import StoredGain
from lpvobs.maps.grid import Grid
from lpvobs.observer.smoothing import LEAST
from lpvobs.records import Array

JITTER = 1.5  # samples may come closer than at the stated rate by this factor before a window is cut
MEMORY = 100.0
"""[s] Beyond this the gain of a node falls no further: a sensor that ages is followed within minutes of driving there."""
PACE = 8.0
"""A falling gain is this over the time that its nodes have been driven: of 1 to 32 the best map on the cycles that were tried."""


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

    def bytes_of_state(self, real: int) -> int:
        """Return the size of the C state with reals of so many bytes; the compiler fills up to a multiple of eight."""
        n, p = len(self.air_path.state_names), self.grid.size
        reals = self.ring * len(self.channels) + n + p * (1 + self.falling) + 2
        return -(-(8 * (self.ring + 2) + real * reals + 4 * 6) // 8) * 8


def sources(unit: Unit) -> dict[str, str]:
    """Return the text of every file by name."""
    fixed = {name: own_text(name) for name in ("lpvobs.h", "lpvobs.c", "lpvobs_bench.c")}
    model = files(unit.kind.air_path.__module__.rpartition(".")[0]) / "model.c"
    made = fixed | {"lpvobs_model.c": model.read_text(encoding="utf-8")}
    header, tables = _header(unit), _tables(unit)
    digest = hashlib.sha256("\0".join((header, tables, *made.values())).encode()).hexdigest()
    return made | {"lpvobs_config.h": header, "lpvobs_tables.c": tables.replace("@VERSION@", _version(unit, digest))}


def own_text(name: str) -> str:
    """Return the text of a file of this folder."""
    return (files("lpvobs.io.control_unit") / name).read_text(encoding="utf-8")


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


def _constants(unit: Unit) -> dict[str, float | int]:
    """Return the single numbers of `lpvobs_config.h`; those that are real in C are floats."""
    path, grid = unit.air_path, unit.grid
    names = list(unit.channels)
    return {
        "STATES": len(path.state_names),
        "OUTPUTS": len(unit.stored.outputs) + 1,
        "PARAMETERS": len(path.parameter_names),
        "CHANNELS": len(names),
        "SMOOTHED": len(path.smoothed),
        "SUMS": len(unit.stored.gain.region.nonnegative_sums),
        "FUEL_NODES": grid.fuel.size,
        "SPEED_NODES": grid.speed.size,
        "NODES": grid.size,
        "RING": unit.ring,
        "FALLING": int(unit.falling),
        "CORRECTED": int(bool(unit.corrections)),
        "SENSOR": names.index(path.sensor),
        "FUEL": names.index(path.axes[0].channel),
        "SPEED": names.index(path.axes[1].channel),
        "GAMMA": unit.gamma,
        "MEMORY": MEMORY,
        "PACE": PACE,
        "LARGEST": unit.channels[path.sensor].high,
    }


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
    if sums:
        found["sums"] = ("uint32_t", np.array(sums))
    if unit.falling:
        found["driven"] = ("real_t", unit.driven)
    return found


def _literal(value: float | int) -> str:
    return f"{value}U" if isinstance(value, int) else f"((real_t){value!r})"


def _shape(values: Array) -> str:
    return "".join(f"[{size}]" for size in values.shape)


def _header(unit: Unit) -> str:
    channels = [
        f"    LPVOBS_IN_{name} = {i}, /* {item.unit}, {item.low:g} to {item.high:g}: {item.meaning} */"
        for i, (name, item) in enumerate(unit.channels.items())
    ]
    members = [f"    real_t {name}{_shape(np.asarray(value))};" for name, value in _numbers(unit).items()]
    tables = [f"extern const {kind} lpvobs_{name}{_shape(values)};" for name, (kind, values) in _arrays(unit).items()]
    constants = [f"#define LPVOBS_{name} {_literal(value)}" for name, value in _constants(unit).items()]
    lists = {"channels": channels, "members": members, "tables": tables, "constants": constants}
    return Template(own_text("lpvobs_config.h")).substitute(
        {name: "\n".join(lines) for name, lines in lists.items()},
        origin=unit.origin,
        double=unit.bytes_of_state(8),
        float=unit.bytes_of_state(4),
        states=", ".join(unit.air_path.state_names),
        parameters=", ".join(unit.air_path.parameter_names),
        half_width=unit.half_width,
        gap=unit.gap,
        length=len(_version(unit, "")) + 1,
    )


def _tables(unit: Unit) -> str:
    known = {name: _initialiser(np.asarray(value, dtype=float)) for name, value in _numbers(unit).items()}
    numbers = [f"    {value}, /* {name} */" for name, value in known.items()]
    arrays = _arrays(unit)
    names = ", ".join(map(json.dumps, unit.channels))
    sizes = " + ".join(f"sizeof(lpvobs_{name})" for name in ("engine", *arrays))
    lines = [
        '#include "lpvobs.h"',
        "#define R(x) ((real_t)(x))",
        f'const char lpvobs_version[{len(_version(unit, "")) + 1}] = "@VERSION@";',
        "const lpvobs_constants lpvobs_engine = {",
        *numbers,
        "};",
        *(f"const {kind} lpvobs_{n}{_shape(values)} = {_initialiser(values)};" for n, (kind, values) in arrays.items()),
        f"const char *const lpvobs_channel_names[LPVOBS_CHANNELS] = {{{names}}};",
        f"const uint32_t lpvobs_table_bytes = (uint32_t)({sizes});\n",
    ]
    return "\n".join(lines)


def _initialiser(values: Array) -> str:
    if values.ndim == 0:
        return f"R({float(values)!r})"
    if values.ndim > 1:
        return "{" + ",\n    ".join(_initialiser(row) for row in values) + "}"
    if values.dtype.kind == "i":
        return "{" + ", ".join(f"{value}U" for value in values.tolist()) + "}"
    return "{" + ", ".join(f"R({value!r})" for value in values.tolist()) + "}"
