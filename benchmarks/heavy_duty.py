"""The truck engine on its own cycle: map, clean drives, effects that nobody declared: `python benchmarks/heavy_duty.py [SEEDS]`.

Twenty seeds by default. The seed draws the noise and, where constants are drawn, every constant that has a tolerance. Noise alone
changes little, and a few seeds show that.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from common import CONFIG, altered, markdown, publish

import lpvobs
from lpvobs.engines.diesel.constants import DieselEngine
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.io.configuration.config import Config, load_config
from lpvobs.io.logs.parquet import write_log
from lpvobs.io.results.results import read_result
from lpvobs.maps.metrics import best_fit, compare
from lpvobs.simulation.effects import CatalogueEffect
from lpvobs.simulation.simulate import simulate

HEAVY = CONFIG.with_name("heavy-duty.toml")
FEW = 5
DRAWS = 50
FIRST_SEED = 551664
UNDECLARED = (
    CatalogueEffect("maf.lag", 0.1),
    CatalogueEffect("maf.gain", 1.06, onset=600.0),
    CatalogueEffect("leak.intake", 6e-5, onset=300.0),
    CatalogueEffect("egr.area", 0.75),
    CatalogueEffect("compressor.flow", 0.95),
    CatalogueEffect("p_im.gain", 1.02),
)
"""Sizes that a workshop would look for; areas four times those of the car, for four times the flow."""


def drawn(config: Config, seed: int) -> DieselEngine:
    """Return an engine whose constants lie anywhere within their tolerance."""
    rng = np.random.default_rng(seed)
    factors = {name: 1.0 + rng.uniform(-tolerance, tolerance) for name, tolerance in config.estimate.tolerance.items()}
    return altered(config.engine, factors)


def drive(
    path: Path, config: Config, engine: DieselEngine, seed: int, *effects: CatalogueEffect, every: int = 1
) -> Path:
    """Write a WHTC of which every so many of 100 samples a second are recorded."""
    if config.simulation is None:
        raise ValueError("the configuration has no simulation")
    made = simulate(engine, config.simulation, "whtc", seed=seed, effects=effects)
    write_log(path, {name: column[::every] for name, column in made.channels.items()}, made.units)
    return path


def known_exactly(path: Path, config: Config) -> Path:
    """Write the configuration with next to no tolerance of any constant: what is left of the map's error is noise."""
    before, after = HEAVY.read_text(encoding="utf-8").split("[estimate.tolerance]\n")
    names = {**Diesel(config.engine).usual_tolerance, **config.estimate.tolerance}
    tolerance = "\n".join(f"{name} = 1e-7" for name in names)
    path.write_text(f"{before}[estimate.tolerance]\n{tolerance}\n\n{after[after.index('[') :]}", encoding="utf-8")
    return path


def expected(result: Path, log: Path, rng: np.random.Generator) -> float:
    """Return the mean relative error that the covariance of a map promises, %: of maps drawn around the best one on its grid.

    No linear estimate from the same log has a smaller one if noise and tolerances are what they are taken for.
    """
    known = read_result(result)
    fuel, speed, truth = pd.read_parquet(log, columns=["u_delta", "n_e", "ref_delta_W_c"]).to_numpy()[::20].T
    best = best_fit(known.grid, *known.grid.regressors(fuel, speed), truth)
    estimated = np.isfinite(known.theta)
    size, axes = np.linalg.eigh(known.covariance[np.ix_(estimated.ravel(), estimated.ravel())])
    errors = []
    for _ in range(DRAWS):
        theta = np.full(known.theta.shape, np.nan)
        theta[estimated] = best.reshape(known.theta.shape)[estimated] + axes @ (
            np.sqrt(np.maximum(size, 0.0)) * rng.standard_normal(size.size)
        )
        errors.append(100 * compare(known.grid, theta, fuel, speed, truth).mean_relative_error)
    return float(np.mean(errors))


