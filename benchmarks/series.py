"""What an engine without turbine speed and exhaust pressure can tell: `python benchmarks/series.py [DRAWS]`.

Each draw drives the FTP75's cold transient, 20 samples a second. `same structure`: the plant's constants are drawn within the
tolerance of `configs/series.toml`, as are the pressure difference that its vanes hold and the scale of the logged fuel. `another
structure`: all forms of `[simulation.structure]`, and a bench of 100 points behind every row. Behind the last two rows there is
in both cases a bench and a healthy drive, an NEDC of another day whose sensor is right; behind that of the shut valve only where
the structure is another one. The full diesel has all channels; the
bench table is speed-density with the EGR flow of exhaust pressure, as in `engine_as_it_is.py`. Lambda is that of the gas in the
exhaust manifold behind a probe of 0.3 s with 0.5 % of noise.

Judged as in `engine_as_it_is.py`, over the nodes that each row estimates: the error over the mean air flow, and the share of nodes
whose 90 % interval holds the node of the best bilinear map; further, the nodes over those that the drive informs.
"""

import json
import sys
from collections import defaultdict
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from common import Drive, configuration, markdown, publish, state_gain
from engine_as_it_is import POINTS, Judged, Setting, _mean, from_point, judged, on_calibrated, speed_density

from lpvobs.calibration.bench import bench_table
from lpvobs.calibration.fit import calibrated, taught
from lpvobs.engines.base import AirPath
from lpvobs.engines.series.flows import SHUT
from lpvobs.engines.unknowns import Unknowns, unknowns_of
from lpvobs.io.configuration.config import load_config
from lpvobs.observer.estimate import Point
from lpvobs.records import Array, Defects, Log
from lpvobs.simulation.parameters import ErrorSurface
from lpvobs.simulation.simulate import SimulatedLog, drawn, simulate
from lpvobs.simulation.stationary import BenchTable, bench

SERIES = Path(__file__).parent.parent / "configs" / "series.toml"
RATE, PROBE, PROBE_NOISE = 20.0, 0.3, 0.005
FIRST_SEED = 7301  # numerics were looked at on 900 and 901
CASES = ("same structure", "another structure")
DONE = Path(__file__).parent.parent / "build" / "series"
ROWS = {
    "full diesel": (),
    "bench table": (),
    "EGR shut only": ("p_em", "T_em", "lambda_e"),
    "EGR from bench and healthy drive": ("p_em", "T_em", "lambda_e"),
    "lambda beside it": ("p_em", "T_em"),
}
"""What is compared, and the channels that its log lacks."""


def main(draws: int) -> None:
    """Print and keep the table; draws that an earlier run has done are read from the file of each."""
    found: dict[tuple[str, str], list[tuple[Judged, float]]] = defaultdict(list)
    DONE.mkdir(parents=True, exist_ok=True)
    for seed in range(FIRST_SEED, FIRST_SEED + draws):
        for case in CASES:
            file = DONE / f"{seed}_{case.split()[0]}.json"
            if not file.is_file():
                rows = one_draw(case == CASES[1], seed)
                file.write_text(json.dumps([(row, vars(one), share) for row, (one, share) in rows]), encoding="utf-8")
            for row, one, share in json.loads(file.read_text(encoding="utf-8")):
                found[case, row].append((Judged(**one), share))
    publish("series", f"What most vehicles log, draws: {draws}", table_of(found), "make series")


def table_of(found: dict[tuple[str, str], list[tuple[Judged, float]]]) -> str:
    """Return the rows, means over draws."""
    rows = [
        [
            case,
            row,
            mean([one.relative for one, _ in each]),
            mean([one.of_air for one, _ in each]),
            mean([100.0 * share for _, share in each]),
            "-" if row == "bench table" else mean([one.coverage for one, _ in each]),
        ]
        for (case, row), each in found.items()
    ]
    header = ["plant", "row", "mean relative error, %", "of the air flow, %", "nodes told, %", "coverage, %"]
    return markdown(header, rows)


def mean(values: list[float]) -> str:
    """Return a mean with the 90 % interval of it, a single value as it is."""
    return _mean(values) if len(values) > 1 else f"{values[0]:.2f}"


