"""The judged side of the blind bank, a process of its own: `python judge.py FOLDER SHARE OF refine|residual`.

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

from lpvobs.discovery.fit import fit  # noqa: E402
from lpvobs.discovery.held_out import compare  # noqa: E402
from lpvobs.discovery.residual import lay_out  # noqa: E402
from lpvobs.engines.diesel.effects import diesel_plant  # noqa: E402
from lpvobs.io.configuration.config import Config, load_config  # noqa: E402
from lpvobs.io.logs.reading import read_log  # noqa: E402
from lpvobs.io.results.results import read_result  # noqa: E402
from lpvobs.steps.estimate import estimate_logs  # noqa: E402
from lpvobs.steps.gain import make_gain  # noqa: E402
from lpvobs.steps.trace import Sources, prior_of, refine_result  # noqa: E402


def main(folder: Path, share: int, of: int, what: str) -> None:
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
        result = log.with_suffix(".h5")
        estimate_logs(config, text, gain, [source], result, "observer", lambda _: None)
        begin = time.process_time()
        content = refined(result, log) if what == "refine" else residual(config, result, log, source != log)
        part = verdict.with_suffix(".part")
        part.write_text(json.dumps(content | {"seconds": time.process_time() - begin}), encoding="utf-8")
        part.rename(verdict)
        result.unlink()


def refined(result: Path, log: Path) -> dict[str, object]:
    """Return what `lpvobs refine --json` says."""
    out = log.with_suffix(".refined.h5")
    found = refine_result(Sources(result, [log]), out, lambda _: None).found
    out.unlink()
    return found.as_json(refined=True)


def residual(config: Config, result: Path, log: Path, frozen: bool) -> dict[str, object]:
    """Return the held-out residual alone, as `lpvobs trace --json` has it, without the search."""
    air_path, tolerance = config.engine_path(), config.estimate.tolerance
    prior = prior_of(config, read_result(result), frozen)
    drive = read_log(log, air_path.channels, config.policies, auxiliary=True)
    linear = fit(lay_out(diesel_plant(config.engine), config.grid(), tolerance, prior, [drive]))
    return {"error": {"before": compare(linear, linear).comparison().before}}


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
