"""From a case to a log that does not say what is in it, and to the same log without the effect."""

import csv
import hashlib
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from draw import Case

from lpvobs.io.configuration.config import Config, load_effects
from lpvobs.io.logs.reading import write_log
from lpvobs.simulation.cycles import TABLES, data_folder
from lpvobs.simulation.parameters import SimulationParameters, Surface
from lpvobs.simulation.simulate import simulate

sys.path.insert(0, str(Path(__file__).parent.parent))
from common import altered

STEP = 2e-3
"""[s] of the integrator; against a quarter of it the flow differs by 2e-7 kg/s rms and 2e-5 at most: the sensor's noise is 5e-4."""


def name_of(case: Case) -> str:
    """Return a name that tells nothing: a hash of the number."""
    return hashlib.sha256(f"log {case.seed}".encode()).hexdigest()[:12]


def record(config: Config, case: Case, folder: Path, with_effects: bool = True) -> Path:
    """Write the log of a case, and the one its nominal map is made from; return the former's path."""
    path = folder / f"{name_of(case)}.parquet"
    _drive(config, case, case.piece, case.seed, path, with_effects)
    if case.nominal is not None:
        _drive(config, case, case.nominal, case.seed + 500_000_000, path.with_suffix(".nominal.parquet"), False)
    return path


def _drive(
    config: Config, case: Case, piece: tuple[str, float, float], seed: int, path: Path, with_effects: bool
) -> None:
    if path.exists():
        return
    if config.simulation is None:
        raise SystemExit("the configuration has no simulation")
    parameters = replace(config.simulation, step=STEP, surface=_scaled(config.simulation, case.surface))
    with tempfile.TemporaryDirectory() as scratch:
        cycle, toml = Path(scratch) / "cycle.csv", Path(scratch) / "effects.toml"
        _cut(piece, cycle)
        toml.write_text(_toml(case.effects if with_effects else []), encoding="utf-8")
        effects, _ = load_effects(toml)
        log = simulate(
            altered(config.engine, case.constants),
            parameters,
            str(cycle),
            seed=seed,
            effects=effects.injected,
            auxiliary=effects.auxiliary,
        )
    channels = {name: values for name, values in log.channels.items() if not name.startswith("ref_")}
    write_log(path, channels, log.units)


def _scaled(parameters: SimulationParameters, share: float) -> Surface:
    surface = parameters.surface
    bumps = tuple(replace(bump, amplitude=share * bump.amplitude) for bump in surface.bumps)
    return replace(surface, coefficients=tuple(share * c for c in surface.coefficients), bumps=bumps)


def _cut(piece: tuple[str, float, float], path: Path) -> None:
    """Write the rows of a cycle between two times, its clock from zero."""
    table, begin, end = piece
    with (data_folder() / "cycles" / TABLES[table]).open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    kept = [[str(float(time) - begin), *rest] for time, *rest in rows if begin <= float(time) <= end]
    offset = float(kept[0][0])
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *[[str(float(time) - offset), *rest] for time, *rest in kept]])


def _toml(effects: list[dict[str, object]]) -> str:
    lines = ["[auxiliary]"]  # a road, and every channel that the cycle has
    for effect in effects:
        lines.append("[[effect]]")
        lines += [
            f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}" for key, value in effect.items()
        ]
    return "\n".join(lines) + "\n"
