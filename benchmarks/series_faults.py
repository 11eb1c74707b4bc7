"""Which faults the balances of what most vehicles log can show: `python benchmarks/series_faults.py [VEHICLES [SEED]]`.

Rules, written before the seed was drawn. A vehicle has constants within the tolerance of `configs/series.toml`, a bench of 100
points, a healthy NEDC behind its calibration, and a map from a healthy FTP75 cold transient, 20 samples a second, with `u_egr` and
`lambda_e` and without `p_em` and `T_em`. On another day it drives the same cycle with a fault from the start, or none, and `trace`
looks at it with the map frozen. Sizes are drawn, signs too:

gain of the sensor 4 to 12 %; offset 0.5 to 2 g/s; lag 0.1 to 0.4 s; leak behind the compressor 10 to 40 mm^2; reading of the intake
pressure 2 to 6 %; filling 4 to 10 % less.

`named`: the fault is what `trace` finds first, or among what it says cannot be told from that. `wrong`: it finds something, and the
fault is neither there nor beside any finding. `silent`: none or unexplained. Drives without fault: any finding is wrong.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from common import configuration, markdown, publish
from series import ROWS, SERIES, drive_of, without

import lpvobs
from lpvobs.io.configuration.config import load_config
from lpvobs.io.logs.bench import write_table
from lpvobs.io.logs.parquet import write_log
from lpvobs.records import Log
from lpvobs.simulation.effects import effect_of, kind_of
from lpvobs.simulation.parameters import ErrorSurface
from lpvobs.simulation.simulate import drawn, simulate
from lpvobs.simulation.stationary import bench

RATE, STEP, POINTS, VEHICLES, SEED = 20.0, 2e-3, 100, 9, 440413
FAULTS = {
    "maf.gain": (0.04, 0.12),
    "maf.offset": (5e-4, 2e-3),
    "maf.lag": (0.1, 0.4),
    "leak.intake": (1e-5, 4e-5),
    "p_im.gain": (0.02, 0.06),
    "eta_vol.factor": (0.04, 0.10),
}
"""Ranges of the sizes; the last two and the gain count from one."""
DONE = Path(__file__).parent.parent / "build" / "series_faults"
UNITS = {name: channel.unit for name, channel in load_config(SERIES)[0].engine_path().channels.items()} | {"time": "s"}


def main(vehicles: int, seed: int) -> None:
    """Print and keep the tables; drives that an earlier run has judged are read from the file of each vehicle."""
    DONE.mkdir(parents=True, exist_ok=True)
    found = []
    for number in range(vehicles):
        file = DONE / f"{seed}_{number}.json"
        if not file.is_file():
            file.write_text(json.dumps(one_vehicle(seed, number)), encoding="utf-8")
        found += json.loads(file.read_text(encoding="utf-8"))
    publish("series_faults", f"Faults in what most vehicles log, vehicles: {vehicles}", tables_of(found), "make series")


def one_vehicle(seed: int, number: int) -> list[dict[str, object]]:
    """Return what `trace` says of each drive of a vehicle."""
    config, (series, _) = configuration(), load_config(SERIES)
    random = np.random.default_rng([seed, number])
    tolerance = {**config.estimate.tolerance, "A_egr_max": series.estimate.tolerance["A_egr_max"]}
    engine = drawn(config.engine, tolerance, int(random.integers(1 << 30)))[0]
    wide = 1.0 + series.estimate.tolerance["dp_0"] * random.uniform(-1.0, 1.0, 2)
    points = replace(config.simulation.setpoints, delta_p=tuple(wide * config.simulation.setpoints.delta_p))
    plant = replace(config.simulation, setpoints=points, step=STEP)
    fuel = 1.0 + series.estimate.tolerance["k_fuel"] * random.uniform(-1.0, 1.0)

    def driven(path: Path, cycle: str, surface: ErrorSurface | None = None, effects: tuple[object, ...] = ()) -> Path:
        made = simulate(engine, plant, cycle, RATE, int(random.integers(1 << 30)), surface, effects=effects)
        log: Log = without(drive_of(made, fuel, random).log, ROWS["lambda beside it"])
        channels = {"time": log.time} | {name: log[name] for name in UNITS if name in log.channels}
        write_log(path, {k: v for k, v in channels.items() if np.isfinite(v).any()}, UNITS)
        return path

    with TemporaryDirectory() as name:
        folder = Path(name)
        table = bench(engine, plant, POINTS, int(random.integers(1 << 30)))
        write_table(folder / "bench.parquet", table.channels, table.units)
        lpvobs.synth_gain(SERIES, out=folder / "gain.h5")
        healthy = driven(folder / "healthy.parquet", "nedc", ErrorSurface("zero"))
        lpvobs.calibrate(
            SERIES, bench=folder / "bench.parquet", healthy=healthy, gain=folder / "gain.h5", out=folder / "engine.h5"
        )
        day = driven(folder / "day.parquet", "ftp75_cold")
        lpvobs.estimate(SERIES, day, folder / "map.h5", gain=folder / "gain.h5", engine=folder / "engine.h5")
        told = []
        for fault in ("", *FAULTS):
            tables = [drawn_fault(fault, random)] if fault else []
            log = driven(folder / f"{fault or 'clean'}.parquet", "ftp75_cold", effects=tuple(map(effect_of, tables)))
            seen = lpvobs.trace(folder / "map.h5", log, freeze_map=True).found
            names = [[item.id, *item.indistinguishable] for item in seen.findings]
            told.append({"fault": fault, "table": tables, "verdict": seen.verdict, "names": names})
            print(number, told[-1], file=sys.stderr)
    return told


def drawn_fault(fault: str, random: np.random.Generator) -> dict[str, object]:
    """Return a fault as a table of `simulate --effects`."""
    size, kind = float(random.uniform(*FAULTS[fault])), kind_of(fault)
    if fault in ("maf.gain", "maf.offset", "p_im.gain"):
        size *= float(random.choice([-1.0, 1.0]))
    return {"id": fault, kind.parameter: 1.0 - size if fault == "eta_vol.factor" else kind.neutral + size}


def judged(drive: dict[str, object]) -> str:
    """Return `named`, `wrong` or `silent`, by the rules above."""
    names = drive["names"] if drive["verdict"] == "effect" else []
    if not names:
        return "silent"
    if drive["fault"] in names[0]:
        return "named"
    return "beside another" if any(drive["fault"] in alike for alike in names) else "wrong"


def tables_of(found: list[dict[str, object]]) -> str:
    """Return how often each fault was named, and what was said."""
    outcomes = ("named", "beside another", "silent", "wrong")
    rows = []
    for fault in (*FAULTS, ""):
        own = [drive for drive in found if drive["fault"] == fault]
        counts = [sum(judged(drive) == outcome for drive in own) for outcome in outcomes]
        alike = sorted({n for d in own if judged(d) == "named" for n in d["names"][0] if n != fault})
        rows.append([fault or "none", str(len(own)), *map(str, counts), ", ".join(alike) or "-"])
    faulty = [judged(drive) for drive in found if drive["fault"]]
    share = 100.0 * faulty.count("named") / max(len(faulty), 1)
    wrong = 100.0 * sum(judged(drive) == "wrong" for drive in found) / max(len(found), 1)
    header = ["fault", "drives", *outcomes, "not told apart from"]
    return (
        markdown(header, rows)
        + f"\n\nNamed: {share:.1f} % of {len(faulty)}. Wrong: {wrong:.1f} % of all {len(found)}.\n"
    )


if __name__ == "__main__":
    numbers = [int(word) for word in sys.argv[1:]]
    main(*(numbers + [VEHICLES, SEED][len(numbers) :]))
