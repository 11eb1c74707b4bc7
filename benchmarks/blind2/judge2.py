"""The judged side of the second bank, a process of its own: `python judge2.py CODE CONFIG FOLDER VERDICTS LOG...`.

As in the first bank it is given a folder and names of logs, and ends if anything in it imports what knows the truth. The folder of
an engine has a bench table or not, and healthy drives: the engine is calibrated and its map estimated once. Every log is judged by
the map that stands: `refine`, or `trace` for the logs whose name ends in `_trace`.
"""

import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "blind"))

import judge

judge.FORBIDDEN += ("plan", "population", "faults", "verdicts2")

import lpvobs  # noqa: E402


def main(code: Path, config: Path, folder: Path, verdicts: Path, names: list[str]) -> None:
    """Judge logs."""
    if Path(lpvobs.__file__).parents[1] != code.resolve():
        raise SystemExit(f"{lpvobs.__file__} was imported instead of the package in {code}")
    gain = verdicts / "gain.h5"
    if not gain.exists():
        lpvobs.synth_gain(config, out=gain)
    for name in names:
        own = verdicts / f"{name}.json"
        begin = time.process_time()
        try:
            known = known_engine(config, folder, verdicts, gain, name.split("_")[0])
            begin = time.process_time()
            found = judged(known, folder / f"{name}.parquet", verdicts / f"{name}.h5", name.endswith("_trace"))
        except Exception as error:  # a verb that refuses or fails is a miss, and no end of the bank
            found = {"verdict": "refused", "effects": [], "p_value": None, "said": f"{type(error).__name__}: {error}"}
        part = own.with_suffix(".part")
        part.write_text(json.dumps(found | {"seconds": time.process_time() - begin}), encoding="utf-8")
        part.rename(own)


def known_engine(config: Path, folder: Path, verdicts: Path, gain: Path, home: str) -> Path:
    """Return the map of an engine's healthy drives, on the engine as it was calibrated once."""
    result = verdicts / f"{home}.map.h5"
    if result.exists():
        return result
    healthy, engine = sorted((folder / home).glob("healthy_*.parquet")), verdicts / f"{home}.engine.h5"
    bench = folder / home / "bench.parquet"
    if bench.exists():
        lpvobs.calibrate(config, bench=bench, out=engine, gain=gain)
    elif right := [path for path in healthy if path.stem.endswith("_right")]:
        lpvobs.calibrate(config, healthy=right[:1], out=engine, gain=gain)
    lpvobs.estimate(config, healthy, result, gain=gain, engine=engine if engine.exists() else None)
    return result


def judged(known: Path, log: Path, refined: Path, only_trace: bool) -> dict[str, object]:
    """Return the verdict on a log."""
    if only_trace:
        return lpvobs.trace(known, log).found.as_json(refined=False)
    found = lpvobs.refine(known, log, refined).found.as_json(refined=True)
    refined.unlink()
    return found


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:5]), sys.argv[5:])
