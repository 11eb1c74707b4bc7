"""The judged side of the blind bank, a process of its own: `python judge.py FOLDER SHARE OF`.

It is given a folder of logs and nothing else. It cannot read what is in them: the truth is in the memory of the process that drew
it and is on no disk while this one runs, names and metadata of the logs do not depend on it, and this process ends if anything in
it imports the simulator or the code that draws.
"""

import json
import sys
import time
from pathlib import Path

FORBIDDEN = ("draw", "record", "score", "lpvobs.simulation.simulate", "lpvobs.simulation.integrate")


def refuse(event: str, arguments: tuple[object, ...]) -> None:
    """Audit hook: end at the first import of what knows the truth."""
    if event == "import" and arguments[0] in FORBIDDEN:
        raise SystemExit(f"the judged side tried to import {arguments[0]}")


sys.addaudithook(refuse)  # before anything of the project is imported

from lpvobs.io.config import load_config  # noqa: E402
from lpvobs.steps.estimate import estimate_logs  # noqa: E402
from lpvobs.steps.gain import make_gain  # noqa: E402
from lpvobs.steps.trace import Sources, refine_result  # noqa: E402


def main(folder: Path, share: int, of: int) -> None:
    """Judge every `of`-th log that has no verdict yet."""
    config, text = load_config(Path(__file__).parents[2] / "configs" / "diesel.toml")
    gain, _ = make_gain(config, ())
    logs = sorted(path for path in folder.glob("*.parquet") if not path.name.endswith(".nominal.parquet"))
    for log in logs[share::of]:
        verdict = log.with_suffix(".json")
        if verdict.exists():
            continue
        nominal = log.with_suffix(".nominal.parquet")
        source = nominal if nominal.exists() else log
        result, refined = log.with_suffix(".h5"), log.with_suffix(".refined.h5")
        estimate_logs(config, text, gain, [source], result, "observer", lambda _: None)
        begin = time.process_time()
        found, _ = refine_result(Sources(result, [log]), refined, lambda _: None)
        content = found.as_json(refined=True) | {"seconds": time.process_time() - begin}
        part = verdict.with_suffix(".part")
        part.write_text(json.dumps(content), encoding="utf-8")
        part.rename(verdict)
        result.unlink()
        refined.unlink()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
