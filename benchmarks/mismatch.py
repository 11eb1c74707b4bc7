"""Which errors of the engine's constants the map inherits: `python benchmarks/mismatch.py`.

The plant keeps its constants; the estimator's are wrong by 1, 2 and 5 %, one at a time.
"""

import sys

import numpy as np
from common import CYCLES, altered, configuration, drive, markdown, publish, state_gain

from lpvobs.engines.diesel.lpv import Diesel
from lpvobs.maps.metrics import compare
from lpvobs.observer.estimate import estimate_default

SIZES = (0.01, 0.02, 0.05)
GIVEN = ("R_a", "R_e", "c_pa", "c_pe", "gamma_a", "gamma_e", "n_cyl")  # properties of gases, and a count


def main() -> None:
    """Print and keep the table."""
    config = configuration()
    grid, gain = config.grid(), state_gain(config)
    names = [
        name for name in Diesel(config.engine).engine_constants() if name not in GIVEN and not name.startswith("Q_")
    ]
    drives = {cycle: drive(config, cycle, 1) for cycle in CYCLES}

    def error(cycle: str, factors: dict[str, float]) -> tuple[float, float]:
        d = drives[cycle]
        engine = Diesel(altered(config.engine, factors))
        theta = estimate_default(engine, grid, gain, [d.log], config.estimate).theta
        m = compare(grid, theta, d.log["u_delta"], d.log["n_e"], d.delta_W_c)
        return m.mean_relative_error, m.bias

    rows = []
    for name in names:
        row: list[float] = []
        for cycle in CYCLES:
            for size in SIZES:
                up, down = error(cycle, {name: 1 + size}), error(cycle, {name: 1 - size})
                row.append(100 * max(up[0], down[0]))
            row.append(1e3 * 0.5 * (up[1] - down[1]) / (100 * SIZES[-1]))
        rows.append((name, row))
        print(name, file=sys.stderr)
    rows.sort(key=lambda item: -max(item[1][2], item[1][6]))
    exact = ["none", *(text for c in CYCLES for text in (*[f"{100 * error(c, {})[0]:.2f}"] * 3, "0"))]
    header = ["constant"]
    for cycle in CYCLES:
        header += [*(f"{cycle}, {100 * size:.0f} %" for size in SIZES), "bias per %, g/s"]
    lines = [exact] + [[n, *(f"{v:+.3f}" if i % 4 == 3 else f"{v:.2f}" for i, v in enumerate(row))] for n, row in rows]
    text = "Mean relative error of the map [%], the worse of both signs; bias along the drive per per cent of the constant.\n\n"
    publish("mismatch", "What the map owes to wrong engine constants", text + markdown(header, lines))


if __name__ == "__main__":
    np.seterr(all="raise")
    main()
