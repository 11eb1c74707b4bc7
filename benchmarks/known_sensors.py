"""What slow and late sensors cost, and what of it is left when the configuration states them: `python benchmarks/known_sensors.py`.

The plant's sensors are as `[sensors]` says; the estimate reads the same log once without that table and once with it.
"""

import sys
import tempfile
from pathlib import Path

from common import CONFIG, markdown, publish

from lpvobs.api.estimate import estimate
from lpvobs.api.simulate import simulate
from lpvobs.api.synth_gain import synth_gain

CYCLE, RATE, SEED = "ftp75_cold", 20.0, 31
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
        gain, log = folder / "gain.h5", folder / "drive.parquet"
        synth_gain(CONFIG, out=gain)

        def error(config: Path) -> float:
            metrics = estimate(config, log, folder / "map.h5", gain=gain).summaries[0].metrics
            if metrics is None or metrics.mean_relative_error is None:
                raise ValueError("a simulated log has its truth beside it")
            return 100.0 * metrics.mean_relative_error

        simulate(CONFIG, CYCLE, log, rate=RATE, seed=SEED)
        rows = [["fast and even", f"{error(CONFIG):.2f}", ""]]
        for number, (case, text) in enumerate(CASES.items()):
            stated = folder / f"stated{number}.toml"
            stated.write_text(f"{plain}\n[sensors]\n{text}\n", encoding="utf-8")
            simulate(stated, CYCLE, log, rate=RATE, seed=SEED)
            rows.append([case, f"{error(CONFIG):.2f}", f"{error(stated):.2f}"])
            print(rows[-1], file=sys.stderr)
    text = (
        "Mean relative error of the map [%] of one FTP75 at 20 samples a second; constants are those of the plant.\n\n"
    )
    publish("known_sensors", "What is known of the sensors", text + markdown(["sensor", "unsaid", "said"], rows))


if __name__ == "__main__":
    main()
