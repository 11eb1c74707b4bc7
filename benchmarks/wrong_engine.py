"""Whether a wrong engine or a mixed-up log is noticed: `python benchmarks/wrong_engine.py`, some minutes of one processor.

Right drives: constants drawn within their tolerance, three cycles, three surfaces of the sensor's error, sea level to 2000 m, -5 to
35 degrees. Then the same drives with one thing wrong at a time. An outcome is refused (an exit code other than zero), flagged (a
map, and a line that says what is doubtful) or silent (a map, and nothing said).
"""

import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from common import CONFIG, altered, configuration, markdown, publish

from lpvobs.api.estimate import estimate
from lpvobs.api.synth_gain import synth_gain
from lpvobs.errors import LpvobsError
from lpvobs.io.configuration.config import load_config, load_effects
from lpvobs.io.logs.parquet import write_log
from lpvobs.observer.balance_agreement import DISAGREE
from lpvobs.records import Array
from lpvobs.simulation.simulate import UNITS, simulate

RIGHT = 50
SPOILED = 6  # of the right drives, two of each cycle
RATE = 20.0
SEED = 962003
NOISE = {"p_amb": 50.0, "T_amb": 0.3}  # Pa, K: a barometer and a thermometer that stand still would betray an exchange
WEATHER = ((98000.0, 298.0), (80000.0, 298.0), (101000.0, 268.0), (98000.0, 308.0))  # Pa, K
Channels = dict[str, Array]


@dataclass(frozen=True)
class Outcome:
    """What came of one estimate: `refused`, `flagged` or `silent`, the words, and the map's error [kg/s] where there is one."""

    verdict: str
    words: str
    error: float = float("nan")
    ratio: float = float("nan")


class Bench:
    """Configurations, gains and logs in one folder."""

    def __init__(self, folder: Path):
        self.folder, self.gains = folder, dict[Path, Path]()

    def config(self, name: str, change: Callable[[str], str] = str) -> Path:
        """Return the shipped diesel with its text changed."""
        path = self.folder / f"{name}.toml"
        path.write_text(change(CONFIG.read_text(encoding="utf-8")), encoding="utf-8")
        return path

    def gain(self, config: Path) -> Path:
        """Return a gain for a configuration, made once."""
        if config not in self.gains:
            self.gains[config] = config.with_suffix(".h5")
            synth_gain(config, out=self.gains[config])
        return self.gains[config]

    def outcome(self, config: Path, channels: Channels, gain: Path | None = None) -> Outcome:
        """Return what `estimate` says of a log."""
        log = self.folder / "drive.parquet"
        write_log(log, channels, UNITS)
        try:
            done = estimate(config, log, self.folder / "map.h5", gain=gain or self.gain(config))
        except LpvobsError as refusal:
            return Outcome("refused", str(refusal).replace(f"{self.folder}/", ""))
        metrics, says = done.summaries[0].metrics, done.doubts.says
        error = float("nan") if metrics is None or metrics.rmse is None else metrics.rmse
        return Outcome("flagged" if says else "silent", "; ".join(says), error, done.doubts.agreement.ratio)


