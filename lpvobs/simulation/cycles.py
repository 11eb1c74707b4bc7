"""Drive cycles: the shipped tables and a user's own.

A speed cycle prescribes the vehicle's speed, an engine cycle the engine's normalised speed and torque, second by second.
"""

import csv
import difflib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lpvobs.errors import UsageError
from lpvobs.records import Array

TABLES = {
    "etc": "etc_surrogate.csv", "etc_part1": "etc_surrogate.csv", "ftp75": "ftp75.csv", "ftp75_cold": "ftp75.csv",
    "nedc": "nedc.csv", "whtc": "whtc.csv", "wltc": "wltc_class3b.csv",
}  # fmt: skip
ENDS = {"etc_part1": 600.0, "ftp75_cold": 505.0}  # [s]; cycles that are the beginning of a table
SPEED_COLUMNS = ("time_s", "speed_kmh")
ENGINE_COLUMNS = ("time_s", "speed_norm_pct", "torque_norm_pct", "motoring")
REMEDY = "give the name of a cycle or a CSV table"
LONGEST = 1e5  # [s], more than a day of driving: beyond that the time column is not in seconds
LARGEST = 2**26  # [bytes] of a table, ten times what a day at one row per second takes


@dataclass(frozen=True)
class SpeedCycle:
    """Vehicle speed over time."""

    time: Array  # (M,) [s], increasing from zero
    speed: Array  # (M,) [m/s]
    gear: NDArray[np.int64]  # (M,) prescribed gear from 1, 0 for neutral; below zero the driver chooses it
    engaged: NDArray[np.bool_]  # (M,) whether the clutch may transmit; a change of gear opens it all the same


@dataclass(frozen=True)
class EngineCycle:
    """Normalised engine speed and torque over time."""

    time: Array  # (M,) [s], increasing from zero
    speed: Array  # (M,) [%] between idle and reference speed
    torque: Array  # (M,) [%] of the full load at that speed
    motoring: NDArray[np.bool_]  # (M,) no fuel
    world_harmonised: bool  # whether the speed is normalised as in the WHTC; otherwise as in the ETC


def shipped_folder(name: str = "data") -> Path:
    """Return a folder that is shipped: inside the package where it is installed, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    return package / name if (package / name).is_dir() else package.parent / name


def load_cycle(name: str) -> SpeedCycle | EngineCycle:
    """Return a cycle by its name, or from the path of a CSV table, whose columns say which kind it is.

    Raises UsageError if there is none of this name, or the table cannot be read, lacks a column, or holds something that is not a
    rising time or a finite number.
    """
    own = name.lower().endswith(".csv")
    if not own and name not in TABLES:
        near = difflib.get_close_matches(name, TABLES, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"expected one of {', '.join(TABLES)}."
        raise UsageError(f"--cycle {name}: unknown cycle; {hint} A path to a table of your own must end in .csv")
    path = Path(name) if own else shipped_folder() / "cycles" / TABLES[name]
    try:
        return _cycle_of(_columns(path), ENDS.get(name, np.inf), world_harmonised=name == "whtc")
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def _cycle_of(columns: dict[str, list[str]], end: float, world_harmonised: bool) -> SpeedCycle | EngineCycle:
    """Return the cycle in the columns of a table up to a time [s]."""
    engine = set(columns) >= set(ENGINE_COLUMNS)
    if not (engine or set(columns) >= set(SPEED_COLUMNS)):
        expected = f"{', '.join(SPEED_COLUMNS)} (speed cycle) or {', '.join(ENGINE_COLUMNS)} (engine cycle)"
        raise UsageError(f"the table has the columns {', '.join(columns)[:120]}; expected {expected}")
    time = _numbers(columns, "time_s")
    if time.size < 2 or not (np.diff(time) > 0).all():
        raise UsageError("column 'time_s' must rise from row to row over at least two rows; sort or correct the rows")
    time = time - time[0]
    if time[-1] > LONGEST:
        said = f"column 'time_s' spans {time[-1]:g} s, expected at most {LONGEST:g} s"
        raise UsageError(f"{said}; check that it is in seconds")
    keep = time <= end
    if engine:
        # no torque where the table says motoring and, as regulations do, leaves the torque open
        torques = zip(columns["torque_norm_pct"], columns["motoring"], strict=True)
        columns["torque_norm_pct"] = [w if w.strip() or driven.strip() != "1" else "0" for w, driven in torques]
        speed = _numbers(columns, "speed_norm_pct", -20.0, 150.0)
        torque = _numbers(columns, "torque_norm_pct", -100.0, 120.0)
        still = (_numbers(columns, "motoring") != 0.0) | (torque < 0.0)
        return EngineCycle(time[keep], speed[keep], torque[keep], still[keep], world_harmonised)
    speed = _numbers(columns, "speed_kmh", 0.0, 300.0)
    gear, engaged = np.full(time.size, -1), np.ones(time.size, dtype=bool)
    if "gear" in columns and "clutch" in columns:
        gear = np.maximum(_numbers(columns, "gear").astype(np.int64), 0)
        engaged = np.array([text.strip() in ("engaged", "gear_change") for text in columns["clutch"]])
    return SpeedCycle(time[keep], speed[keep] / 3.6, gear[keep], engaged[keep])


def _columns(path: Path) -> dict[str, list[str]]:
    """Return the columns of a CSV file with a header, as text."""
    if path.exists() and not (path.is_file() and path.stat().st_size <= LARGEST):
        raise UsageError(f"this is not a file, or it is larger than {LARGEST} bytes; {REMEDY}")
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            header, *rows = [row for row in csv.reader(stream) if row]
    except OSError as error:
        raise UsageError(f"the file cannot be read ({error.strerror}); {REMEDY}") from None
    except (ValueError, csv.Error):
        raise UsageError("this is not a CSV table with a header line; see data/cycles for examples") from None
    short = next((number for number, row in enumerate(rows, 2) if len(row) != len(header)), None)
    if short is not None:
        raise UsageError(f"row {short} has more or fewer fields than the {len(header)} of the header; correct that row")
    return {name.strip(): [row[index] for row in rows] for index, name in enumerate(header)}


def _numbers(columns: dict[str, list[str]], name: str, low: float = -np.inf, high: float = np.inf) -> Array:
    """Return one column as finite numbers within limits."""
    values = np.empty(len(columns[name]))
    for row, text in enumerate(columns[name]):
        try:
            values[row] = float(text)
        except ValueError:
            values[row] = np.nan
        if not np.isfinite(values[row]):
            raise UsageError(f"column '{name}', row {row + 2}: '{text[:20]}' is not a finite number; correct it")
        if not low <= values[row] <= high:
            said = f"column '{name}', row {row + 2}: {values[row]:g} is outside the range {low:g} to {high:g}"
            raise UsageError(f"{said}; check the column's unit")
    return values
