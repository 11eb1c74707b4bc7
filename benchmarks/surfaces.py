"""Other error surfaces, also such that cross zero or are zero: `python benchmarks/surfaces.py [SEEDS]`, default three.

Demanded: an rms ratio of at most the floor plus 1.5 percentage points, a mean relative error of at most 1.5 times the floor plus
one point; and of a perfect sensor, a map that is zero within its own 90 % intervals. The last column has the constants considered
(`--constants consider`), not estimated with the map.
"""

import sys
from dataclasses import replace

import numpy as np
from common import CYCLES, configuration, drive, markdown, publish, state_gain

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.engines.diesel.published import PUBLISHED
from lpvobs.maps.metrics import compare
from lpvobs.observer.estimate import estimate_default
from lpvobs.simulation.parameters import Bump, ErrorSurface

NORMAL_90 = 1.645
STEEP = Bump(amplitude=-4e-3, u_delta=12.0, n_e=1400.0, width_u_delta=4.0, width_n_e=250.0)
SURFACES = {
    "Eq. (39)": ErrorSurface("quadratic", coefficients=PUBLISHED.surfaces["ETC part 1, Eq. (39)"]),
    "Eq. (40) and a steep hollow": ErrorSurface("quadratic", bumps=(STEEP,)),
    "King's law, +15 % at idle, -10 % at high flow": ErrorSurface("king", offset=0.012, slope=0.92),
    "King's law, -5 % nearly everywhere": ErrorSurface("king", offset=0.001, slope=0.97),
    "plane through zero": ErrorSurface("quadratic", coefficients=(0.0, 1e-4, 0.0, -1.5e-6, 0.0, 1e-3)),
}


def main(seeds: int) -> None:
    """Print and keep the tables."""
    config = configuration()
    grid, gain, engine = config.grid(), state_gain(config), Diesel(config.engine)
    rows, blank = [], []
    for cycle, title in CYCLES.items():
        for name, surface in SURFACES.items():
            found, considered = [], []
            for seed in range(1, seeds + 1):
                d = drive(config, cycle, seed, surface)
                for each, constants in ((found, "joint"), (considered, "consider")):
                    settings = replace(config.estimate, constants=constants)
                    theta = estimate_default(engine, grid, gain, [d.log], settings).theta
                    each.append(compare(grid, theta, d.log["u_delta"], d.log["n_e"], d.delta_W_c))
            relative, floor, ratio, least, left = (
                100 * np.array([getattr(m, key) for m in found])
                for key in (
                    "mean_relative_error", "floor_mean_relative_error", "rms_ratio", "floor_rms_ratio", "share_left_out"
                )
            )  # fmt: skip
            kept = bool(np.all(ratio <= least + 1.5) and np.all(relative <= 1.5 * floor + 1.0))
            rows.append(
                [
                    f"{title}: {name}",
                    *(f"{values.mean():.2f}" for values in (relative, floor, ratio, least, left)),
                    "yes" if kept else "no",
                    f"{100 * np.mean([m.mean_relative_error for m in considered]):.2f}",
                ]
            )
            print(rows[-1], file=sys.stderr)
        for seed in range(1, seeds + 1):
            estimate = estimate_default(
                engine, grid, gain, [drive(config, cycle, seed, ErrorSurface("zero")).log], config.estimate
            )
            on = estimate.supported
            noise = np.sqrt(np.diag(estimate.noise)).reshape(grid.shape)
            z, own = np.abs(estimate.theta / estimate.standard_error)[on], np.abs(estimate.theta / noise)[on]
            size = 1e3 * float(np.sqrt(np.mean(estimate.theta[on] ** 2)))
            blank.append(
                [
                    f"{title}, seed {seed}",
                    f"{size:.3f}",
                    f"{100 * np.mean(z <= NORMAL_90):.0f}",
                    f"{100 * np.mean(own <= NORMAL_90):.0f}",
                ]
            )
    header = [
        "drive: surface",
        "mean rel. error, %",
        "floor, %",
        "rms ratio, %",
        "floor, %",
        "left out, %",
        "within the demand",
        "mean rel. error, constants considered, %",
    ]
    perfect = [
        "perfect sensor",
        "rms of the map, g/s",
        "nodes zero within their interval, %",
        "the same, engine constants exact, %",
    ]
    text = markdown(header, rows) + "\n\n" + markdown(perfect, blank)
    publish("surfaces", f"Other error surfaces, seeds 1 to {seeds}", text)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
