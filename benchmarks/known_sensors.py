"""What slow and late sensors cost, and what of it is left when the configuration states them: `python benchmarks/known_sensors.py`.

The plant's sensors are as `[sensors]` says; the estimate reads the same log once without that table and once with it.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from common import CONFIG, markdown, publish

from lpvobs.api.estimate import estimate
from lpvobs.api.simulate import simulate
from lpvobs.api.synth_gain import synth_gain

DRIVES = (("ftp75_cold", 20.0, 31), ("ftp75_cold", 20.0, 32), ("etc_part1", 100.0, 31))
CASES = {
    "T_em 2 s slow": "T_em = { tau = 2.0 }",
    "T_im 1 s slow": "T_im = { tau = 1.0 }",
    "W_maf 50 ms slow": "W_maf = { tau = 0.05 }",
    "W_maf 40 ms late": "W_maf = { delay = 0.04 }",
    "p_im 20 ms late": "p_im = { delay = 0.02 }",
    "p_em 20 ms late": "p_em = { delay = 0.02 }",
}


def main() -> None:
    """Print and keep the table."""
    with tempfile.TemporaryDirectory() as name:
        folder, plain = Path(name), CONFIG.read_text(encoding="utf-8")
        gain, log, rows = folder / "gain.h5", folder / "drive.parquet", []
        synth_gain(CONFIG, out=gain)

        def error(config: Path) -> float:
            metrics = estimate(config, log, folder / "map.h5", gain=gain).summaries[0].metrics
            if metrics is None or metrics.mean_relative_error is None:
                raise ValueError("a simulated log has its truth beside it")
            return 100.0 * metrics.mean_relative_error

        for cycle, rate, seed in DRIVES:
            simulate(CONFIG, cycle, log, rate=rate, seed=seed)
            row = [error(CONFIG)]
            for number, text in enumerate(CASES.values()):
                stated = folder / f"stated{number}.toml"
                stated.write_text(f"{plain}\n[sensors]\n{text}\n", encoding="utf-8")
                simulate(stated, cycle, log, rate=rate, seed=seed)
                row += [error(CONFIG), error(stated)]
            rows.append(row)
            print(f"{cycle}, seed {seed}: {row}", file=sys.stderr)
    means = [
        np.mean([row for row, drive in zip(rows, DRIVES, strict=True) if drive[0] == c], axis=0)
        for c in ("ftp75_cold", "etc_part1")
    ]
    lines = [["fast and even", *(f"{row[0]:.2f} | {row[0]:.2f}" for row in means)]]
    lines += [
        [case, *(f"{row[1 + 2 * i]:.2f} | {row[2 + 2 * i]:.2f}" for row in means)] for i, case in enumerate(CASES)
    ]
    header = ["sensor", "FTP75 at 20 Hz, unsaid", "said", "ETC part 1 at 100 Hz, unsaid", "said"]
    text = "Mean relative error of the map [%], two drives of FTP75 and one of ETC part 1; constants are those of the plant.\n\n"
    publish("known_sensors", "What is known of the sensors", text + markdown(header, lines))


if __name__ == "__main__":
    main()
