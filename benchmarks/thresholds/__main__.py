"""How near decisions come to the tuned numbers, and what changes with half and twice of each: `python benchmarks/thresholds`.

Twenty drives of a blind bank of its own, twelve diesel ones and eight of the throttled engine (where its recording is at hand).
One run records how near every decision came to its threshold, and on which side. A threshold with a decision that half the value
would turn is halved, one that twice would turn is doubled, each on the drives with the nearest such decisions: as many as fit into
the given CPU time, so a change on another drive may go unseen. What a number sets that cannot be seen as a decision is not
varied for its own sake. An interrupted run goes on where it was, as long as the package is the same.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
sys.path[:0] = [str(REPOSITORY), str(HERE.parent), str(HERE.parent / "blind"), str(HERE)]

from common import markdown, publish  # noqa: E402
from diesel import DIESEL  # noqa: E402
from draw import Case, Engine  # noqa: E402
from score import Judged  # noqa: E402
from table import Threshold, read_table  # noqa: E402
from throttled import THROTTLED  # noqa: E402

import lpvobs  # noqa: E402

SEED = 9
"""Of the blind bank that the drives are taken from; nobody else's."""
DRIVES = {
    DIESEL: (0, 1, 2, 10, 12, 14, 16, 18, 23, 24, 26, 28),
    THROTTLED: (0, 1, 10, 13, 16, 23, 26, 28),
}
"""Numbers in that bank: clean, single effects, pairs, by a logged channel, by nothing logged."""
FACTORS = {"halved": 0.5, "doubled": 2.0}
TOWARDS = {"halved": "lowered", "doubled": "raised"}
"""What a record calls the nearest decision on that side."""


def main() -> None:
    """Record, vary, and write what changed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--minutes", type=float, default=80.0, help="CPU time of drives that may be spent on halves and doubles"
    )
    parser.add_argument("--folder", type=Path, default=REPOSITORY / "build" / "thresholds")
    parser.add_argument("--out", default="thresholds", help="name of the table in benchmarks/results; - prints only")
    given = parser.parse_args()
    left_out = [f"{engine.name}: left out: {engine.missing()}" for engine in DRIVES if engine.missing()]
    drives = [Drive(engine, number) for engine in DRIVES if not engine.missing() for number in DRIVES[engine]]
    table = read_table(REPOSITORY)
    study = Study(given.folder / package_digest(), drives, given.jobs)
    study.prepare()
    recorded = study.run({"watched": ("-", 1.0, drives)})["watched"]
    seen = pooled(recorded)
    concerned = {
        (entry.name, how): drives
        for entry in table
        if not isinstance(entry.value, tuple)
        for how in FACTORS
        if (drives := turning(recorded, entry.name, TOWARDS[how]))
    }
    most = affordable(recorded, list(concerned.values()), 60.0 * given.minutes)
    found = study.run(
        {f"{name} {how}": (name, FACTORS[how], drives[:most]) for (name, how), drives in concerned.items()}
    )
    text = "\n\n".join([*left_out, page(table, seen, recorded, found, most)])
    if given.out == "-":
        print(text)
    else:
        publish(given.out, "The tuned numbers of the search", text, "make thresholds")


@dataclass(frozen=True)
class Drive:
    """A drive of the bank."""

    engine: Engine
    number: int

    @property
    def name(self) -> str:
        """Name of its files."""
        return f"{self.engine.name}-{self.number}"

    @property
    def case(self) -> Case:
        """Its truth."""
        return self.engine.draw(SEED, self.number)


Verdicts = dict[Drive, dict[str, Any]]


@dataclass(frozen=True)
class Study:
    """Runs over the drives, kept in a folder."""

    folder: Path
    drives: Sequence[Drive]
    jobs: int

    def prepare(self) -> None:
        """Record the drives and estimate their nominal maps, which no threshold of the search touches."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for drive in self.drives:
            log, result = (self.folder / f"{drive.name}.{kind}" for kind in ("parquet", "h5"))
            if result.exists():
                continue
            drive.engine.record(drive.case, log, True)
            nominal = log.with_suffix(".nominal.parquet")
            config = REPOSITORY / "configs" / drive.engine.config
            lpvobs.estimate(config, nominal if nominal.exists() else log, result)

    def run(self, variations: Mapping[str, tuple[str, float, Sequence[Drive]]]) -> dict[str, Verdicts]:
        """Return the verdicts by variation, each on its drives; several at a time, one process each."""
        with ThreadPoolExecutor(self.jobs) as pool:
            found = pool.map(self._one, variations, *zip(*variations.values(), strict=True)) if variations else ()
            return dict(zip(variations, found, strict=True))

    def _one(self, key: str, name: str, factor: float, drives: Sequence[Drive]) -> Verdicts:
        out = self.folder / key.replace(" ", "_")
        paths = {drive: out / f"{drive.name}.json" for drive in drives}
        if not all(path.exists() for path in paths.values()):
            names = [drive.name for drive in drives]
            call = [sys.executable, HERE / "worker.py", self.folder, out, name, factor, *names]
            environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "OPENBLAS_NUM_THREADS": "1"}
            subprocess.run(list(map(str, call)), env=environment, check=True)
            print(f"{key}: {len(names)} drives", file=sys.stderr)
        return {drive: json.loads(path.read_text(encoding="utf-8")) for drive, path in paths.items()}


def package_digest() -> str:
    """Return a digest of the package's sources: other sources, other decisions."""
    total = hashlib.sha256()
    for path in sorted((REPOSITORY / "lpvobs").rglob("*.py")):
        total.update(path.read_bytes())
    return total.hexdigest()[:12]


