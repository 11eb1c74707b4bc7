"""The second bank: `python benchmarks/blind2 --seed N|dev|clock [--minutes 40] [--last N] [--judge-with DIR] [--out blind2]`.

Records drives of engines of another structure, a batch at a time, has another process judge each batch (`judge2.py`), and writes
the page after every one: it may be stopped at any time and goes on where it was. The rules stand in `rules.md`.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
sys.path[:0] = [str(REPOSITORY), str(HERE.parent)]

from common import commit, publish  # noqa: E402
from faults import UNLISTED, Hose  # noqa: E402
from plan import Drive, drawn_drive, parameter_of  # noqa: E402
from population import driven, plant, population, prepare, write  # noqa: E402
from verdicts2 import Seen, page  # noqa: E402

from lpvobs.simulation.effects import CATALOGUE  # noqa: E402
from lpvobs.simulation.plant import Plant, plant_of  # noqa: E402
from lpvobs.simulation.simulate import SimulatedLog  # noqa: E402
from lpvobs.simulation.structure import compressor_stage  # noqa: E402

READINGS = ("W_maf", "p_im", "p_em", "omega_t", "T_im", "u_delta")
FLOWS = ("W_egr", "W_ei", "W_leak")
TWINS = {"single": 2, "curve": 1, "course": 1, "form": 1}
"""Of so many drives of a kind one is traced once more without its effects."""


def main() -> None:
    """Run the bank."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", required=True, help="of the whole bank: a number, `dev`, or `clock` to draw one")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int, default=360)
    parser.add_argument("--only", type=int, nargs="*", help="these numbers alone")
    parser.add_argument("--kind", nargs="*", help="these kinds alone")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no batch after so many")
    parser.add_argument("--folder", type=Path, default=REPOSITORY / "build" / "blind2")
    parser.add_argument("--judge-with", type=Path, default=REPOSITORY, help="folder of the package that judges")
    parser.add_argument("--out", default="-", help="name of the page in benchmarks/results; - prints only")
    given = parser.parse_args()
    seed = {"dev": 0, "clock": time.time_ns() // 1000 % 1_000_000}.get(given.seed)
    bank = Bank(int(given.seed) if seed is None else seed, given.folder, given.judge_with)
    drives = [drawn_drive(bank.seed, number) for number in given.only or range(given.first, given.last)]
    drives = [drive for drive in drives if not given.kind or drive.kind in given.kind]
    print(f"seed {bank.seed}", file=sys.stderr)
    begin, done, text = time.time(), 0, ""
    for start in range(0, len(drives), given.batch):
        if time.time() - begin > 60.0 * given.minutes:
            break
        batch = drives[start : start + given.batch]
        bank.work(batch)
        done += len(batch)
        pace = done / (time.time() - begin) * 3600.0
        print(f"{done} of {len(drives)} drives, {pace:.0f} an hour", file=sys.stderr, flush=True)
        text = page([bank.seen(drive) for drive in drives[:done]])
        (bank.home / "page.md").write_text(text, encoding="utf-8")
    if given.out == "-":
        print((bank.home / "page.md").read_text(encoding="utf-8"))
    else:
        judge = commit(given.judge_with)
        head = f"Seed {bank.seed}, drawn after commit {judge}, whose code judged. Rules: `benchmarks/blind2/rules.md`."
        publish(given.out, "The second bank", f"{head}\n\n{text}", "make blind2")


@dataclass(frozen=True)
class Bank:
    """The drives of a seed, and what is said of them."""

    seed: int
    folder: Path
    code: Path

    @property
    def home(self) -> Path:
        """Folder of the logs."""
        return self.folder / str(self.seed)

    @property
    def verdicts(self) -> Path:
        """Folder of the verdicts."""
        return self.home / "verdicts"

    @property
    def _truth(self) -> Path:
        return self.home / "truth.json"

    def work(self, drives: list[Drive]) -> None:
        """Record and judge what has not been; while the judge runs, the truth is in this process alone."""
        self.verdicts.mkdir(parents=True, exist_ok=True)
        known = json.loads(self._truth.read_text(encoding="utf-8")) if self._truth.exists() else {}
        self._truth.unlink(missing_ok=True)
        for drive in drives:
            if str(drive.number) not in known or not self._judged(drive):
                known[str(drive.number)] = self._record(drive)
        names = [name for drive in drives for name in self._names(drive) if not self._verdict(name).exists()]
        if names:
            code = self.code.resolve()
            call = [
                sys.executable,
                HERE / "judge2.py",
                code,
                code / "configs" / "diesel.toml",
                self.home,
                self.verdicts,
            ]
            subprocess.run(
                [str(part) for part in [*call, *names]], env={**os.environ, "PYTHONPATH": str(code)}, check=True
            )
            for name in names:
                (self.home / f"{name}.parquet").unlink()  # a page needs verdicts, and drives can be made again
        self._truth.write_text(json.dumps(known, indent=1), encoding="utf-8")

    def seen(self, drive: Drive) -> Seen:
        """Return truth and verdicts of a drive."""
        truth = json.loads(self._truth.read_text(encoding="utf-8"))[str(drive.number)]
        found = [json.loads(self._verdict(name).read_text(encoding="utf-8")) for name in self._names(drive)]
        return Seen(truth, found[0], found[1] if len(found) > 1 else None)

    def _names(self, drive: Drive) -> list[str]:
        every = TWINS.get(drive.kind, 0)
        return [drive.name, f"{drive.name}_trace"] if every and drive.number % every == 0 else [drive.name]

    def _verdict(self, name: str) -> Path:
        return self.verdicts / f"{name}.json"

    def _judged(self, drive: Drive) -> bool:
        return all(self._verdict(name).exists() for name in self._names(drive))

    def _each_alone(self, drive: Drive, log: SimulatedLog) -> list[SimulatedLog]:
        """Return the drive with each of its effects alone."""
        if len(drive.effects) < 2:
            return [log] * len(drive.effects)
        engine = population(self.seed)[drive.engine]
        return [driven(engine, drive.piece, drive.seed, self.home, [effect]) for effect in drive.effects]

    def _record(self, drive: Drive) -> dict[str, Any]:
        """Write the logs of a drive and what its engine is known from; return the truth."""
        engine = population(self.seed)[drive.engine]
        prepare(engine, self.home / drive.home, self.seed, self.home, not drive.only_today)
        log = driven(engine, drive.piece, drive.seed, self.home, drive.effects)
        plain = driven(engine, drive.piece, drive.seed, self.home) if drive.effects else log
        for name, made in zip(self._names(drive), (log, plain), strict=False):
            write(self.home / f"{name}.parquet", made)
        return {
            "number": drive.number,
            "kind": drive.kind,
            "engine": drive.engine,
            "variation": engine.variation,
            "only_today": drive.only_today,
            "piece": drive.piece,
            "length": drive.piece[2] - drive.piece[1],
            "change": change(log, plain) if drive.effects else 0.0,
            "effects": [
                described(effect, own, plain, plant_of(*plant(engine)))
                for effect, own in zip(drive.effects, self._each_alone(drive, log), strict=True)
                if effect.id not in UNLISTED
            ],
            "channels": sorted(c for e in drive.effects if e.id in UNLISTED for c in UNLISTED[e.id][1]),
            "unlisted": [f"{e.id} {e.size:.3f}" for e in drive.effects if e.id in UNLISTED],
            "curve": true_curve(drive.effects[0], log, plant(engine)[0].compressor.R_c)
            if drive.kind == "curve"
            else None,
        }


def change(log: SimulatedLog, plain: SimulatedLog) -> float:
    """Return the true change: the largest, over readings and flows, of the mean change over the mean while the effect is at work.

    Flows are taken over the mean flow into the cylinders. Both drives have the same noise, which cancels.
    """
    pairs = [(log.channels[name], plain.channels[name], plain.channels[name]) for name in READINGS]
    pairs += [(log.truth[name], plain.truth[name], plain.truth["W_ei"]) for name in FLOWS]
    moved = [np.abs(new - old) / np.abs(scale).mean() for new, old, scale in pairs]
    at_work = np.max(moved, axis=0) > 1e-6
    return float(max(each[at_work].mean() for each in moved)) if at_work.any() else 0.0


def described(effect: Any, log: SimulatedLog, plain: SimulatedLog, healthy: Plant) -> dict[str, Any]:
    """Return an effect for the page, from the drive with it alone and the one without.

    Where its law is not the catalogue's, its size is the one that comes nearest.
    """
    course = getattr(effect, "course", None)
    name = "always" if course is None else course.name
    return {
        "id": effect.id,
        "parameter": parameter_of(effect.id),
        "value": equivalent(effect, log, plain, healthy),
        "course": "step" if name == "always" and effect.onset else name,
        "onset": effect.onset,
        "change": change(log, plain),
    }


def equivalent(effect: Any, log: SimulatedLog, plain: SimulatedLog, healthy: Plant) -> float:
    """Return the catalogue's parameter: the effect's own, or by least squares of the true change against the catalogue's law."""
    if effect.id == "compressor.flow":
        return passing(effect.value, log, healthy)
    if hasattr(effect, "value"):
        return leaking(effect, log) if isinstance(effect.course, Hose) else float(effect.value)
    on, before = np.abs(log.truth["W_maf"] - plain.truth["W_maf"]) > 1e-7, plain.truth["W_maf"]
    t = {name: values[on] for name, values in plain.truth.items()}
    seen, before = log.truth["W_maf"][on], before[on]
    slow = np.maximum(0.0, (2000.0 - t["n_e"]) / 1000.0) * t["u_delta"] / 40.0
    share = np.sqrt(2.0 * t["p_amb"] / (287.0 * t["T_amb"]) * 2.08e5)
    root = np.sqrt(np.maximum(before, 0.0))
    laws: dict[str, tuple[Any, ...]] = {  # with usual values of further parameters, which are free
        "maf.contamination": (lambda x, crossing: ((1.0 - x) * root + x * np.sqrt(crossing)) ** 2, 0.02),
        "maf.backflow": (lambda x: before * (1.0 + x * slow),),
        "leak.inlet": (lambda x: before / (1.0 + x * share),),
    }
    kind, (law, *further) = CATALOGUE[effect.id], laws[effect.id]
    bounds = [(kind.low, kind.high), *((0.1 * usual, 5.0 * usual) for usual in further)]
    begin = [0.5 * kind.high, *further]
    best = scipy.optimize.least_squares(
        lambda x: law(*x) - seen, begin, bounds=np.transpose(bounds), x_scale=begin, xtol=1e-12, ftol=1e-12
    )
    return float(best.x[0])


def passing(share: float, log: SimulatedLog, healthy: Plant) -> float:
    """Return what a fouled compressor passes over what the healthy one does, between the pressures that are logged."""
    # Less flow loses less pressure in filter and intercooler, and so the compressor works at a lower ratio than a healthy one.
    t, every = log.truth, slice(None, None, 20)
    states = np.transpose([t[name][every] for name in ("p_im", "omega_t", "p_amb", "T_amb", "T_em")])
    fouled = healthy._replace(condition=healthy.condition._replace(compressor_flow=share))
    now, before = (np.array([compressor_stage(each, *x).W_c for x in states]) for each in (fouled, healthy))
    return float(now @ before / (before @ before))


def leaking(effect: Any, log: SimulatedLog) -> float:
    """Return the mean area of a leak whose slit opens, weighted with the flow per area."""
    time = np.arange(log.truth["W_leak"].size) / (log.channels["time"].size - 1) * log.channels["time"][-1]
    opened = effect.course.along(time, {"u_delta": log.truth["u_delta"]}).share(time, effect.onset, effect.end)
    per_area = np.where(opened > 0.0, np.abs(log.truth["W_leak"]) / np.maximum(opened, 0.1), 0.0)
    return float(effect.value * (per_area * opened).sum() / per_area[opened > 0.0].sum())


def true_curve(effect: Any, log: SimulatedLog, R_c: float) -> dict[str, Any]:
    """Return the factor of a component at instants of the drive, beside the two inputs that its curve may have."""
    t = log.truth
    first, second = {
        "eta_vol.curve": (t["n_e"], t["p_im"]),
        "compressor.curve": (R_c * t["omega_t"], t["p_im"] / t["p_amb"]),
        "egr.curve": (t["u_egr"], t["p_im"] / t["p_em"]),
        "turbine.curve": (t["u_vgt"], t["p_amb"] / t["p_em"]),
    }[effect.id]
    centre, width = effect.bump
    open_ = np.flatnonzero(t["u_egr"] > 1.0) if effect.id == "egr.curve" else np.arange(first.size)
    some = open_[:: max(1, open_.size // 500)]
    factor = 1.0 + effect.value * np.exp(-0.5 * ((first[some] - centre) / width) ** 2)
    return {
        "inputs": [first[some].tolist(), second[some].tolist()],
        "factor": factor.tolist(),
        "amplitude": effect.value,
    }


if __name__ == "__main__":
    main()
