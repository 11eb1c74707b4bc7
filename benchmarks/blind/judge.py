"""The judged side of the blind bank, a process of its own: `python judge.py CODE CONFIG FOLDER VERDICTS refine|trace LOG...`.

It is given a folder and names of logs, and nothing else that has to do with them. It cannot read what is in them: the truth is in
the memory of the process that drew it and on no disk while this one runs, names and metadata of the logs do not depend on it,
and this process ends if anything in it imports the simulator or the code that draws. It judges with the code in the folder CODE,
through the functions that the package offers to everybody, so that any version of the package can be judged.
"""

import json
import sys
import time
from pathlib import Path

FORBIDDEN = (
    "draw",
    "alter",
    "diesel",
    "throttled",
    "score",
    "lpvobs.simulation.simulate",
    "lpvobs.simulation.integrate",
)


def refuse(event: str, arguments: tuple[object, ...]) -> None:
    """Audit hook: end at the first import of what knows the truth."""
    if event == "import" and arguments[0] in FORBIDDEN:
        raise SystemExit(f"the judged side tried to import {arguments[0]}")


sys.addaudithook(refuse)  # before anything of the project is imported

import lpvobs  # noqa: E402


def main(code: Path, config: Path, folder: Path, verdicts: Path, verb: str, names: list[str]) -> None:
    """Judge logs."""
    if Path(lpvobs.__file__).parents[1] != code.resolve():
        raise SystemExit(f"{lpvobs.__file__} was imported instead of the package in {code}")
    gain = verdicts / f"{names[0]}.gain.h5"
    lpvobs.synth_gain(config, out=gain)
    for name in names:
        log, verdict = folder / f"{name}.parquet", verdicts / f"{name}.json"
        nominal = log.with_suffix(".nominal.parquet")
        result, refined = verdict.with_suffix(".h5"), verdict.with_suffix(".refined.h5")
        lpvobs.estimate(config, nominal if nominal.exists() else log, result, gain=gain)
        begin = time.process_time()
        if verb == "refine":
            found = lpvobs.refine(result, log, refined).found.as_json(refined=True)
            refined.unlink()
        else:
            found = lpvobs.trace(result, log).found.as_json(refined=False)
        part = verdict.with_suffix(".part")
        part.write_text(json.dumps(found | {"seconds": time.process_time() - begin}), encoding="utf-8")
        part.rename(verdict)
        result.unlink()
    gain.unlink()


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:5]), sys.argv[5], sys.argv[6:])
