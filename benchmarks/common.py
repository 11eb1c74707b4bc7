"""What every proof shares: simulated logs in memory, a gain, tables in Markdown with date and machine class."""

import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from lpvobs.api.synth_gain import make_gain
from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.io.configuration.config import Config, load_config
from lpvobs.observer.parts import StateGain
from lpvobs.records import Array, Defects, Log
from lpvobs.simulation.parameters import ErrorSurface
from lpvobs.simulation.simulate import simulate

CONFIG = Path(__file__).parent.parent / "configs" / "diesel.toml"
RESULTS = Path(__file__).parent / "results"
CYCLES = {"etc_part1": "ETC surrogate, part 1", "ftp75_cold": "FTP75, cold transient"}


@dataclass(frozen=True)
class Drive:
    """A simulated log and the truth behind it: noise-free operating point, flow and sensor error."""

    log: Log
    delta_W_c: Array
    truth: Mapping[str, Array] = field(default_factory=dict)


def configuration() -> Config:
    """Return the shipped configuration of the diesel."""
    return load_config(CONFIG)[0]


def state_gain(config: Config) -> StateGain:
    """Return the gain of the shipped configuration, proven on its region."""
    stored, _ = make_gain(config, ())
    return StateGain(stored.outputs, stored.gain.L)


def drive(
    config: Config,
    cycle: str,
    seed: int,
    surface: ErrorSurface | None = None,
    engine: DieselEngine | None = None,
    every: int = 1,
) -> Drive:
    """Return a simulated log of the configured engine, or of another one; every so many samples are recorded."""
    if config.simulation is None:
        raise ValueError("the configuration has no simulation")
    made = simulate(engine or config.engine, config.simulation, cycle, seed=seed, surface=surface)
    channels = {name: np.ascontiguousarray(column[::every]) for name, column in made.channels.items()}
    time = channels.pop("time")
    log = Log(
        name=cycle,
        sha256="",
        time=time,
        channels={name: channels[name] for name in Diesel.channels},
        auxiliary={},
        segments=((0, time.size),),
        rows=np.arange(time.size),
        defects=Defects(time.size),
    )
    return Drive(log, channels["ref_delta_W_c"], made.truth)


def altered(engine: DieselEngine, factors: dict[str, float]) -> DieselEngine:
    """Return the engine with constants multiplied by factors."""
    parts = {}
    for item in fields(engine):
        part = getattr(engine, item.name)
        if not is_dataclass(part):
            continue
        own = {name: getattr(part, name) * factor for name, factor in factors.items() if hasattr(part, name)}
        parts[item.name] = replace(part, **own)
    return replace(engine, **parts)


def machine() -> str:
    """Return date and machine class in one line."""
    return f"{datetime.now(UTC):%Y-%m-%d}, {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table."""
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def commit(tree: Path = CONFIG.parent) -> str:
    """Return the commit that a tree is at."""
    call = ["git", "-C", str(tree), "rev-parse", "--short", "HEAD"]
    return subprocess.run(call, capture_output=True, text=True, check=False).stdout.strip()


def publish(name: str, title: str, text: str, command: str = "make bench") -> None:
    """Print a proof and keep it beside the benchmarks."""
    page = f"# {title}\n\n{machine()}. Made by `{command}`.\n\n{text}\n"
    print(page)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.md").write_text(page, encoding="utf-8")
