"""Every method on the same logs with the same metric: `python benchmarks/accuracy.py [SEEDS]`, default ten seeds."""

import sys
import time
from collections.abc import Callable
from dataclasses import asdict, fields, replace

import numpy as np
from common import CYCLES, Drive, configuration, drive, markdown, publish, state_gain
from rivals import curve_over_flow, mean_per_cell

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.io.configuration.config import Config
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import NEGLIGIBLE, compare
from lpvobs.observer.estimate import estimate_default
from lpvobs.observer.parts import StateGain
from lpvobs.observer.rivals import estimate_batch, estimate_ekf, estimate_published
from lpvobs.records import Array

GAMMAS = (200.0, 50.0, 20.0, 5.0, 2.0, 0.5, 0.2, 0.05, 0.02)
Method = Callable[[Drive], Array]


def methods(config: Config, grid: Grid, gain: StateGain) -> dict[str, Method]:
    """Return every method as a function from a drive to a map."""
    engine, settings = Diesel(config.engine), config.estimate
    paper = StateGain(("p_im", "omega_t"), PUBLISHED.L)

    def published(gamma: float) -> Method:
        tuned = replace(config.published, gamma=gamma)
        return lambda d: estimate_published(engine, grid, paper, [d.log], tuned, settings).theta

    return {
        "default": lambda d: estimate_default(engine, grid, gain, [d.log], settings).theta,
        "a) as published, Gamma = 200": published(200.0),
        **{f"b) Gamma = {gamma:g}": published(gamma) for gamma in GAMMAS[1:]},
        "c) extended Kalman filter": lambda d: estimate_ekf(engine, grid, gain, [d.log], config.ekf, settings).theta,
        "d) batch least squares": lambda d: estimate_batch(engine, grid, gain, [d.log], settings).theta,
        "e) mean per cell": lambda d: mean_per_cell(engine, grid, d.log, steady_only=False),
        "f) mean per cell, steady only": lambda d: mean_per_cell(engine, grid, d.log, steady_only=True),
    }


def score(grid: Grid, theta: Array, d: Drive) -> dict[str, float]:
    """Return the metrics of a map along a drive."""
    log = d.log
    return asdict(compare(grid, theta, log["u_delta"], log["n_e"], d.delta_W_c)) | {
        "nodes": float(np.isfinite(theta).sum())
    }


def score_curve(engine: Diesel, d: Drive) -> dict[str, float]:
    """Return the same metrics of the one-dimensional map over the flow."""
    error = curve_over_flow(engine, d.log) - d.delta_W_c
    counted = np.abs(d.delta_W_c) >= NEGLIGIBLE * np.abs(d.delta_W_c).max()
    return {
        "mean_relative_error": float(np.mean(np.abs(error[counted] / d.delta_W_c[counted]))),
        "rms_ratio": float(np.sqrt(np.mean(error**2) / np.mean(d.delta_W_c**2))),
        "bias": float(error.mean()),
        "nodes": 20.0,
        "floor_mean_relative_error": float("nan"),
    }


def main(seeds: int) -> None:
    """Print and keep the table."""
    config = configuration()
    grid, gain, engine = config.grid(), state_gain(config), Diesel(config.engine)
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    for cycle in CYCLES:
        for seed in range(1, seeds + 1):
            d = drive(config, cycle, seed)
            for name, method in methods(config, grid, gain).items():
                if seed == 1:
                    method(d)  # compiles
                begin = time.perf_counter()
                theta = method(d)
                took = (time.perf_counter() - begin) / len(d.log)
                found.setdefault((cycle, name), []).append(score(grid, theta, d) | {"ns": 1e9 * took})
            begin = time.perf_counter()
            curve = score_curve(engine, d)
            curve["ns"] = 1e9 * (time.perf_counter() - begin) / len(d.log)
            found.setdefault((cycle, "g) curve over the flow"), []).append(curve)
            print(f"{cycle}, seed {seed} of {seeds}", file=sys.stderr)
    text = "\n\n".join([*(_table(found, cycle) for cycle in CYCLES), _without_noise(config, grid, gain)])
    publish("accuracy", f"Methods on the same logs, seeds 1 to {seeds}", text)


def _without_noise(config: Config, grid: Grid, gain: StateGain) -> str:
    """Return the section of the paper's situation: exact constants, and sensors without noise."""
    sensors = config.simulation.sensors  # type: ignore[union-attr]
    silent = replace(
        sensors, **{item.name: 0.0 for item in fields(sensors) if isinstance(getattr(sensors, item.name), float)}
    )
    quiet = replace(config, simulation=replace(config.simulation, sensors=silent))
    rows = []
    for cycle, title in CYCLES.items():
        d = drive(quiet, cycle, 1)
        chosen = ("default", "a) as published, Gamma = 200")
        errors = [score(grid, methods(config, grid, gain)[name](d), d)["mean_relative_error"] for name in chosen]
        rows.append(
            [title, f"{100 * PUBLISHED.errors[cycle]:.2f}", *(f"{100 * error:.2f}" for error in reversed(errors))]
        )
    header = ["mean relative error, %", "paper", "as published", "default"]
    return "## Without sensor noise\n\n" + markdown(header, rows)


def _table(found: dict[tuple[str, str], list[dict[str, float]]], cycle: str) -> str:
    floor = 100 * np.mean([run["floor_mean_relative_error"] for run in found[cycle, "default"]])
    rows = []
    tuned = [name for place, name in found if place == cycle and name.startswith("b)")]
    best_name = min(tuned, key=lambda name: np.mean([run["mean_relative_error"] for run in found[cycle, name]]))
    for (place, name), runs in found.items():
        if place != cycle or (name.startswith("b)") and name != best_name):
            continue
        mre = 100 * np.array([run["mean_relative_error"] for run in runs])
        ratio = 100 * np.array([run["rms_ratio"] for run in runs])
        bias = 1e3 * np.array([run["bias"] for run in runs])
        rows.append(
            [
                name,
                f"{mre.mean():.2f} ({mre.min():.2f} to {mre.max():.2f})",
                f"{ratio.mean():.2f} ({ratio.min():.2f} to {ratio.max():.2f})",
                f"{bias.mean():+.3f}",
                f"{np.mean([run['nodes'] for run in runs]):.0f}",
                f"{np.median([run['ns'] for run in runs]):.0f}",
            ]
        )
    header = ["method", "mean relative error, %", "rms ratio, %", "bias, g/s", "nodes", "ns per sample"]
    head = f"## {CYCLES[cycle]}\n\nPaper: {100 * PUBLISHED.errors[cycle]:.2f} %. Floor of the grid: {floor:.2f} %.\n\n"
    return head + markdown(header, rows)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
