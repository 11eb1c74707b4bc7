"""A simulated fleet for `fleet.py`: vehicles of one type whose engines and sensors differ, two drives a month for a year."""

import csv
import datetime
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from common import configuration

from lpvobs.io.logs.parquet import write_log
from lpvobs.simulation.cycles import TABLES, shipped_folder
from lpvobs.simulation.instruments import measure
from lpvobs.simulation.parameters import ErrorSurface
from lpvobs.simulation.simulate import UNITS, drawn, simulate

VEHICLES, MONTHS, A_MONTH = 20, 12, 2
FIRST, MONTH = datetime.date(2025, 1, 1), 365.25 / 12.0
SECONDS, RATE, ROUTES = 200.0, 20.0, 6
SHORT, PIECES, MINUTE, APART = 5000, 11, 60.0, 13.0
"""Short logs, how many are cut from a drive, [s] of each, and between the begins of neighbours."""
CYCLES = ("ftp75", "wltc", "nedc", "etc")
"""Drives are stretches of these that begin at rest, six a vehicle, each driven again and again with noise of its own."""
KINDS = ("drift",) * 3 + ("step",) * 2 + ("new sensor",)
"""Of the first vehicles; the others are healthy."""
LEVEL, GAIN, BUMP = 0.5e-3, 0.01, 0.2
"""Standard deviations between vehicles: [kg/s], of the reading, of the bump's height."""
DRIFT, STEP = (0.003, 0.01), (0.015, 0.04)
"""A month, and at once: size of the change of the sensor's gain, of either sign."""
SPARE = 0.003
"""Standard deviation of the gain of a new sensor about that of the old one when it was new."""


@dataclass(frozen=True)
class Vehicle:
    """What is true of a vehicle."""

    name: str
    kind: str  # drift, step, new sensor or healthy
    change: float  # [months] since the first, when the step comes; 0 for none
    slope: float  # of the gain, a month
    level: float  # [kg/s] beyond the type
    bump: float  # factor on the type's
    start: float  # gain of the sensor when new
    size: float  # of the step, relative

    def gain(self, months: float) -> float:
        """Return the gain of the sensor after some time."""
        if self.change and months >= self.change:
            return 1.0 + self.start + self.size
        return 1.0 + self.start + self.slope * months


def fleet(seed: int) -> list[Vehicle]:
    """Return a fleet drawn from a seed."""
    rng = np.random.default_rng([seed, 18])
    found = []
    for number in range(VEHICLES):
        kind = KINDS[number] if number < len(KINDS) else "healthy"
        start, level, bump = rng.normal(0.0, (GAIN, LEVEL, BUMP))
        sign = rng.choice((-1.0, 1.0))
        slope = sign * rng.uniform(*DRIFT) if kind in ("drift", "new sensor") else 0.0
        change = float(rng.integers(3, MONTHS - 2)) if kind in ("step", "new sensor") else 0.0
        size = sign * rng.uniform(*STEP) if kind == "step" else rng.normal(0.0, SPARE) if kind == "new sensor" else 0.0
        found.append(Vehicle(f"V{number:02}", kind, change, slope, level, 1.0 + bump, start, size))
    return found


def surface_of(type_of: ErrorSurface, vehicle: Vehicle) -> ErrorSurface:
    """Return the error of a vehicle's sensor when its gain is one."""
    coefficients = (*type_of.coefficients[:-1], type_of.coefficients[-1] + vehicle.level)
    bumps = tuple(replace(each, amplitude=each.amplitude * vehicle.bump) for each in type_of.bumps)
    return replace(type_of, coefficients=coefficients, bumps=bumps)


def record(folder: Path, seed: int, only: slice = slice(None)) -> None:
    """Drive a fleet; every log says whose it is and when it was driven."""
    config = configuration()
    assert config.simulation is not None
    for number, vehicle in list(enumerate(fleet(seed)))[only]:
        engine = drawn(
            config.engine, config.estimate.of_engine(config.engine_path().usual_tolerance).tolerance, number
        )[0]
        surface = surface_of(config.simulation.surface, vehicle)
        (folder / vehicle.name).mkdir(parents=True, exist_ok=True)
        if len(list((folder / vehicle.name).glob("*.parquet"))) == MONTHS * A_MONTH:  # by a run before this one
            continue
        made = []
        for route in range(ROUTES):
            rng = np.random.default_rng([seed, number, route])
            cycle = stretch(folder / f"{vehicle.name}.csv", rng)
            made.append(simulate(engine, config.simulation, str(cycle), RATE, route + 1, surface))
        for drive in range(MONTHS * A_MONTH):
            month, which = divmod(drive, A_MONTH)
            rng = np.random.default_rng([seed, number, ROUTES + drive])
            target = folder / vehicle.name / f"2025-{month + 1:02}-{'ab'[which]}.parquet"
            route = made[int(rng.integers(ROUTES))]
            shown = {name: route.truth[name] for name in UNITS if name in route.truth}
            noise, day = int(rng.integers(2**31)), int(rng.integers(14 * which + 1, 14 * which + 15))
            date = datetime.date(2025, month + 1, day)
            shown["W_maf"] = shown["W_maf"] * vehicle.gain((date - FIRST).days / MONTH)
            sensors = config.simulation.sensors
            readings = {name: measure(name, values, sensors, noise) for name, values in shown.items()}
            channels = dict(route.channels) | readings
            origin = {"vehicle": vehicle.name, "engine": "diesel", "date": date.isoformat()}
            write_log(target, channels, route.units, origin)


def cut(folder: Path, target: Path) -> None:
    """Cut the drives into logs of a minute, those of a drive for different vehicles, until there are enough."""
    for count, path in enumerate(sorted(folder.glob("V*/*.parquet"))):
        table = pq.read_table(path)
        for number in range(min(PIECES, SHORT - count * PIECES)):
            name, begin = f"{path.parent.name}-{number:02}", int(number * APART * RATE)
            (target / name).mkdir(parents=True, exist_ok=True)
            piece = table.slice(begin, int(MINUTE * RATE))
            metadata = {**table.schema.metadata, b"vehicle": name.encode()}
            pq.write_table(piece.replace_schema_metadata(metadata), target / name / path.name)


def stretch(path: Path, rng: np.random.Generator) -> Path:
    """Write a part of a cycle that begins at rest."""
    with (shipped_folder() / "cycles" / TABLES[str(rng.choice(CYCLES))]).open(encoding="utf-8") as table:
        header, *rows = csv.reader(table)
    times = [float(row[0]) for row in rows]
    rests = [i for i, row in enumerate(rows) if float(row[1]) == 0.0 and times[i] + SECONDS <= times[-1]]
    first = int(rng.choice(rests))
    since = [time - times[first] for time in times]
    kept = [[f"{time:g}", *row[1:]] for time, row in zip(since, rows, strict=True) if 0 <= time <= SECONDS]
    with path.open("w", encoding="utf-8", newline="") as out:
        csv.writer(out).writerows([header, *kept])
    return path
