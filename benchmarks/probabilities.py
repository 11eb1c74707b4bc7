"""Is the probability that nothing is there one? `python benchmarks/probabilities.py [DRIVES]`, default 40.

Clean drives whose plant has constants drawn within the tolerance, searched with a map of their own. The probabilities of `trace`
ought to be uniform, or large: below 0.01 in at most 2 % and below 0.1 in at most 13 % of the drives. The figure sets the sorted
ones against those of a uniform distribution.
"""

import sys
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from common import CYCLES, RESULTS, configuration, drive, markdown, publish

from lpvobs.discovery.map_prior import free_map
from lpvobs.discovery.refine import refine
from lpvobs.engines.diesel.effects import diesel_model
from lpvobs.records import Array
from lpvobs.simulation.simulate import drawn

FIRST_SEED = 3001
LIMITS = {0.01: 0.02, 0.1: 0.13}
"""Probabilities, and the largest share of clean drives that may be below."""


def main(drives: int) -> None:
    """Print and keep the table, and draw the figure."""
    config = configuration()
    tolerance = config.estimate.tolerance
    model, grid = diesel_model(config.engine, tolerance), config.grid()
    found = []
    for number in range(drives):
        seed, cycle = FIRST_SEED + number, list(CYCLES)[number % len(CYCLES)]
        log = drive(config, cycle, seed, engine=drawn(config.engine, tolerance, seed)[0]).log
        named = replace(log, name=f"{cycle} {seed}")
        trace = refine(model, grid, free_map(grid, len(model.names), config.estimate.prior_map), [named]).trace
        found.append((named.name, trace.verdict, trace.p_value))
        print(*found[-1], flush=True)
    p_values = np.array([p for _, _, p in found])
    shares = [[f"below {limit}", f"{np.mean(p_values < limit):.3f}", f"{most}"] for limit, most in LIMITS.items()]
    named = [[name, verdict, f"{p:.2g}"] for name, verdict, p in found if verdict != "none"]
    text = markdown(["p", "share of clean drives", "at most"], shares)
    publish(
        "probabilities",
        f"The probability of nothing, {drives} clean drives",
        text + "\n\n" + markdown(["drive", "verdict", "p"], named),
    )
    figure, axes = plt.subplots(figsize=(4.5, 4.5))
    axes.plot(*against_uniform(p_values), "o", markersize=3)
    axes.plot([0, 1], [0, 1], color="grey", linewidth=0.7)
    axes.set_xlabel("uniform")
    axes.set_ylabel("p that nothing is there")
    figure.savefig(RESULTS / "probabilities.svg")


def against_uniform(p_values: Array) -> tuple[Array, Array]:
    """Return quantiles of a uniform distribution, and the sorted probabilities that ought to lie on or above them."""
    return (np.arange(p_values.size) + 0.5) / p_values.size, np.sort(p_values)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
