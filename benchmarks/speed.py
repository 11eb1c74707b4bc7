"""Time per sample of every kernel, of the rivals, and of the command from shell to shell: `python benchmarks/speed.py [TREE]`.

TREE is another state of these sources, whose kernels are timed in turn with these.
Everything that is compared is timed in one run, in turn, and the least of several times counts: on a shared machine the others
measure its other users.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict
from io import StringIO
from pathlib import Path

import numpy as np
from common import CONFIG, configuration, drive, markdown, publish, state_gain
from watch import Watched, watch

from lpvobs.cli.main import app
from lpvobs.engines.base import Trajectory
from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.io.configuration.config import Config
from lpvobs.io.logs.parquet import write_log
from lpvobs.maps.grid import Grid
from lpvobs.maps.metrics import compare
from lpvobs.observer import ekf
from lpvobs.observer.estimate import Point, calmed, estimate_default
from lpvobs.observer.parts import inform, operating_point
from lpvobs.observer.recursion import observe
from lpvobs.observer.rivals import estimate_batch, estimate_ekf
from lpvobs.observer.settings import EstimateSettings
from lpvobs.observer.smoothing import BLOCK
from lpvobs.observer.step import Sample, local_step
from lpvobs.observer.windows import Columns, no_moments
from lpvobs.records import Array, Log
from lpvobs.simulation.simulate import simulate

ROUNDS = 7
TURNS = 2
CYCLES = ("etc", "ftp75", "nedc")
SMALL = Grid(np.arange(0.0, 57.0, 4.0), np.arange(0.0, 3001.0, 250.0))
"""The 15 x 13 = 195 nodes of Sec. 4.1."""


def least(work: Callable[[], object], samples: int, rounds: int = ROUNDS) -> float:
    """Return the least processor time per sample of several rounds, [ns]."""
    work()
    times = []
    for _ in range(rounds):
        begin = time.thread_time()
        work()
        times.append(time.thread_time() - begin)
    return 1e9 * min(times) / samples


def plain(
    trajectory: Trajectory, time_: Array, point: tuple[Array, Array], grid: Grid, L: Array, gamma: float
) -> Array:
    """Run the observer of Eq. (36) in NumPy alone, one step as printed after the other."""
    theta, x = np.zeros(grid.size), trajectory.y[0, : L.shape[0]].copy()
    nodes, weights = grid.regressors(*point)
    for k in range(1, time_.size):
        sample = Sample(trajectory.A[k], trajectory.E[k], trajectory.C[k], trajectory.y[k])
        x, theta = local_step(x, theta, time_[k] - time_[k - 1], sample, L, gamma, nodes[k], weights[k])
    return theta


def kernels(config: Config, log: Log) -> list[list[str]]:
    """Return the rows of the table of kernels."""
    engine, gain, settings = Diesel(config.engine), state_gain(config), config.estimate
    first, N = 20_000, BLOCK
    part = _cut(log, first, N)
    calm, rates = calmed(engine, part, settings.smoothing)
    trajectory = engine.trajectory(calm, gain.outputs)
    point = operating_point(engine, part)
    x_0 = np.array([[calm[name][0] for name in engine.state_names]])
    theta = np.zeros(SMALL.size)

    def recursion(gamma: float) -> Callable[[], object]:
        return lambda: observe(trajectory, part.time, part.segments, point, SMALL, gain.L, gamma, x_0, theta)

    def with_scheduling() -> object:
        found = engine.trajectory(calmed(engine, part, settings.smoothing)[0], gain.outputs)
        return observe(found, part.time, part.segments, point, SMALL, gain.L, 0.0, x_0, theta)

    kalman, noise = config.ekf, [*gain.outputs, engine.sensor]
    R = np.array([config.ekf.measurement_noise[name] for name in noise]) ** 2
    Q = np.array([config.ekf.process_noise[name] for name in engine.state_names]) ** 2
    rng = np.random.default_rng(1)
    everywhere = rng.uniform(0.0, 56.0, N), rng.uniform(0.0, 3000.0, N)

    def filtered(state: ekf.KalmanState, where: tuple[Array, Array]) -> ekf.KalmanState:
        return ekf.adapt(state, trajectory, part.time, part.segments, where, SMALL, R, Q, kalman.map_drift, x_0)

    full = filtered(ekf.start(SMALL, kalman, len(engine.state_names)), everywhere)
    if not full.P.all():
        raise RuntimeError("the covariance is not full; the filter would be flattered")
    timed = {
        "recursion: solve and four cells": least(recursion(2.0), N, 10 * ROUNDS),
        "the same, map frozen": least(recursion(0.0), N, 10 * ROUNDS),
        "smoothing": least(lambda: calmed(engine, part, settings.smoothing), N, 3 * ROUNDS),
        "scheduling parameters, A, E, C": least(lambda: engine.trajectory(calm, gain.outputs), N, 3 * ROUNDS),
        "recursion with smoothing and all scheduling": least(with_scheduling, N, 3 * ROUNDS),
        "both balances and their slopes": least(lambda: engine.balances(calm, rates, tuple(settings.tolerance)), N),
        "default method, all of it": least(
            lambda: inform(engine, config.grid(), gain, log, _limited(config), _point(config).unknowns), len(log), 3
        ),
        "Kalman filter, 3 + 195 states, all nodes correlated": least(lambda: filtered(full, point), N, 3),
        "the same recursion in NumPy": least(lambda: plain(trajectory, part.time, point, SMALL, gain.L, 2.0), N, 1),
    }
    base = timed["recursion: solve and four cells"]
    return [
        [name, f"{value:.0f}" if value >= 100 else f"{value:.1f}", f"{value / base:.1f}"]
        for name, value in timed.items()
    ]


ALONE = """import json
from common import configuration, drive
from speed import kernels
config = configuration()
print(json.dumps(kernels(config, drive(config, "etc", 1).log)))"""


def in_turn(trees: Sequence[Path]) -> list[list[str]]:
    """Return the rows of the table of kernels, two columns a tree: its own least of rounds in turn."""
    found: dict[str, dict[Path, float]] = {}
    for _ in range(TURNS):
        for tree in trees:
            folder = tree / "benchmarks"
            environment = os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{tree}"}
            call = [sys.executable, "-c", ALONE]
            said = subprocess.run(call, cwd=folder, env=environment, capture_output=True, text=True, check=True)
            for name, nanoseconds, _ in json.loads(said.stdout.splitlines()[-1]):
                own = found.setdefault(name, {})
                own[tree] = min(own.get(tree, float("inf")), float(nanoseconds))
    base = next(iter(found.values()))
    rows = []
    for name, times in found.items():
        cells = [
            (f"{times[t]:.0f}" if times[t] >= 100 else f"{times[t]:.1f}", f"{times[t] / base[t]:.1f}") for t in trees
        ]
        rows.append([name, *(cell for pair in cells for cell in pair)])
    return rows


def rivals(config: Config) -> list[list[str]]:
    """Return time, memory of the working set and error of each method on the same log."""
    engine, gain, grid, settings = Diesel(config.engine), state_gain(config), config.grid(), _limited(config)
    d = drive(config, "etc_part1", 1)
    log = d.log
    p = grid.size
    rows = []
    methods: dict[str, tuple[Callable[[], Array], int]] = {
        "observer, default": (
            lambda: estimate_default(engine, grid, gain, [log], settings).theta,
            _working_set(config),
        ),
        "extended Kalman filter": (
            lambda: estimate_ekf(engine, grid, gain, [log], config.ekf, settings).theta,
            8 * (3 + p) ** 2,
        ),
        "batch least squares": (lambda: estimate_batch(engine, grid, gain, [log], settings).theta, 8 * p * p),
    }
    for name, (method, memory) in methods.items():
        begin = time.perf_counter()
        theta = method()
        first = time.perf_counter() - begin
        error = asdict(compare(grid, theta, log["u_delta"], log["n_e"], d.delta_W_c))
        took = least(method, len(log), 3)
        cells = [
            f"{took:.0f}",
            f"{1e3 * first:.0f}",
            f"{memory / 2**20:.2f}",
            f"{100 * error['mean_relative_error']:.2f}",
        ]
        rows.append([name, *cells])
    return rows


def _working_set(config: Config) -> int:
    """Return the bytes that the default method carries along a log."""
    columns = Columns(config.grid().size, _point(config).unknowns.size, 2)
    moments = no_moments(config.grid(), columns)
    return moments.products.nbytes + moments.slow.nbytes + moments.gram.nbytes


def _point(config: Config) -> Point:
    return Point(Diesel(config.engine), _limited(config))


def _limited(config: Config) -> EstimateSettings:
    return config.estimate.of_engine(Diesel(config.engine).usual_tolerance)


def _cut(log: Log, first: int, N: int) -> Log:
    part = slice(first, first + N)
    channels = {name: column[part] for name, column in log.channels.items()}
    return Log(log.name, log.sha256, log.time[part], channels, {}, ((0, N),), log.rows[part], log.defects)


def commands(config: Config, folder: Path) -> list[list[str]]:
    """Return wall times of the command line from shell to shell."""
    if config.simulation is None:
        raise ValueError("the configuration has no simulation")
    logs = []
    for cycle in CYCLES:
        made = simulate(config.engine, config.simulation, cycle, seed=1)
        logs.append(folder / f"{cycle}.parquet")
        write_log(logs[-1], made.channels, made.units)
    gain, out = folder / "gain.h5", folder / "r.h5"
    if watch(["synth-gain", "--config", CONFIG, *logs, "--out", gain]).code:
        raise RuntimeError("no gain")
    estimate = ["estimate", "--config", CONFIG, "--gain", gain, "--out", out]
    cold = {"NUMBA_CACHE_DIR": str(folder / "cold"), "PYTHONDONTWRITEBYTECODE": "1"}
    rows = [["`estimate`, one log of 30 min, nothing compiled yet", *_row(watch([*estimate, logs[0]], cold))]]
    for name, arguments in (
        ("`--help`", ["--help"]),
        ("`--version`", ["--version"]),
        ("`estimate`, one log of 30 min (180 001 samples)", [*estimate, logs[0]]),
        ("`estimate`, three cycles (485 403 samples)", [*estimate, *logs]),
    ):
        watch(arguments)
        rows.append([name, *_row(min((watch(arguments) for _ in range(5)), key=lambda one: one.seconds))])
    return rows


def chain(folder: Path) -> list[list[str]]:
    """Return, for the verbs of `make run`, the time from shell to shell and the time in a process that has done it before."""
    log, gain, out = folder / "etc_part1.parquet", folder / "g.h5", folder / "m.h5"
    rows = []
    for verb in (
        ["simulate", "--config", CONFIG, "--cycle", "etc_part1", "--out", log],
        ["synth-gain", "--config", CONFIG, log, "--out", gain],
        ["verify", gain],
        ["estimate", "--config", CONFIG, "--gain", gain, log, "--out", out],
        ["extrapolate", out],
        ["report", out, log, "--html", folder / "r.html"],
    ):
        arguments = list(map(str, verb))
        shell = min((watch(arguments) for _ in range(3)), key=lambda one: one.seconds)
        times = []
        for _ in range(3):
            begin = time.perf_counter()
            with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
                app(arguments, standalone_mode=False)
            times.append(time.perf_counter() - begin)
        computing = min(times)
        rows.append([f"`{verb[0]}`", f"{shell.seconds:.2f}", f"{computing:.2f}", f"{shell.seconds - computing:.2f}"])
    return rows


def _row(found: Watched) -> list[str]:
    if found.code:
        raise RuntimeError("a command failed")
    return [f"{found.seconds:.2f}", f"{found.processor:.2f}", f"{found.memory / 2**20:.0f}"]


def main() -> None:
    """Print and keep the tables."""
    config, here = configuration(), Path(__file__).parents[1]
    trees = [*(Path(name).resolve() for name in sys.argv[1:2]), here]
    times = [f"{name}{when}" for when in (", before", ", now")[-len(trees) :] for name in ("ns", "over the recursion")]
    text = "## Kernels, one core\n\n"
    text += markdown(["per sample", *times], in_turn(trees))
    text += f"\n\nOn {BLOCK} samples of the ETC surrogate at 100 Hz, 15 x 13 nodes; least of several rounds.\n\n"
    text += "## Methods on one log, 15 x 17 nodes\n\n"
    header = ["method", "ns per sample", "first call, ms", "memory carried along, MB", "mean relative error, %"]
    text += markdown(header, rivals(config))
    text += "\n\n## Commands, from shell to shell\n\n"
    with tempfile.TemporaryDirectory() as folder:
        text += markdown(["command", "s", "processor s", "memory, MB"], commands(config, Path(folder)))
        text += "\n\n## Where the time of `make run` goes: one cycle of 600 s\n\n"
        header = ["verb", "s, from shell to shell", "computing, s", "starting, s"]
        text += markdown(header, chain(Path(folder)))
    text += (
        "\n\nCommands: warm but for the first line; least of five and of three, because the others show the machine's other users. "
        "Starting is loading Python, its libraries and the compiled kernels, and is the same for a log of any length."
    )
    publish("speed", "Speed", text)


if __name__ == "__main__":
    sys.exit(main())
