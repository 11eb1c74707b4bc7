"""The engines of the second bank, and how one of them is driven: nothing here knows what is wrong with it.

Twelve engines have every form of `[simulation.structure]` at amplitudes of their own, all constants within 1 % (those that no
tolerance lists as well), coloured sensor noise, and 20 or 100 samples a second. Eight are calibrated from their own bench table,
four from a drive whose sensor is right. Six more have the model's structure and one healthy variation each.
"""

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.io.configuration.config import Config
from lpvobs.io.logs.bench import write_table
from lpvobs.io.logs.parquet import write_log
from lpvobs.simulation.cycles import TABLES, shipped_folder
from lpvobs.simulation.instruments import lagged
from lpvobs.simulation.parameters import ErrorSurface, SimulationParameters
from lpvobs.simulation.road import Auxiliary
from lpvobs.simulation.simulate import SimulatedLog, drawn, simulate
from lpvobs.simulation.stationary import bench

sys.path.insert(0, str(Path(__file__).parent.parent))
from common import configuration

Array = NDArray[np.float64]
BANK = 20261122
"""Added to the bank's seed, so that its numbers are nobody else's."""
STEP = 2e-3
"""[s] of the integrator, as in the first bank."""
ENGINES, BENCH_TAUGHT, POINTS = 12, 8, 60
"""Engines of another structure, how many of them are calibrated from a bench table, and its points."""
FORMS = (0.5, 1.5)
"""Least and most amplitude of a form."""
MORE = ("c_vgt1", "c_vgt2", "c_egr1", "c_egr2", "gamma_e", "c_pe", "c_pi", "eta_tm_min")
"""Constants that the shipped configuration gives no tolerance."""
VARIATIONS = ("unlisted", "twice", "thermocouple", "coloured", "noisy", "slow")
"""Unlisted constants within 1 %, listed ones within twice their tolerance, T_em 1 s late, noise of 1 s, noise x 3, 20 Hz."""
HEALTHY_DRIVES = 6
PIECES = (
    ("etc", 0.0, 600.0),
    ("etc", 600.0, 1200.0),
    ("etc", 1200.0, 1800.0),
    ("ftp75", 0.0, 505.0),
    ("ftp75", 505.0, 1105.0),
    ("nedc", 580.0, 1180.0),
    ("whtc", 0.0, 600.0),
    ("wltc", 0.0, 600.0),
    ("wltc", 1022.0, 1600.0),
)
"""Table, begin and end [s] of what is driven: eight to ten minutes, so that many drives can be judged."""
COLOURED = ("p_im", "p_em", "omega_t", "T_im", "T_em")
"""Channels with coloured noise; that of the air flow sensor stays white."""


@dataclass(frozen=True)
class OwnEngine:
    """One engine and its sensors, healthy.

    Attributes
    ----------
    number : int
    taught : str
        `bench`, `healthy`, or `map` where nothing but the map of healthy drives is known.
    variation : str
        One of `VARIATIONS`, or empty.
    structure : mapping of str to float
        Amplitudes of the forms.
    seed : int
        Of the constants.
    surface : float
        Share of the configured error of the sensor.
    colour : tuple of float
        Standard deviation of the coloured noise over that of the white, and its time constant [s].
    rate : float
        [Hz]
    """

    number: int
    taught: str
    variation: str
    structure: dict[str, float]
    seed: int
    surface: float
    colour: tuple[float, float]
    rate: float

    def without_variation(self) -> "OwnEngine":
        """Return the same engine on a day, or at a recorder, without its variation."""
        return replace(self, variation="", colour=(0.0, 1.0), rate=100.0)


@cache
def config() -> Config:
    """Return the shipped configuration."""
    return configuration()


def population(bank: int) -> list[OwnEngine]:
    """Return the engines of a bank, those with a variation last."""
    return [_another(bank, k) for k in range(ENGINES)] + [_varied(bank, k) for k in range(len(VARIATIONS))]


def _another(bank: int, k: int) -> OwnEngine:
    rng = np.random.default_rng([BANK, bank, 7, k])
    taught = "bench" if k % ENGINES < BENCH_TAUGHT else "healthy"
    forms = {form.name: round(float(rng.uniform(*FORMS)), 3) for form in fields(_parameters().structure)}
    surface = float(rng.choice([0.5, 1.0, 1.3])) if taught == "bench" else 0.0
    colour = (float(rng.uniform(0.3, 0.7)), float(np.exp(rng.uniform(np.log(0.1), np.log(1.0)))))
    return OwnEngine(k, taught, "", forms, int(rng.integers(1 << 30)), surface, colour, 20.0 if k % 3 == 2 else 100.0)


def _varied(bank: int, k: int) -> OwnEngine:
    rng = np.random.default_rng([BANK, bank, 8, k])
    variation = VARIATIONS[k]
    colour = (1.0, 1.0) if variation == "coloured" else (0.0, 1.0)
    rate = 20.0 if variation == "slow" else 100.0
    return OwnEngine(ENGINES + k, "map", variation, {}, int(rng.integers(1 << 30)), 1.0, colour, rate)


