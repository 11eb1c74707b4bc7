"""The blind bank: `python benchmarks/blind [--first 0] [--last 690] [--bank 1] [--jobs 2] [--folder build/blind] [--out NAME]`.

Draws what is in each log, records the logs, has another process judge them, and scores the verdicts. A bank that was interrupted
goes on where it was.
"""

import argparse
import json
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

from common import configuration, publish  # noqa: E402
from draw import Case, draw  # noqa: E402
from record import name_of, record  # noqa: E402
from score import Judged, page, rates  # noqa: E402


def main() -> None:
    """Run the bank."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int, default=690)
    parser.add_argument("--only", type=int, nargs="*", help="these numbers alone")
    parser.add_argument("--bank", type=int, default=1, help="seed of the whole bank")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=HERE.parents[1] / "build" / "blind")
    parser.add_argument("--out", default="blind", help="name of the table in benchmarks/results; - prints only")
    given = parser.parse_args()
    tolerance = configuration().estimate.tolerance
    numbers = given.only or range(given.first, given.last)
    cases = [draw(given.bank, number, dict(tolerance)) for number in numbers]
    folders = given.folder / f"{given.bank}" / "logs", given.folder / f"{given.bank}" / "twins"
    with_effect = [case for case in cases if case.effects]
    verdicts = _verdicts(cases, folders[0], given.jobs, True)
    twins = verdicts | _verdicts(with_effect, folders[1], given.jobs, False, "residual")
    alone = _alone([case for case in cases if case.kind == "pair"], folders[1].parent, given.jobs)
    judged = [Judged(case, verdicts[name_of(case)], twins[name_of(case)], alone.get(case.number, ())) for case in cases]
    given.folder.joinpath(f"truth_{given.bank}.json").write_text(json.dumps([asdict(case) for case in cases], indent=1))
    summary = [asdict(rate) for rate in rates(judged)]
    given.folder.joinpath(f"rates_{given.bank}.json").write_text(json.dumps(summary, indent=1))
    text = page(judged)
    if given.out == "-":
        print(text)
    else:
        publish(given.out, "The blind bank", text, "make blind")


def _verdicts(
    cases: list[Case], folder: Path, jobs: int, with_effects: bool, what: str = "refine"
) -> dict[str, dict[str, object]]:
    """Record the logs that have no verdict, have them judged, and return all verdicts by name."""
    folder.mkdir(parents=True, exist_ok=True)
    missing = [case for case in cases if not (folder / f"{name_of(case)}.json").exists()]
    with ProcessPoolExecutor(jobs) as pool:
        for done, _ in enumerate(pool.map(_record, [(case, folder, with_effects) for case in missing]), 1):
            _tell(f"recorded {done} of {len(missing)}")
    if missing:
        judges = [
            subprocess.Popen([sys.executable, str(HERE / "judge.py"), str(folder), str(k), str(jobs), what])
            for k in range(jobs)
        ]
        codes = [judge.wait() for judge in judges]
        if any(codes):
            raise SystemExit("a judge failed, see above")
    return {name_of(case): json.loads((folder / f"{name_of(case)}.json").read_text()) for case in cases}


def _alone(pairs: list[Case], folder: Path, jobs: int) -> dict[int, tuple[float, ...]]:
    """Return the held-out residual of each pair's log with the one and with the other effect alone [kg/s]."""
    found: dict[int, tuple[float, ...]] = {}
    for which in (0, 1):
        halves = [replace(case, effects=[case.effects[which]]) for case in pairs]
        verdicts = _verdicts(halves, folder / f"half_{which + 1}", jobs, True, "residual")
        for case in pairs:
            before = float(verdicts[name_of(case)]["error"]["before"])  # type: ignore[index]
            found[case.number] = (*found.get(case.number, ()), before)
    return found


def _record(given: tuple[Case, Path, bool]) -> None:
    case, folder, with_effects = given
    record(configuration(), case, folder, with_effects)


def _tell(text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r{text}", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
