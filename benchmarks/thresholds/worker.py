"""Refines logs with the tuned numbers watched, or with one of them changed: `python worker.py RESULTS OUT NAME FACTOR NUMBER...`.

NAME `-` watches all. RESULTS has for each number a log and the result of its nominal map; OUT gets a file of JSON for each.
"""

import json
import sys
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import msgspec
from table import read_table
from watch import RECORDER, watched

import lpvobs
from lpvobs.discovery import thresholds


def main(results: Path, out: Path, name: str, factor: float, numbers: list[str]) -> None:
    """Refine what has not been."""
    if "lpvobs.api" in sys.modules:
        raise SystemExit("the package took its thresholds before they were changed")
    table = {entry.name: entry.value for entry in read_table(Path(thresholds.__file__).parents[2])}
    for each, value in table.items() if name == "-" else [(name, varied(table[name], factor))]:
        if not isinstance(value, tuple):
            setattr(thresholds, each, watched(each, value) if name == "-" else value)
    json.JSONEncoder.default = lambda _, number: float(number)  # a watched one in a result
    msgspec.json.encode = partial(msgspec.json.encode, enc_hook=float)  # the same in its file
    out.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        target = out / f"{number}.json"
        if not target.exists():
            part = target.with_suffix(".part")
            part.write_text(json.dumps(refined(results, number, out)), encoding="utf-8")
            part.rename(target)


def varied(value: float | int, factor: float) -> float | int:
    """Return a threshold times a factor; a whole number stays one."""
    return max(1, int(value * factor)) if isinstance(value, int) else value * factor


def refined(results: Path, number: str, out: Path) -> dict[str, object]:
    """Return what `lpvobs refine --json` says, what it cost, and what was seen of the thresholds; or why it failed."""
    RECORDER.seen.clear()
    begin, path = time.process_time(), out / f"{number}.h5"
    try:
        found = lpvobs.refine(results / f"{number}.h5", results / f"{number}.parquet", path).found.as_json(refined=True)
    except Exception as failure:  # a changed threshold may break anything: that is a finding
        found = {"failed": f"{type(failure).__name__}: {failure}"}
    path.unlink(missing_ok=True)
    seen = {name: asdict(record) for name, record in RECORDER.seen.items()}
    return found | {"seconds": time.process_time() - begin, "seen": seen}


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], float(sys.argv[4]), sys.argv[5:])