def clean(
    folder: Path, config: Config, gain: Path, seeds: int, exact: bool, every: int = 1, known: Path = HEAVY
) -> list[str]:
    """Return the row of drives on which nothing has happened."""
    errors, floors, promised, verdicts = [], [], [], []
    for seed in range(FIRST_SEED, FIRST_SEED + seeds):
        engine = config.engine if exact else drawn(config, seed)
        log, result = drive(folder / "clean.parquet", config, engine, seed, every=every), folder / "map.h5"
        metrics = lpvobs.estimate(known, log, result, gain=gain).summaries[0].metrics
        if metrics is None:
            raise ValueError("a simulated log has its references")
        errors.append(100 * metrics.mean_relative_error)
        floors.append(100 * metrics.floor_mean_relative_error)
        promised.append(expected(result, log, np.random.default_rng(seed)))
        verdicts.append(lpvobs.trace(result, log).found.verdict)
        print(
            f"seed {seed}: {errors[-1]:.2f} %, promised {promised[-1]:.2f} %, floor {floors[-1]:.2f} %, {verdicts[-1]}",
            file=sys.stderr,
        )
    half = 1.645 * np.std(errors, ddof=1) / np.sqrt(seeds)
    mean = float(np.mean(errors))
    return [
        ("exact" if exact else "drawn within their tolerance")
        + (", and known to be" if known != HEAVY else "")
        + (f", {100 // every} samples a second" if every > 1 else ""),
        f"{mean:.2f} ({mean - half:.2f} to {mean + half:.2f})",
        f"{max(errors):.2f}",
        f"{np.mean(promised):.2f}",
        f"{np.mean(floors):.2f}",
        f"{verdicts.count('none')} of {seeds}",
    ]


def faulty(folder: Path, config: Config, gain: Path) -> list[list[str]]:
    """Return a row for every effect, against the map of a clean drive of the same engine, whose constants are drawn."""
    rows = []
    for seed, effect in enumerate(UNDECLARED, start=FIRST_SEED + 100):
        engine, result = drawn(config, seed), folder / "nominal.h5"
        lpvobs.estimate(HEAVY, drive(folder / "nominal.parquet", config, engine, seed), result, gain=gain)
        log = drive(folder / "faulty.parquet", config, engine, seed + 100, effect)
        found = lpvobs.trace(result, log).found
        named = "; ".join(
            f"{one.id} {p.value:.4g} ({p.ci90[0]:.4g} to {p.ci90[1]:.4g})"
            for one in found.findings
            for p in one.parameters.values()
        )
        rows.append([f"{effect.id} {effect.value:g}", found.verdict, named or "-"])
        print(*rows[-1], file=sys.stderr)
    return rows


def main(seeds: int) -> None:
    """Print and keep the tables."""
    config = load_config(HEAVY)[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        gain = folder / "gain.h5"
        lpvobs.synth_gain(HEAVY, out=gain)
        rows = [
            clean(folder, config, gain, min(seeds, FEW), True, known=known_exactly(folder / "exactly.toml", config)),
            clean(folder, config, gain, min(seeds, FEW), True),
            clean(folder, config, gain, seeds, False),
            clean(folder, config, gain, min(seeds, 2 * FEW), False, 5),
        ]
        effects = faulty(folder, config, gain)
    text = "WHTC at 100 samples a second; mean relative error of the map with the 90 % interval of the mean.\n\n"
    text += markdown(
        ["constants", "error, %", "worst, %", "by its own covariance, %", "floor, %", "`trace`: none"], rows
    )
    text += "\n\n## Effects that nobody declared\n\nAgainst the map of a clean drive; constants drawn within their tolerance.\n\n"
    text += markdown(["effect", "verdict", "named, with 90 % interval"], effects)
    publish(
        "heavy_duty", f"The truck engine, {seeds} seeds from {FIRST_SEED} on", text, "python benchmarks/heavy_duty.py"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