def one_draw(other: bool, seed: int) -> list[tuple[str, tuple[Judged, float]]]:
    """Return how each row does on one drive, and the share of nodes that it tells."""
    config, (series, _) = configuration(), load_config(SERIES)
    setting = Setting(config, config.grid(), state_gain(config))
    ours = Setting(series, series.grid(), state_gain(series))
    random = np.random.default_rng(seed)
    simulation, engine, fuel = config.simulation, config.engine, 1.0
    if other:
        forms = dict.fromkeys((item.name for item in fields(simulation.structure)), 1.0)
        simulation = replace(simulation, structure=replace(simulation.structure, **forms))
    else:
        tolerance = {**config.estimate.tolerance, "A_egr_max": series.estimate.tolerance["A_egr_max"]}
        engine = drawn(engine, tolerance, seed)[0]
        wide = 1.0 + series.estimate.tolerance["dp_0"] * random.uniform(-1.0, 1.0, 2)
        points = replace(simulation.setpoints, delta_p=tuple(wide * simulation.setpoints.delta_p))
        simulation = replace(simulation, setpoints=points)
        fuel = 1.0 + series.estimate.tolerance["k_fuel"] * random.uniform(-1.0, 1.0)
    made = simulate(engine, simulation, "ftp75_cold", RATE, seed)
    d = drive_of(made, fuel, random)
    table = bench(engine, simulation, POINTS, seed)
    full = on_calibrated(setting, table, d) if other else from_point(setting, start_of(setting), d)
    told = [
        ("full diesel", judged(setting.grid, full.theta, full.covariance, full.supported, d), 1.0),
        ("bench table", judged(setting.grid, speed_density(setting, table, d), None, full.supported, d), 1.0),
    ]
    made_healthy = simulate(engine, simulation, "nedc", RATE, seed + 1000, ErrorSurface("zero"))
    healthy = without(drive_of(made_healthy, fuel, random).log, ROWS["lambda beside it"])
    known = taught(calibrated_from(ours, table), ours.grid, ours.gain, [healthy], lambda _: None).unknowns
    learned = known_from(ours, known)
    for row, lacks in list(ROWS.items())[2:]:
        log, point = without(d.log, lacks), learned
        if row == "EGR shut only":
            log, point = shut_only(log), learned if other else start_of(ours)
        map_ = from_point(ours, point, replace(d, log=log))
        share = float(map_.supported.sum() / full.supported.sum())
        told.append((row, judged(ours.grid, map_.theta, map_.covariance, map_.supported, d), share))
    return [(row, (one, share)) for row, one, share in told]


def start_of(setting: Setting) -> Point:
    """Return the engine as configured."""
    path: AirPath = setting.config.engine_path()
    return Point(path, setting.config.estimate.of_engine(path.usual_tolerance))


def calibrated_from(setting: Setting, table: BenchTable) -> Point:
    """Return the engine as its bench shows it."""
    start = start_of(setting)
    prior = unknowns_of(start.settings.tolerance, start.configured.components)
    known = calibrated(start.configured, prior, [bench_table(start.configured, table.channels)]).unknowns
    return known_from(setting, known)


def known_from(setting: Setting, known: Unknowns) -> Point:
    """Return the engine as a calibration knows it."""
    deviation = dict(zip(known.constants, known.mean.tolist(), strict=False))
    return replace(start_of(setting), deviation=deviation, known=known)


def without(log: Log, lacks: tuple[str, ...]) -> Log:
    """Return a log that lacks channels."""
    return replace(log, channels={**log.channels, **dict.fromkeys(lacks, np.full(len(log), np.nan))})


def shut_only(log: Log) -> Log:
    """Return a log whose valve's position counts where it is shut alone."""
    shut = np.where(log["u_egr"] < SHUT, log["u_egr"], np.nan)
    return replace(log, channels={**log.channels, "u_egr": shut})


def drive_of(made: SimulatedLog, fuel: float, random: np.random.Generator) -> Drive:
    """Return the log with lambda; it says `fuel` times what is injected."""
    channels = dict(made.channels)
    time = channels.pop("time")
    channels["u_delta"] = fuel * channels["u_delta"]
    channels["lambda_e"] = probe(made.truth) * (1.0 + PROBE_NOISE * random.standard_normal(time.size))
    log = Log("ftp75_cold", "", time, channels, {}, ((0, time.size),), np.arange(time.size), Defects(time.size))
    return Drive(log, channels["ref_delta_W_c"], made.truth)


def probe(truth: dict[str, Array], X_O: float = 0.2314, L: float = 14.57) -> Array:
    """Return lambda as a probe shows it: oxygen in both manifolds, mixed, and the probe's own lag."""
    steps, still = 10, 1.0 / RATE / 10
    W_f = 4.0 * truth["n_e"] * np.maximum(truth["u_delta"], 0.0) * 1e-6 / 120.0
    m_im = truth["p_im"] * 5e-3 / (287.0 * truth["T_im"])
    m_em = truth["p_em"] * 1.5e-3 / (286.0 * truth["T_em"])
    X_im = X_em = X_O
    shown, out = 5.0, np.empty(W_f.size)
    rows = np.column_stack([truth["W_c"], truth["W_egr"], truth["W_ei"], W_f, m_im, m_em]).tolist()
    for k, (W_c, W_egr, W_ei, fuel, inside, behind) in enumerate(rows):
        for _ in range(steps):
            X_im += still / inside * (max(W_egr, 0.0) * (X_em - X_im) + W_c * (X_O - X_im))
            leaves = W_ei + fuel
            X_em += still / behind * leaves * (max(W_ei * X_im - fuel * L * X_O, 0.0) / leaves - X_em)
        x = min(X_em, X_O - 1e-3)
        shown += (1.0 / RATE / PROBE) * (min((X_O * L + x) / (L * (X_O - x)), 20.0) - shown)
        out[k] = shown
    return out


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