@dataclass(frozen=True)
class Seen:
    """What all drives together showed of a threshold."""

    decisions: int
    near: int
    nearest: float
    settings: int


def affordable(recorded: Verdicts, drives: Sequence[Sequence[Drive]], seconds: float) -> int:
    """Return how many drives every variation may have in that CPU time, at least one: they cost about what they cost before."""
    counts = range(1, max(map(len, drives), default=1) + 1)
    cost = [sum(recorded[drive]["seconds"] for each in drives for drive in each[:count]) for count in counts]
    return max((count for count, total in zip(counts, cost, strict=True) if total <= seconds), default=1)


def pooled(recorded: Verdicts) -> dict[str, Seen]:
    """Return what was seen by threshold."""
    names = {name for verdict in recorded.values() for name in verdict["seen"]}
    return {name: _pooled([v["seen"][name] for v in recorded.values() if name in v["seen"]]) for name in names}


def _pooled(parts: Sequence[Mapping[str, Any]]) -> Seen:
    decisions, near, settings = (sum(part[key] for part in parts) for key in ("decisions", "near", "settings"))
    return Seen(decisions, near, min(min(part["raised"], part["lowered"]) for part in parts), settings)


def turning(recorded: Verdicts, name: str, side: str) -> list[Drive]:
    """Return the drives with a decision that a factor of two on that side turns, the nearest first."""
    seen = {drive: verdict["seen"].get(name, {}).get(side, inf) for drive, verdict in recorded.items()}
    return sorted((drive for drive, factor in seen.items() if factor <= max(FACTORS.values())), key=seen.__getitem__)


def page(
    table: Sequence[Threshold],
    seen: Mapping[str, Seen],
    recorded: Verdicts,
    found: Mapping[str, Verdicts],
    most: int,
) -> str:
    """Return the tables."""
    rows = [_row(entry, seen.get(entry.name), recorded, found) for entry in table]
    header = ["threshold", "value", "unit", "decisions", "within a factor of two", "nearest factor", *FACTORS]
    drives = ", ".join(
        f"{sum(d.engine.name == name for d in recorded)} {name}" for name in {d.engine.name: 0 for d in recorded}
    )
    return "\n\n".join(
        [
            f"Drives: {drives}. As they are, the thresholds name {_counted(recorded, right)} rightly, and say something of "
            f"{_counted(recorded, false_alarm)} that hold nothing nameable, in {_cost(recorded):.0f} s of CPU time.",
            "A decision is near if half or twice the threshold turns it. Halved and doubled: change of right names, change of "
            f"false alarms, change of CPU time on the {most} drives at most whose decisions on that side are nearest; - where no "
            f"decision on that side is near. The {sum(map(len, found.values()))} drives with a threshold changed took "
            f"{sum(map(_cost, found.values())):.0f} s of CPU time.",
            markdown(header, rows),
            "## Verdicts that changed",
            "\n".join(_changes(recorded, found)) or "None.",
        ]
    )


def _row(entry: Threshold, seen: Seen | None, recorded: Verdicts, found: Mapping[str, Verdicts]) -> list[str]:
    head = [f"`{entry.name}`", str(entry.value), entry.unit]
    if seen is None:
        return [*head, "0", "0", "-", "-", "-"]
    nearest = "-" if seen.nearest > 1e6 else f"{seen.nearest:.2f}"
    changes = [_effect(recorded, found.get(f"{entry.name} {how}")) for how in FACTORS]
    return [*head, str(seen.decisions) if seen.decisions else "a setting", str(seen.near), nearest, *changes]


def _effect(recorded: Verdicts, changed: Verdicts | None) -> str:
    if changed is None:
        return "-"
    before = {drive: recorded[drive] for drive in changed}
    failed = sum("failed" in verdict for verdict in changed.values())
    gains = [_counted(changed, rule) - _counted(before, rule) for rule in (right, false_alarm)]
    cost = _cost(changed) / max(_cost(before), 1e-9) - 1.0
    text = f"{gains[0]:+d}, {gains[1]:+d}, {100 * cost:+.0f} % of {len(changed)}"
    return f"{text}, {failed} failed" if failed else text


def right(drive: Drive, verdict: Mapping[str, Any]) -> bool:
    """Return whether a drive with effects has its names."""
    case = drive.case
    return case.kind not in ("clean", "unlogged") and "failed" not in verdict and Judged(case, dict(verdict), {}).right


def false_alarm(drive: Drive, verdict: Mapping[str, Any]) -> bool:
    """Return whether something is said of a clean drive, or a name of one that nothing logged disturbs."""
    case = drive.case
    return case.kind in ("clean", "unlogged") and "failed" not in verdict and not Judged(case, dict(verdict), {}).right


def _counted(verdicts: Verdicts, rule: Callable[[Drive, Mapping[str, Any]], bool]) -> int:
    return sum(rule(drive, verdict) for drive, verdict in verdicts.items())


def _cost(verdicts: Verdicts) -> float:
    return float(sum(verdict["seconds"] for verdict in verdicts.values()))


def _changes(recorded: Verdicts, found: Mapping[str, Verdicts]) -> list[str]:
    lines = []
    for key, verdicts in found.items():
        for drive, verdict in verdicts.items():
            said, before = _said(verdict), _said(recorded[drive])
            if said != before:
                lines.append(f"- {key}, {drive.name} ({drive.case.kind}): {before} -> {said}")
    return lines


def _said(verdict: Mapping[str, Any]) -> str:
    if "failed" in verdict:
        return str(verdict["failed"])
    return " ".join([verdict["verdict"], *(effect["id"] for effect in verdict["effects"])])


if __name__ == "__main__":
    main()
