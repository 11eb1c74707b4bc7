"""Where the time of `make run` goes, verb by verb: `python benchmarks/where.py`.

Every command that `make run` would give is run in a process of its own that keeps an account of its processor's seconds: loading
libraries, loading or compiling kernels, writing files, and what is left, which is computing.
"""

import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from account import KINDS
from common import markdown, publish

ROOT = Path(__file__).parent.parent
BEGIN = ".venv/bin/lpvobs "


def commands(build: Path) -> list[list[str]]:
    """Return the words of every command of `make run` into an empty folder."""
    told = subprocess.run(
        ["make", "--no-print-directory", "-n", "run", f"BUILD={build}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return [shlex.split(line) for line in told.stdout.splitlines() if line.startswith((BEGIN, "cp ", "mkdir "))]


def measured(build: Path, kernels: Path) -> list[tuple[str, float, dict[str, float]]]:
    """Run the commands, which keep kernels in a folder; return the verb, the seconds of the clock, and the account of each."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment["NUMBA_CACHE_DIR"] = str(kernels)
    book = build / "account.json"
    found = []
    for words in commands(build):
        if words[0] != BEGIN.strip():
            subprocess.run(words, cwd=ROOT, check=True)
            continue
        begin = time.perf_counter()
        call = [sys.executable, str(ROOT / "benchmarks" / "account.py"), str(book), *words[1:]]
        subprocess.run(
            call, cwd=ROOT, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        found.append((words[1], time.perf_counter() - begin, json.loads(book.read_text(encoding="utf-8"))))
        print(found[-1], file=sys.stderr)
    return found


def table(found: list[tuple[str, float, dict[str, float]]]) -> str:
    """Return the account of every verb, and of all."""
    verbs = list(dict.fromkeys(verb for verb, _, _ in found))
    groups = [(f"`{verb}`", [item for item in found if item[0] == verb]) for verb in verbs] + [("all", found)]
    rows = []
    for name, items in groups:
        total = {kind: sum(account[kind] for _, _, account in items) for kind in ("all", *KINDS)}
        computing = total["all"] - sum(total[kind] for kind in KINDS)
        cells = [sum(clock for _, clock, _ in items), total["all"], *(total[kind] for kind in KINDS), computing]
        rows.append([name, str(len(items)), *(f"{cell:.2f}" for cell in cells), f"{computing / total['all']:.2f}"])
    header = ["verb", "times", "clock s", "processor s", *(f"{kind}, s" for kind in KINDS), "computing, s", "share"]
    return markdown(header, rows)


def main() -> None:
    """Print and keep the accounts."""
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        kernels = Path(first) / "kernels"
        cold, warm = measured(Path(first), kernels), measured(Path(second), kernels)
    text = "## All kernels are there\n\n" + table(warm)
    text += "\n\n## No kernel has been compiled yet\n\n" + table(cold)
    text += (
        "\n\nProcessor's seconds of the processes that run the verbs, until they leave; the clock has starting and leaving "
        "Python in it. *Kernels* is compiling, or loading what was compiled. *Writing* is all between opening a file under its "
        "temporary name and giving it its own, compression included. The floor is computing; the share is that of computing."
    )
    publish("where", "Where the time of `make run` goes", text)


if __name__ == "__main__":
    main()
