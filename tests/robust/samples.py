"""One good file of every kind that is read, made in a few seconds without the command line."""

from dataclasses import dataclass, replace
from pathlib import Path

from repository import DIESEL
from robust.defects import Bench

from lpvobs.api.estimate import estimate_logs
from lpvobs.api.extrapolate import extrapolate
from lpvobs.api.known_engine import learned_engine
from lpvobs.api.synth_gain import make_published_gain
from lpvobs.io.configuration.config import Config, load_config
from lpvobs.io.results.gains import write_gain
from lpvobs.io.results.provenance import Provenance


@dataclass(frozen=True)
class Samples:
    folder: Path
    config: Path
    log: Path
    gain: Path
    result: Path


def lenient(config: Config) -> Config:
    """Return a configuration that takes the map of a log that is of no engine."""
    return replace(config, estimate=replace(config.estimate, largest_error=1e3))


def make(folder: Path) -> Samples:
    """Write a log, a gain and a result with its extrapolation into a folder."""
    log, gain, result = folder / "drive.parquet", folder / "gain.h5", folder / "result.h5"
    Bench(folder).write()
    config, text = load_config(DIESEL)
    stored = make_published_gain(config, "ETC")
    write_gain(gain, stored, Provenance({}, text))
    estimate_logs(learned_engine(lenient(config), ()), text, stored, [log], result, "batch", lambda done: None)
    extrapolate(result)
    return Samples(folder, DIESEL, log, gain, result)
