"""The throttled engine in the bank: stretches of a healthy recording of a real one, altered.

The recording is the healthy WLTP of the LiU-ICE benchmark (`wltp_NF.csv`, not part of this project), in the folder `liu-ice` of
the one that LPVOBS_MEASURED_DIR names. The engine is learned from the recording without the stretch that is judged. A day is
drawn, too: levels of sensors move as they do between healthy recordings of this engine.
"""

import os
from functools import cache
from pathlib import Path

import numpy as np
from alter import Array, Drive, Filling, Signals, filling_of
from draw import (
    FACTOR,
    LESS,
    PLAIN,
    SIGNED,
    Case,
    Drawn,
    Engine,
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

from lpvobs.io.logs.parquet import write_log

MEASURED = "LPVOBS_MEASURED_DIR"
RECORDING = "wltp_NF"
END = 1480.0
"""[s], where the motorway part of the recording begins: it is the only one, so it is learned from and never judged."""
SHORTEST, LONGEST = 600.0, 1000.0
"""[s] that are judged: enough for an onset with driving before and behind it, and most of the recording left to learn from."""
SIZES = {
    "maf.gain": Size("factor", 0.05, 0.25, FACTOR),
    "maf.offset": Size("offset", 5e-4, 3e-3, SIGNED),
    "maf.lag": Size("tau", 0.2, 1.0, PLAIN),
    "maf.delay": Size("delay", 0.2, 1.0, PLAIN),
    "maf.drift": Size("rate", 1e-4, 4e-4, SIGNED),
    "maf.contamination": Size("coefficient", 0.05, 0.2, PLAIN),
    "leak.intake": Size("area", 1.5e-6, 8e-6, PLAIN),
    "eta_vol.factor": Size("factor", 0.05, 0.15, LESS),
    "p_im.gain": Size("factor", 0.04, 0.2, FACTOR),
    "p_im.offset": Size("offset", 1500.0, 6000.0, SIGNED),
    "p_ic.gain": Size("factor", 0.02, 0.12, FACTOR),
    "p_ic.offset": Size("offset", 2000.0, 10000.0, SIGNED),
    "alpha_th.offset": Size("offset", 0.5, 2.0, SIGNED),
    "u_delta.gain": Size("factor", 0.06, 0.2, FACTOR),
}
"""Left out: an inlet leak, which on any one engine is a gain of the sensor; the air's temperature, which moves by 4 K; backflow, of
which a throttled engine knows nothing."""
DAY = {"flow": 0.015, "fuel": 0.02, "opening": 0.25, "p_im": 300.0, "p_ic": 300.0}
"""What levels move by from day to day at most, either way: shares of the two readings, [%], [Pa], [Pa]. Healthy runs differ by
1.5 % of flow, and the opening by 0.26 %: the record of the data, and the time before the faults of the other recordings."""
MOVES = {"T_coolant": 40.0, "humidity": 10.0, "ac_switch": 1.0}
"""Auxiliary channels, made up, with what they move by [K, %, 1]: the benchmark logs none."""
COLUMNS = {
    "p_ic": ("intercooler_pressure", 1.0, "Pa"),
    "T_ic": ("intercooler_temperature", 1.0, "K"),
    "p_im": ("intake_manifold_pressure", 1.0, "Pa"),
    "W_maf": ("air_mass_flow", 1.0, "kg/s"),
    "n_e": ("engine_speed", 30.0 / np.pi, "rpm"),
    "alpha_th": ("throttle_position", 1.0, "%"),
    "u_wg": ("wastegate_position", 1.0, "1"),
    "m_f": ("injected_fuel_mass", 1.0, "1"),
    "p_amb": ("ambient_pressure", 1.0, "Pa"),
    "T_amb": ("ambient_temperature", 1.0, "K"),
}
"""Column of the recording, factor to the unit, unit."""
UNITS = {name: unit for name, (_, _, unit) in COLUMNS.items()}
UNITS |= {"time": "s", "T_coolant": "K", "humidity": "%", "ac_switch": "1"}


def draw(bank: int, number: int) -> Case:
    """Return the case of a number."""
    rng, kind = generator(bank, number)
    length = rng.uniform(SHORTEST, LONGEST)
    begin = round(float(rng.uniform(0.0, END - length)), 1)
    end = round(begin + float(length), 1)
    healthy = {name: float(most * rng.uniform(-1.0, 1.0)) for name, most in DAY.items()}
    effects = {
        "clean": lambda: [],
        "single": lambda: [_catalogue(rng, turn(SIZES, number), length)],
        "pair": lambda: [_catalogue(rng, id_, length) for id_ in two(rng, SIZES)],
        "channel": lambda: [channel(rng, MOVES, (8e-4, 2.5e-3), (0.06, 0.15))],
        "unlogged": lambda: [unlogged(rng, length, (1e-3, 3e-3), (0.07, 0.2))],
    }[kind]()
    rest = (f"{RECORDING} without", begin, end)
    return Case(number, kind, (RECORDING, begin, end), rest, seed_of(bank, number), healthy, effects)


def _catalogue(rng: np.random.Generator, id_: str, length: float) -> Drawn:
    return sized(rng, id_, SIZES[id_]) | (interval(rng, length) if rng.random() < 0.6 else {})


def missing() -> str:
    """Return why there are no drives of this engine, empty if there are."""
    folder = os.environ.get(MEASURED, "")
    if not folder:
        return f"{MEASURED} is not set: no recording of this engine to alter"
    path = _path()
    return "" if path.exists() else f"{path}: is not there: no recording of this engine to alter"


def record(case: Case, path: Path, with_effects: bool) -> None:
    """Write the altered stretch, and the rest of the recording as it is."""
    time, signals = _recorded()
    signals = signals | auxiliary(time, case.seed)
    judged = (time >= case.piece[1]) & (time < case.piece[2])
    _write(path.with_suffix(".nominal.parquet"), time[~judged], {name: v[~judged] for name, v in signals.items()})
    own = time[judged] - time[judged][0]
    drive = Drive(own, {name: values[judged] for name, values in signals.items()}, _filling())
    _write(path, own, on_a_day(drive.altered(case.effects if with_effects else []), case.healthy))


def on_a_day(x: Signals, day: dict[str, float]) -> Signals:
    """Return the readings of a day."""
    return x | {
        "W_maf": x["W_maf"] * (1.0 + day["flow"]),
        "m_f": x["m_f"] * (1.0 + day["fuel"]),
        "alpha_th": x["alpha_th"] + day["opening"],
        "p_im": x["p_im"] + day["p_im"],
        "p_ic": x["p_ic"] + day["p_ic"],
    }


def auxiliary(time: Array, seed: int) -> Signals:
    """Return channels that go with nothing on this engine: a warm-up with its thermostat, damp air, a switch."""
    rng = np.random.default_rng([seed, 1])
    since, step = time - time[0], float(np.median(np.diff(time)))
    warm = 363.0 - rng.uniform(20.0, 60.0) * np.exp(-since / rng.uniform(150.0, 300.0))
    phase = 2.0 * np.pi * since / rng.uniform(70.0, 140.0) + rng.uniform(0.0, 2.0 * np.pi)
    damp = np.cumsum(rng.normal(0.0, np.sqrt(step) * 0.5, time.size))
    switched = np.cumsum(rng.random(time.size) < step / 40.0) % 2  # 40 s on, 40 s off, on average
    return {
        "T_coolant": warm + 4.0 * np.sin(phase) + rng.normal(0.0, 0.1, time.size),
        "humidity": 45.0 + damp - damp.mean(),
        "ac_switch": switched.astype(float),
    }


@cache
def _recorded() -> tuple[Array, Signals]:
    table = np.genfromtxt(_path(), delimiter=",", names=True)
    return table["time"], {name: factor * table[column] for name, (column, factor, _) in COLUMNS.items()}


@cache
def _filling() -> Filling:
    return filling_of(_recorded()[1])


def _path() -> Path:
    return Path(os.environ[MEASURED]) / "liu-ice" / f"{RECORDING}.csv"


def _write(path: Path, time: Array, signals: Signals) -> None:
    write_log(path, {"time": time, **signals}, UNITS)


THROTTLED = Engine("throttled", "liu-ice.toml", 90, SIZES, draw, record, missing)
