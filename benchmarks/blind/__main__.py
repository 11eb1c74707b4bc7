"""The blind bank: `python benchmarks/blind [--engine NAME] [--bank SEED] [--first 0] [--last N] [--jobs 2] [--out NAME]`.

Draws what is in each log, records the logs, has another process judge them, and scores the verdicts, for every engine. A bank
that was interrupted goes on where it was. `--judge-with DIR --verdicts old` judges the same logs with the package in another
folder; `--compare old` then lists every verdict that differs.
"""

import argparse
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
sys.path[:0] = [str(REPOSITORY), str(HERE.parent)]

from common import publish  # noqa: E402
from diesel import DIESEL  # noqa: E402
from draw import Case, Engine, name_of  # noqa: E402
from score import Judged, differences, page, rates  # noqa: E402
from throttled import MEASURED, THROTTLED  # noqa: E402

ENGINES = {engine.name: engine for engine in (DIESEL, THROTTLED)}


def main() -> None:
    """Run the bank."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--engine", choices=ENGINES, nargs="*", default=list(ENGINES))
    parser.add_argument("--bank", type=int, default=1, help="seed of the whole bank")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int, help="by default as many as make a bank of the engine")
    parser.add_argument("--only", type=int, nargs="*", help="these numbers alone")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=REPOSITORY / "build" / "blind")
    parser.add_argument("--judge-with", type=Path, default=REPOSITORY, help="folder of the package that judges")
    parser.add_argument("--verdicts", default="own", help="name of the folder that the verdicts are kept in")
    parser.add_argument("--compare", default="", help="other verdicts, to be compared with these")
    parser.add_argument("--record", action="store_true", help="record the logs and stop")
    parser.add_argument("--out", default="blind", help="name of the table in benchmarks/results; - prints only")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    pages, summary = [], {}
    for engine in (ENGINES[name] for name in given.engine):
        if reason := engine.missing():
            print(f"{engine.name}: left out: {reason}", file=sys.stderr)
            pages.append(f"## {engine.name}\n\nLeft out: {reason}.")
            continue
        numbers = given.only or range(given.first, given.last or engine.logs)
        cases = [engine.draw(given.bank, number) for number in numbers]
        bank = Bank(engine, cases, given.folder / str(given.bank) / engine.name, given.jobs)
        bank.record()
        if given.record:
            continue
        judged = bank.judged(given.judge_with, given.verdicts)
        summary[engine.name] = [asdict(rate) for rate in rates(judged)]
        text = page(judged, engine.sizes)
        if given.compare:
            other = bank.judged(given.judge_with, given.compare)
            text += f"\n\n### Verdicts that differ: {given.compare}, {given.verdicts}\n\n{differences(other, judged)}"
        pages.append(f"## {engine.name}\n\n{text}")
        bank.tell_truth()
    if given.record:
        return
    given.folder.joinpath(f"rates_{given.bank}.json").write_text(json.dumps(summary, indent=1))
    if given.out == "-":
        print("\n\n".join(pages))
    else:
        publish(given.out, "The blind bank", "\n\n".join(pages), "make blind")


@dataclass(frozen=True)
class Bank:
    """The logs of one engine, and what is said of them."""

    engine: Engine
    cases: list[Case]
    folder: Path
    jobs: int

    @cached_property
    def sets(self) -> dict[str, tuple[list[Case], bool, str]]:
        """Cases by folder, whether their effects are in the logs, and the verb that judges them.

        Beside the logs themselves: those with effects once more without them; pairs with either effect alone.
        """
        pairs = [case for case in self.cases if case.kind == "pair"]
        halves = {
            f"half_{k + 1}": ([replace(case, effects=[case.effects[k]]) for case in pairs], True, "trace")
            for k in (0, 1)
        }
        twins = [case for case in self.cases if case.effects]
        return {"logs": (self.cases, True, "refine"), "twins": (twins, False, "trace"), **halves}

    def record(self) -> None:
        """Write the logs that are not there."""
        work = []
        for name, (cases, with_effects, _) in self.sets.items():
            (self.folder / name).mkdir(parents=True, exist_ok=True)
            paths = [self.folder / name / f"{name_of(case)}.parquet" for case in cases]
            work += [(case, path, with_effects) for case, path in zip(cases, paths, strict=True) if not path.exists()]
        with ProcessPoolExecutor(self.jobs) as pool:
            futures = [pool.submit(self.engine.record, *item) for item in work]
            for done, future in enumerate(futures, 1):
                future.result()
                _tell(f"{self.engine.name}: recorded {done} of {len(work)}")

    def judged(self, code: Path, name: str) -> list[Judged]:
        """Return the cases with the verdicts kept under a name; those that are missing are made by the package in a folder."""
        found = {part: self._verdicts(part, code, name) for part in self.sets}
        halves = [found[part] for part in ("half_1", "half_2")]
        out = []
        for case in self.cases:
            own = name_of(case)
            alone = tuple(float(half[own]["error"]["before"]) for half in halves if own in half)
            out.append(Judged(case, found["logs"][own], found["twins"].get(own, found["logs"][own]), alone))
        return out

    def tell_truth(self) -> None:
        """Write down what was in the logs."""
        self._truth.write_text(json.dumps([asdict(case) for case in self.cases], indent=1), encoding="utf-8")

    @property
    def _truth(self) -> Path:
        return self.folder / "truth.json"

    def _verdicts(self, part: str, code: Path, name: str) -> dict[str, dict[str, Any]]:
        cases, _, verb = self.sets[part]
        folder = self.folder / name / part
        folder.mkdir(parents=True, exist_ok=True)
        paths = {name_of(case): folder / f"{name_of(case)}.json" for case in cases}
        if missing := [own for own, path in paths.items() if not path.exists()]:
            self._truth.unlink(missing_ok=True)
            config = folder / self.engine.config
            # A sensor drawn at 1.3 times its configured error reads 61 % wrong in town, which `estimate` refuses unless told.
            given = (code / "configs" / self.engine.config).read_text(encoding="utf-8")
            config.write_text(re.sub(r"(?m)^largest_error = [0-9.]+", "largest_error = 1.0", given), encoding="utf-8")
            call = [sys.executable, HERE / "judge.py", code, config, self.folder / part, folder, verb]
            shares = [missing[k :: self.jobs] for k in range(min(self.jobs, len(missing)))]
            _together([[*call, *share] for share in shares], code)
        return {own: json.loads(path.read_text(encoding="utf-8")) for own, path in paths.items()}


def _together(commands: Iterable[list[object]], code: Path) -> None:
    """Run judges side by side, with the package of a folder and without the recordings that drives are made of."""
    environment = {**os.environ, "PYTHONPATH": str(code.resolve())}
    environment.pop(MEASURED, None)
    judges = [subprocess.Popen(list(map(str, command)), env=environment) for command in commands]
    codes = [judge.wait() for judge in judges]
    if any(codes):
        raise SystemExit("a judge failed, see above")


def _tell(text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r{text}", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
