"""Cost against samples, and against logs: `python benchmarks/scaling.py [MOST_SAMPLES [LOGS]]`, default 1e8 and 1000.

One log of 1e4 to 1e8 samples (the largest is a file of some 5 GB in a temporary folder), and a fleet of ten-minute logs on one and
on two processes. Every drive is a stretch of the same simulated cycles, cut and put together differently.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from common import CONFIG, RESULTS, configuration, markdown, publish
from matplotlib.figure import Figure
from watch import Watched, watch

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.io.configuration.config import Config
from lpvobs.records import Array
from lpvobs.simulation.simulate import simulate

CYCLES = ("etc", "ftp75", "nedc")
RATE = 100.0
PAUSE = 60.0
"""[s] between two drives of a long log: the engine is off, nothing is recorded."""
TEN_MINUTES = int(600 * RATE)
GROUP = 1 << 16
"""Rows in a row group, as the project writes logs."""


def drives(config: Config) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the cycles one after the other, and the units."""
    if config.simulation is None:
        raise ValueError("the configuration has no simulation")
    made = [simulate(config.engine, config.simulation, cycle, RATE, seed) for seed, cycle in enumerate(CYCLES, 1)]
    names = [*Diesel.channels, "ref_W_c", "ref_delta_W_c"]
    return {name: np.concatenate([log.channels[name] for log in made]) for name in names}, dict(made[0].units)


def write(path: Path, stretches: Iterator[tuple[float, dict[str, Array]]], units: dict[str, str]) -> None:
    """Write stretches, each with the time at which it begins, as one log."""
    writer = None
    for begin, channels in stretches:
        N = next(iter(channels.values())).size
        columns = {"time": begin + np.arange(N) / RATE, **channels}
        fields = [pa.field(name, pa.float64(), metadata={"unit": units[name]}) for name in columns]
        table = pa.table(list(columns.values()), schema=pa.schema(fields))
        writer = writer or pq.ParquetWriter(path, table.schema, compression="zstd")
        writer.write_table(table, row_group_size=GROUP)
    if writer is None:
        raise ValueError("nothing to write")
    writer.close()


def repeated(channels: dict[str, Array], samples: int) -> Iterator[tuple[float, dict[str, Array]]]:
    """Yield the drives again and again until there are so many samples."""
    N, begin = channels["n_e"].size, 0.0
    while samples > 0:
        take = min(samples, N)
        yield begin, {name: column[:take] for name, column in channels.items()}
        begin += take / RATE + PAUSE
        samples -= take


def long_logs(config: Config, gain: Path, folder: Path, most: int) -> tuple[list[int], list[Watched]]:
    """Return sample counts, and what estimating from a log of so many took."""
    channels, units = drives(config)
    counts, found = [], []
    for samples in (10**n for n in range(4, 9)):
        if samples > most:
            break
        log = folder / "long.parquet"
        write(log, repeated(channels, samples), units)
        call = ["estimate", "--config", CONFIG, "--gain", gain, log, "--out", folder / "r.h5"]
        found.append(watch(call))
        if found[-1].code:
            raise RuntimeError(f"{samples} samples: exit code {found[-1].code}")
        counts.append(samples)
        log.unlink()
        print(f"{samples}: {found[-1]}", file=sys.stderr)
    return counts, found


def fleet(config: Config, gain: Path, folder: Path, logs: int) -> list[list[str]]:
    """Return the rows of the table of logs and processes."""
    channels, units = drives(config)
    N = channels["n_e"].size
    place = folder / "fleet"
    place.mkdir()
    rng = np.random.default_rng(1)
    for number, start in enumerate(rng.choice(N - TEN_MINUTES, logs, replace=False).tolist()):
        part = {name: column[start : start + TEN_MINUTES] for name, column in channels.items()}
        write(place / f"drive_{number:04d}.parquet", iter([(0.0, part)]), units)
    rows, alone = [], 0.0
    some = sorted(place.iterdir())
    for count, jobs in ((logs // 10, 1), (logs // 10, 2), (logs, 1), (logs, 2)):
        call = ["estimate", "--config", CONFIG, "--gain", gain, *some[:count], "--jobs", jobs, "--out", folder / "r.h5"]
        done = watch(call)
        if done.code:
            raise RuntimeError(f"{count} logs, {jobs} jobs: exit code {done.code}")
        alone = done.seconds if jobs == 1 else alone
        efficiency = alone / (jobs * done.seconds)
        per_sample = 1e9 * done.processor / (count * TEN_MINUTES)
        cells = [f"{done.seconds:.1f}", f"{per_sample:.0f}", f"{efficiency:.2f}", f"{done.memory / 2**20 / jobs:.0f}"]
        rows.append([str(count), str(jobs), *cells])
        print(rows[-1], file=sys.stderr)
    return rows


def draw(path: Path, counts: list[int], found: list[Watched]) -> None:
    """Draw cost and memory against samples."""
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "scaling", "font.size": 9.0}):
        figure = Figure(figsize=(7.0, 2.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.loglog(counts, [one.processor for one in found], "o-")
        left.set(xlabel="samples", ylabel="processor s")
        right.semilogx(counts, [one.memory / 2**20 for one in found], "o-")
        right.set(xlabel="samples", ylabel="memory, MB", ylim=(0, 1024))
        for axes in (left, right):
            axes.grid(alpha=0.3)
        figure.savefig(path, metadata={"Date": None})


def main(most: int, logs: int) -> None:
    """Print and keep the tables and the plot."""
    config = configuration()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        gain = folder / "gain.h5"
        if watch(["synth-gain", "--config", CONFIG, "--out", gain]).code:
            raise RuntimeError("no gain")
        counts, found = long_logs(config, gain, folder, most)
        rows = [
            [
                f"{samples:.0e}".replace("e+0", "e"),
                f"{one.seconds:.2f}",
                f"{one.processor:.2f}",
                f"{1e9 * one.processor / samples:.0f}",
                f"{one.memory / 2**20:.0f}",
            ]
            for samples, one in zip(counts, found, strict=True)
        ]
        text = "## One log\n\n" + markdown(
            ["samples", "s", "processor s", "processor ns per sample", "memory, MB"], rows
        )
        text += "\n\n![cost against samples](scaling.svg)\n\n## Many logs of ten minutes (60 000 samples each)\n\n"
        header = [
            "logs",
            "processes",
            "s",
            "processor ns per sample",
            "share of perfect scaling",
            "memory per process, MB",
        ]
        text += markdown(header, fleet(config, gain, folder, logs))
    text += (
        "\n\nFrom shell to shell, comparison with the references included; memory is the most that was seen, of all processes. "
        "No two logs of many are the same: each is another stretch of ten minutes of the same three simulated drives. "
        "On a machine that others use, the clock shows them, too: then only the processor's seconds stand."
    )
    draw(RESULTS / "scaling.svg", counts, found)
    publish("scaling", "Cost against samples and logs", text)


if __name__ == "__main__":
    main(int(float(sys.argv[1])) if len(sys.argv) > 1 else 10**8, int(sys.argv[2]) if len(sys.argv) > 2 else 1000)