def right_drives() -> list[Channels]:
    """Return drives of engines within the tolerance."""
    config, rng, drives = configuration(), np.random.default_rng(SEED), []
    surfaces = [
        load_effects(CONFIG.parent / "surfaces" / f"{name}.toml").surface for name in ("default", "zero", "king")
    ]
    assert config.simulation is not None
    for i in range(RIGHT):
        factors = {name: 1.0 + rng.uniform(-t, t) for name, t in config.estimate.tolerance.items()}
        p_amb, T_amb = WEATHER[i % 4]
        parameters = replace(config.simulation, ambient=replace(config.simulation.ambient, p_amb=p_amb, T_amb=T_amb))
        cycle, surface = ("ftp75_cold", "etc_part1", "nedc")[i % 3], surfaces[i // 3 % 3]
        made = simulate(altered(config.engine, factors), parameters, cycle, RATE, seed=SEED + i, surface=surface)
        ambient = {
            name: made.channels[name] + sd * rng.standard_normal(made.channels[name].size) for name, sd in NOISE.items()
        }
        drives.append({**made.channels, **ambient})
        print(f"drive {i + 1} of {RIGHT}", file=sys.stderr)
    return drives


def another_engine(size: float, config: Path, cycle: str) -> Channels:
    """Return the drive of another engine: the configured one, every length larger by the cube root of `size`."""
    other, _ = load_config(config)
    area, length = size ** (2 / 3), size ** (1 / 3)
    factors = dict.fromkeys(("V_d", "V_im", "V_em"), size) | dict.fromkeys(("A_vgt_max", "A_egr_max"), area)
    factors |= dict.fromkeys(("R_c", "R_t"), length) | {"J_t": length**5, "W_c_opt": area}
    assert other.simulation is not None
    return dict(simulate(altered(other.engine, factors), other.simulation, cycle, RATE, seed=SEED).channels)


def constant(name: str, factor: float) -> Callable[[str], str]:
    """Return a change of the configuration's text: one constant of the engine multiplied."""

    def change(text: str) -> str:
        head, engine = text.split("[engine.gas]")
        lines = [
            f"{name} = {float(line.split('=')[1].split('#')[0]) * factor!r}" if line.startswith(f"{name} = ") else line
            for line in engine.split("\n")
        ]
        return head + "[engine.gas]" + "\n".join(lines)

    return change


def exchanged(one: str, other: str) -> Callable[[Channels], Channels]:
    """Return the change of a log in which two channels bear each other's names."""
    return lambda log: {**log, one: log[other], other: log[one]}


def with_(log: Channels, **channels: Array) -> Channels:
    """Return a log with some channels replaced."""
    return {**log, **channels}


def _late(x: Array, seconds: float) -> Array:
    return x[np.maximum(np.arange(x.size) - round(seconds * RATE), 0)]


def _held(x: Array, seconds: float) -> Array:
    samples = round(seconds * RATE)
    return x[np.arange(x.size) // samples * samples]


LOGS: Mapping[str, Callable[[Channels], Channels]] = {
    "p_im and p_em exchanged": exchanged("p_im", "p_em"),
    "T_im and T_amb exchanged": exchanged("T_im", "T_amb"),
    "u_egr and u_vgt exchanged": exchanged("u_egr", "u_vgt"),
    "p_im and p_amb exchanged": exchanged("p_im", "p_amb"),
    "p_im relative": lambda log: with_(log, p_im=log["p_im"] - log["p_amb"]),
    "p_em relative": lambda log: with_(log, p_em=log["p_em"] - log["p_amb"]),
    "p_im and p_em relative": lambda log: with_(log, p_im=log["p_im"] - log["p_amb"], p_em=log["p_em"] - log["p_amb"]),
    "p_im in kPa, called Pa": lambda log: with_(log, p_im=log["p_im"] / 1e3),
    "p_em in kPa, called Pa": lambda log: with_(log, p_em=log["p_em"] / 1e3),
    "p_amb in kPa, called Pa": lambda log: with_(log, p_amb=log["p_amb"] / 1e3),
    "all pressures in kPa, called Pa": lambda log: with_(log, **{p: log[p] / 1e3 for p in ("p_im", "p_em", "p_amb")}),
    "W_maf in g/s, called kg/h": lambda log: with_(log, W_maf=log["W_maf"] / 3.6),
    "W_maf in kg/h, called g/s": lambda log: with_(log, W_maf=log["W_maf"] * 3.6),
    "W_maf one second late": lambda log: with_(log, W_maf=_late(log["W_maf"], 1.0)),
    "W_maf held for two seconds": lambda log: with_(log, W_maf=_held(log["W_maf"], 2.0)),
    "sensor unplugged, at zero": lambda log: with_(log, W_maf=0.0 * log["W_maf"]),
    "sensor unplugged, at 0.11 kg/s": lambda log: with_(log, W_maf=0.0 * log["W_maf"] + 0.11),
}
CONSTANTS = {"V_d in litres": ("V_d", 1e3)} | {
    f"{name} {100 * (factor - 1):+.0f} %": (name, factor) for name in ("V_d", "V_im", "R_c") for factor in (0.8, 1.2)
}


def main() -> None:
    """Print and keep the table."""
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(Path(name))
        right = bench.config("diesel")
        drives = right_drives()
        plain = [bench.outcome(right, log) for log in drives]
        spoiled, base = drives[:SPOILED], plain[:SPOILED]
        cases = {case: [bench.outcome(right, change(log)) for log in spoiled] for case, change in LOGS.items()}
        for number, (case, (what, factor)) in enumerate(CONSTANTS.items()):
            wrong = bench.config(f"wrong{number}", constant(what, factor))
            gain = None if "litres" not in case else bench.gain(right)
            cases[case] = [bench.outcome(wrong, log, gain) for log in spoiled]
        truck = CONFIG.parent / "heavy-duty.toml"
        others = {
            "log of a 2.5 l engine of the same kind": another_engine(2.5 / 1.91, right, "etc_part1"),
            "log of a 1.5 l engine of the same kind": another_engine(1.5 / 1.91, right, "etc_part1"),
            "log of the 12.7 l truck": dict(another_engine(1.0, truck, "etc_part1")),
        }
        lone = {case: bench.outcome(right, log) for case, log in others.items()}
        bench.gains[truck] = bench.folder / "truck.h5"
        synth_gain(truck, out=bench.gains[truck])
        lone["gain of the 12.7 l truck"] = bench.outcome(right, drives[0], bench.gain(truck))
        size = bench.config("size", constant("V_im", 1.2))
        lone["gain of an engine with V_im 20 % larger"] = bench.outcome(right, drives[0], bench.gain(size))

    flagged = [o for o in plain if o.verdict != "silent"]
    rows = [[f"right, {RIGHT} drives", *_counts(plain), "1", "; ".join(o.words for o in flagged)]]
    for case, outcomes in cases.items():
        worse = [o.error / b.error for o, b in zip(outcomes, base, strict=True) if o.verdict == "silent"]
        rows.append([case, *_counts(outcomes), f"{max(worse):.2f}" if worse else "-", _words(outcomes)])
    rows += [[case, *_counts([o]), "-", _words([o])] for case, o in lone.items()]
    ratios = [o.ratio for o in plain]
    header = [
        "what is wrong",
        "refused",
        "flagged",
        "silent",
        "largest error where silent, over that of the right engine",
        "in the words of",
    ]
    intro = (
        f"{RIGHT} right drives: constants within 1 %, V_im within 15 %, three cycles, three error surfaces, 80 to 101 kPa, "
        f"-5 to 35 degrees, {RATE:g} Hz. The first {SPOILED} of them with one thing wrong at a time. The balances of right drives "
        f"differ by {min(ratios):.2f} to {max(ratios):.2f} times what noise and tolerances allow (a log is flagged from "
        f"{DISAGREE:g} on).\n\n"
    )
    publish("wrong_engine", "Whether a wrong engine is noticed", intro + markdown(header, rows), "make wrong")


def _counts(outcomes: list[Outcome]) -> list[str]:
    return [str(sum(o.verdict == verdict for o in outcomes)) for verdict in ("refused", "flagged", "silent")]


def _words(outcomes: list[Outcome]) -> str:
    """Return the words of the first outcome that has any, in the form of a table's cell."""
    said = next((o.words for o in outcomes if o.words), "")
    return said.replace("|", "\\|")


if __name__ == "__main__":
    main()
