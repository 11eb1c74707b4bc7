"""One good file of every kind that is read, made in a few seconds without the command line."""

from dataclasses import dataclass
from pathlib import Path

from repository import DIESEL
from robust.defects import Bench

from lpvobs.api.estimate import estimate
from lpvobs.api.extrapolate import extrapolate
from lpvobs.api.synth_gain import make_published_gain
from lpvobs.io.configuration.config import load_config
from lpvobs.io.results.gains import write_gain
from lpvobs.io.results.provenance import Provenance


@dataclass(frozen=True)
class Samples:
    folder: Path
    config: Path
    log: Path
    gain: Path
    result: Path


def lenient(folder: Path, further: str = "") -> Path:
    """Return a configuration that takes the map of a log that is of no engine."""
    text, path = DIESEL.read_text(encoding="utf-8"), folder / "lenient.toml"
    assert "largest_error = 0.6 " in text
    path.write_text(text.replace("largest_error = 0.6 ", "largest_error = 1e3 ") + further, encoding="utf-8")
    return path


def make(folder: Path) -> Samples:
    """Write a log, a gain and a result with its extrapolation into a folder."""
    log, gain, result = folder / "drive.parquet", folder / "gain.h5", folder / "result.h5"
    Bench(folder).write()
    config, text = load_config(DIESEL)
    stored = make_published_gain(config, "ETC")
    write_gain(gain, stored, Provenance({}, text))
    estimate(lenient(folder), log, result, gain=gain, method="batch")
    extrapolate(result)
    return Samples(folder, DIESEL, log, gain, result)
