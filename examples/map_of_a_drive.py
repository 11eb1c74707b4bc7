"""The whole chain from Python: a drive, a proven gain, the map, what is missing in it, a report and a calibration file.

    python examples/map_of_a_drive.py --out build/example

takes about half a minute with the defaults, less with `--rate 20`. With logs of your own, leave the first call out and name them.
"""

import argparse
from pathlib import Path

import lpvobs

CONFIG = Path(__file__).parents[1] / "configs" / "diesel.toml"


def map_of_a_drive(folder: Path, cycle: str, rate: float) -> None:
    """Write log, gain, result, report and calibration file of one simulated drive into a folder, and print what they say."""
    folder.mkdir(parents=True, exist_ok=True)
    log, gain, result = folder / "drive.parquet", folder / "gain.h5", folder / "map.h5"

    lpvobs.simulate(CONFIG, cycle, log, rate=rate, seed=3)
    proven = lpvobs.synth_gain(CONFIG, log, out=gain).gain.certificate
    print(f"gain: proven at {proven.vertices} vertices")

    found = lpvobs.estimate(CONFIG, log, result, gain=gain)
    fitted, held = lpvobs.extrapolate(result)
    metrics = found.summaries[0].metrics
    if metrics is not None:  # a log of a real engine has no truth to compare with
        print(f"map: off by {100 * metrics.mean_relative_error:.2f} % on average")

    surface = lpvobs.read_map(result)  # flows in kg/s, shape (speeds, fuel quantities)
    node = divmod(abs(surface.values).argmax(), surface.y.nodes.size)
    print(
        f"largest error: {1e3 * surface.values[node]:+.2f} g/s, standard error {1e3 * surface.standard_error[node]:.2f} g/s, "
        f"at {surface.x.nodes[node[0]]:.0f} rpm and {surface.y.nodes[node[1]]:.0f} mg/cycle"
    )
    print(
        f"extrapolated: {(fitted.support == 2).sum()} nodes; of the outer ones left out, {100 * held:.0f} % were predicted"
    )

    lpvobs.write_report(result, log, html=folder / "report.html", gates=["share_certified>=0.9"])
    lpvobs.export(result, folder / "maf.dcm", "dcm", name="MAF_dW")
    print(f"written: {', '.join(sorted(path.name for path in folder.iterdir()))}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("build/example"), help="the folder to write into")
    parser.add_argument("--cycle", default="ftp75_cold", help="a cycle, or the path of a table")
    parser.add_argument("--rate", type=float, default=100.0, help="samples per second")
    chosen = parser.parse_args()
    map_of_a_drive(chosen.out, chosen.cycle, chosen.rate)
