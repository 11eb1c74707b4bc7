"""The diesel in the bank: its drives are simulated, with constants anywhere in their tolerance."""

import csv
import sys
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from draw import (
    FACTOR,
    LESS,
    MORE,
    PLAIN,
    SIGNED,
    Case,
    Drawn,
    Engine,
    Piece,
    Size,
    channel,
    generator,
    interval,
    seed_of,
    sized,
    turn,
    two,
    unlogged,
)

from lpvobs.io.configuration.config import Config, load_effects
from lpvobs.io.logs.parquet import write_log
from lpvobs.simulation.cycles import TABLES, shipped_folder
from lpvobs.simulation.parameters import ErrorSurface, SimulationParameters
from lpvobs.simulation.simulate import simulate

sys.path.insert(0, str(Path(__file__).parent.parent))
from common import altered, configuration

STEP = 2e-3
"""[s] of the integrator; against a quarter of it the flow differs by 2e-7 kg/s rms and 2e-5 at most: the sensor's noise is 5e-4."""
SIZES = {
    "maf.gain": Size("factor", 0.04, 0.15, FACTOR),
    "maf.offset": Size("offset", 5e-4, 2e-3, SIGNED),
    "maf.lag": Size("tau", 0.02, 0.12, PLAIN),
    "maf.delay": Size("delay", 0.015, 0.06, PLAIN),
    "maf.drift": Size("rate", 8e-5, 4e-4, SIGNED),
    "maf.temperature": Size("coefficient", 2e-3, 6e-3, SIGNED),
    "maf.contamination": Size("coefficient", 0.04, 0.15, PLAIN),
    "maf.backflow": Size("coefficient", 0.08, 0.3, PLAIN),
    "leak.intake": Size("area", 3e-6, 2e-5, PLAIN),
    "leak.inlet": Size("area", 4e-5, 1.5e-4, PLAIN),
    "egr.leak": Size("area", 2e-6, 1e-5, PLAIN),
    "egr.area": Size("factor", 0.1, 0.3, LESS),
    "eta_vol.factor": Size("factor", 0.04, 0.1, LESS),
    "compressor.flow": Size("factor", 0.03, 0.08, LESS),
    "turbine.efficiency": Size("factor", 0.04, 0.12, LESS),
    "exhaust.restriction": Size("factor", 1.0, 4.0, MORE),
    "u_delta.gain": Size("factor", 0.04, 0.1, FACTOR),
    "p_im.gain": Size("factor", 0.01, 0.04, FACTOR),
    "p_im.offset": Size("offset", 1000.0, 3000.0, SIGNED),
    "p_em.gain": Size("factor", 0.01, 0.04, FACTOR),
    "omega_t.gain": Size("factor", 0.007, 0.02, FACTOR),
    "T_im.lag": Size("tau", 2.0, 10.0, PLAIN),
}
ABSORBED = frozenset({"maf.gain", "maf.offset", "maf.contamination", "maf.backflow", "leak.inlet", "u_delta.gain"})
"""A map made from the same log would rightly hold these: they come with an onset, or against a nominal map."""
MOVES = {"T_coolant": 20.0, "T_charge": 10.0, "humidity": 10.0, "v_veh": 40.0, "ac_switch": 1.0}
"""Auxiliary channels that an effect may follow, with what they move by, in their units (K, K, %, km/h, 1)."""
ENGINE_CYCLES = ("etc", "whtc")
"""Cycles that prescribe no vehicle speed."""
PIECES: tuple[Piece, ...] = (
    ("etc", 0.0, 600.0),
    ("etc", 600.0, 1200.0),
    ("etc", 1200.0, 1800.0),
    ("ftp75", 0.0, 505.0),
    ("ftp75", 505.0, 1105.0),
    ("nedc", 400.0, 1180.0),
    ("whtc", 0.0, 600.0),
    ("wltc", 0.0, 600.0),
    ("wltc", 1022.0, 1600.0),
)
"""Table, begin and end [s] of what is driven."""