def _parameters() -> SimulationParameters:
    if config().simulation is None:
        raise SystemExit("the configuration has no simulation")
    return config().simulation  # type: ignore[return-value]


def plant(engine: OwnEngine) -> tuple[DieselEngine, SimulationParameters]:
    """Return constants and surroundings of an engine."""
    tolerance, parameters = dict(config().estimate.tolerance), _parameters()
    within: Any = {
        "": 0.01 if engine.structure else tolerance,
        "unlisted": {**tolerance, **dict.fromkeys(MORE, 0.01)},
        "twice": {name: 2.0 * size for name, size in tolerance.items()},
    }.get(engine.variation, tolerance)
    sensors = parameters.sensors
    if engine.variation == "noisy":
        white = (item.name for item in fields(sensors) if item.name != "quantisation")
        sensors = replace(sensors, **{name: 3.0 * getattr(sensors, name) for name in white})
    whole = replace(
        parameters,
        step=STEP,
        sensors=sensors,
        surface=_scaled(parameters.surface, engine.surface),
        structure=replace(parameters.structure, **engine.structure),
    )
    return drawn(config().engine, within, engine.seed)[0], whole


def _scaled(surface: ErrorSurface, share: float) -> ErrorSurface:
    bumps = tuple(replace(bump, amplitude=share * bump.amplitude) for bump in surface.bumps)
    return replace(surface, coefficients=tuple(share * c for c in surface.coefficients), bumps=bumps)


def driven(
    engine: OwnEngine, piece: tuple[str, float, float], seed: int, scratch: Path, effects: Sequence[Any] = ()
) -> SimulatedLog:
    """Return a drive on the road; effects are those of `simulate`, or anything with `settled` and `on`."""
    cycle = scratch / f"cycle_{seed}.csv"
    _cut(piece, cycle)
    constants, parameters = plant(engine)
    log = simulate(constants, parameters, str(cycle), engine.rate, seed=seed, effects=effects, auxiliary=Auxiliary())
    cycle.unlink()
    return replace(log, channels=_read(engine, parameters, log, seed))


def _read(engine: OwnEngine, parameters: SimulationParameters, log: SimulatedLog, seed: int) -> dict[str, Array]:
    """Return the readings with what this engine's sensors have beyond white noise."""
    channels, step = dict(log.channels), 1.0 / engine.rate
    if engine.variation == "thermocouple":
        channels["T_em"] = channels["T_em"] + lagged(log.truth["T_em"], step, 1.0) - log.truth["T_em"]
    share, tau = engine.colour
    for place, name in enumerate(COLOURED if share else ()):
        stream = np.random.default_rng([seed, 3, place])
        kept = np.exp(-step / tau)
        white = stream.standard_normal(channels[name].size)
        noise = scipy.signal.lfilter(
            [np.sqrt(1.0 - kept**2)], [1.0, -kept], white, zi=[kept * stream.standard_normal()]
        )[0]
        least = getattr(parameters.sensors.quantisation, name)
        channels[name] = np.round((channels[name] + share * getattr(parameters.sensors, name) * noise) / least) * least
    return channels


def write(path: Path, log: SimulatedLog) -> None:
    """Write a log without its truth."""
    write_log(path, {name: values for name, values in log.channels.items() if not name.startswith("ref_")}, log.units)


def prepare(engine: OwnEngine, folder: Path, bank: int, scratch: Path, with_variation: bool = True) -> None:
    """Write what an engine is known from: a bench table or not, and healthy drives."""
    folder.mkdir(parents=True, exist_ok=True)
    known = engine if with_variation else engine.without_variation()
    rng = np.random.default_rng([BANK, bank, 9, engine.number])
    if engine.taught == "bench" and not (folder / "bench.parquet").exists():
        table = bench(*plant(engine), POINTS, engine.seed)
        write_table(folder / "bench.parquet", table.channels, table.units)
    pieces = rng.choice(len(PIECES), HEALTHY_DRIVES, replace=False)
    for number, place in enumerate(pieces):
        path = folder / f"healthy_{number}{'_right' if engine.taught == 'healthy' else ''}.parquet"
        if not path.exists():
            seed = 1000 * (bank % 1_000_000) + 500 + 10 * engine.number + number
            write(path, driven(known, PIECES[place], seed, scratch))


def _cut(piece: tuple[str, float, float], path: Path) -> None:
    """Write the rows of a cycle between two times, its clock from zero."""
    table, begin, end = piece
    with (shipped_folder() / "cycles" / TABLES[table]).open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    kept = [row for row in rows if begin <= float(row[0]) <= end]
    offset = float(kept[0][0])
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *[[str(float(time) - offset), *rest] for time, *rest in kept]])
