"""Do the intervals hold? `python benchmarks/intervals.py [SEEDS]`, default 50.

For every seed the plant's constants are redrawn uniformly within the tolerance of the configuration, the estimator keeps the
configured ones. Judged: the share of estimated nodes whose 90 % interval contains the node of the best bilinear fit to the
reference along the same drive; and of extrapolated nodes whose interval of prediction contains the surface, when that is a
quadratic and when it has a bump. Reported, not judged: the share of estimated nodes whose interval contains the surface itself.
"""

import sys
from dataclasses import replace

import numpy as np
import scipy.stats
from common import CYCLES, altered, configuration, drive, markdown, publish, state_gain

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.maps.metrics import best_fit
from lpvobs.maps.quadratic import fit, interval_factor
from lpvobs.observer.estimate import estimate_default
from lpvobs.records import Array
from lpvobs.simulation.readings import surface_error

LEVEL = 0.90


def main(seeds: int) -> None:
    """Print and keep the table."""
    config = configuration()
    if config.simulation is None:
        raise SystemExit("the configuration has no simulation")
    grid, gain, settings = config.grid(), state_gain(config), config.estimate
    engine = Diesel(config.engine)
    bumpy = config.simulation.surface
    surfaces = {"quadratic": replace(bumpy, bumps=()), "quadratic and bump": bumpy}
    n_e, u_delta = (axis.ravel() for axis in np.meshgrid(grid.speed, grid.fuel, indexing="ij"))
    rows = []
    for cycle, title in CYCLES.items():
        for name, surface in surfaces.items():
            truth = surface_error(surface, u_delta, n_e, np.zeros_like(n_e)).reshape(grid.shape)
            shares: list[tuple[float, float, float]] = []
            errors: list[Array] = []
            for seed in range(1, seeds + 1):
                random = np.random.default_rng([seed, 1])
                factors = {key: 1 + random.uniform(-size, size) for key, size in settings.tolerance.items()}
                d = drive(config, cycle, seed, surface, altered(config.engine, factors))
                found = estimate_default(engine, grid, gain, [d.log], settings)
                regressors = grid.regressors(d.log["u_delta"], d.log["n_e"])
                best = best_fit(grid, *regressors, d.delta_W_c).reshape(grid.shape)
                filled = fit(grid, found.theta, found.covariance, found.supported, found.noise, found.design)
                half = scipy.stats.norm.ppf(0.5 + LEVEL / 2) * found.standard_error
                wide = interval_factor(filled.nodes, LEVEL) * filled.map_standard_error
                on = found.supported
                errors.append((found.theta - best)[on])
                shares.append(
                    (
                        float(np.mean(np.abs(found.theta - best)[on] <= half[on])),
                        float(np.mean(np.abs(found.theta - truth)[on] <= half[on])),
                        float(np.mean(np.abs(filled.delta_W_c - truth)[~on] <= wide[~on])),
                    )
                )
                print(f"{cycle}, {name}, seed {seed} of {seeds}: {shares[-1]}", file=sys.stderr)
            mean, spread = 100 * np.mean(shares, axis=0), 100 * np.std(shares, axis=0, ddof=1) / np.sqrt(seeds)
            rms = 1e3 * float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
            cells = [f"{m:.1f} ± {1.645 * s:.1f}" for m, s in zip(mean, spread, strict=True)]
            rows.append([f"{title}, {name}", cells[0], cells[2], cells[1], f"{rms:.3f}"])
    header = ["drive, surface", "estimated nodes", "extrapolated nodes", "estimated, surface itself", "rms error, g/s"]
    text = (
        "Share of nodes inside their 90 % interval [%], mean over the seeds with the 90 % interval of that mean: the nodes of one "
        "drive share the errors of the constants, so the seed is the unit.\n\n"
    )
    publish("intervals", f"Coverage of the intervals, seeds 1 to {seeds}", text + markdown(header, rows))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