def draw(bank: int, number: int) -> Case:
    """Return the case of a number."""
    rng, kind = generator(bank, number)
    piece = PIECES[rng.integers(len(PIECES))]
    others = [other for other in PIECES if other != piece]
    nominal = others[rng.integers(len(others))] if rng.random() < 0.35 else None
    healthy = {name: float(1.0 + share * rng.uniform(-1, 1)) for name, share in _config().estimate.tolerance.items()}
    healthy["surface"] = float(rng.choice([0.0, 0.5, 1.0, 1.3]))
    length, frozen = piece[2] - piece[1], nominal is not None
    moves = {name: by for name, by in MOVES.items() if name != "v_veh" or piece[0] not in ENGINE_CYCLES}
    effects = {
        "clean": lambda: [],
        "single": lambda: [_catalogue(rng, turn(SIZES, number), length, frozen)],
        "pair": lambda: [_catalogue(rng, id_, length, frozen) for id_ in two(rng, SIZES)],
        "channel": lambda: [channel(rng, moves, (4e-4, 1.2e-3), (0.03, 0.07))],
        "unlogged": lambda: [unlogged(rng, length, (6e-4, 2e-3), (0.05, 0.12))],
    }[kind]()
    return Case(number, kind, piece, nominal, seed_of(bank, number), healthy, effects)


def _catalogue(rng: np.random.Generator, id_: str, length: float, frozen: bool) -> Drawn:
    effect = sized(rng, id_, SIZES[id_])
    starts = id_ in ABSORBED and not frozen
    return effect | (interval(rng, length) if starts or rng.random() < 0.4 else {})


@cache
def _config() -> Config:
    return configuration()


def record(case: Case, path: Path, with_effects: bool) -> None:
    """Write the log of a case, and the one its nominal map is made from."""
    _drive(case, case.piece, case.seed, path, case.effects if with_effects else [])
    if case.nominal is not None:
        _drive(case, case.nominal, case.seed + 500_000_000, path.with_suffix(".nominal.parquet"), [])


def _drive(case: Case, piece: Piece, seed: int, path: Path, effects: list[Drawn]) -> None:
    config = _config()
    if config.simulation is None:
        raise SystemExit("the configuration has no simulation")
    constants = {name: factor for name, factor in case.healthy.items() if name != "surface"}
    parameters = replace(config.simulation, step=STEP, surface=_scaled(config.simulation, case.healthy["surface"]))
    with tempfile.TemporaryDirectory() as scratch:
        cycle, toml = Path(scratch) / "cycle.csv", Path(scratch) / "effects.toml"
        _cut(piece, cycle)
        toml.write_text(_toml(effects), encoding="utf-8")
        known = load_effects(toml)
        log = simulate(
            altered(config.engine, constants),
            parameters,
            str(cycle),
            seed=seed,
            effects=known.injected,
            auxiliary=known.auxiliary,
        )
    channels = {name: values for name, values in log.channels.items() if not name.startswith("ref_")}
    write_log(path, channels, log.units)


def _scaled(parameters: SimulationParameters, share: float) -> ErrorSurface:
    surface = parameters.surface
    bumps = tuple(replace(bump, amplitude=share * bump.amplitude) for bump in surface.bumps)
    return replace(surface, coefficients=tuple(share * c for c in surface.coefficients), bumps=bumps)


def _cut(piece: Piece, path: Path) -> None:
    """Write the rows of a cycle between two times, its clock from zero."""
    table, begin, end = piece
    with (shipped_folder() / "cycles" / TABLES[table]).open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    kept = [[str(float(time) - begin), *rest] for time, *rest in rows if begin <= float(time) <= end]
    offset = float(kept[0][0])
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *[[str(float(time) - offset), *rest] for time, *rest in kept]])


def _toml(effects: list[Drawn]) -> str:
    lines = ["[auxiliary]"]  # a road, and every channel that the cycle has
    for effect in effects:
        lines.append("[[effect]]")
        lines += [
            f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}" for key, value in effect.items()
        ]
    return "\n".join(lines) + "\n"


DIESEL = Engine("diesel", "diesel.toml", 690, SIZES, draw, record)
