"""How many deliberate faults in the core rooms the tests notice.

    python benchmarks/mutants [--number 300] [--seed 1] [--rooms maps,observer,synthesis] [--workers 2]

Each mutant changes one place of one module (`change.py`). The tests of its room run with the compiler off, those of its module
first and then the quickest, until one fails (`judge.py`). Before that, a module without a change goes the same way, and must not
be noticed. Tests that take long without the compiler are left out, so a survivor may be one that they would notice. A test that
takes many times what it takes without a fault has noticed it, too. Mutants that do what the original does are listed in
`same.toml`, by function, with what is said before and after; one that names nothing any more is an error.
"""

import argparse
import multiprocessing
import os
import platform
import random
import sys
import tomllib
from collections.abc import Sequence
from datetime import date
from functools import partial
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from change import ROOT, Mutant, mutants  # noqa: E402
from judge import LONGEST, Measured, judge, measure, preload  # noqa: E402

RESULTS = ROOT / "benchmarks" / "results" / "mutants.md"
ROOMS = ("maps", "observer", "synthesis")
WIDTH = 100
Verdicts = Sequence[tuple[Mutant, bool]]


def main() -> None:
    """Judge a sample of mutants, and write the page."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rooms", type=lambda text: text.split(","), default=list(ROOMS))
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
    everything = {room: [mutant for name in modules(room) for mutant in mutants(name)] for room in options.rooms}
    why = reasons(everything)
    fork = multiprocessing.get_context("fork")
    measured = {}
    for room in options.rooms:
        with fork.Pool(1) as pool:
            measured[room] = pool.apply(measure, (room,))
    preload(measured.values())
    chosen = [mutant for found in everything.values() for mutant in found]
    chosen = random.Random(options.seed).sample(chosen, min(options.number, len(chosen)))
    verdicts = []
    with fork.Pool(options.workers) as pool:
        for room in options.rooms:
            if judge_one(measured, Mutant(modules(room)[0], "", "", "", 0, -1))[1]:
                raise SystemExit(f"{room}: the tests fail without any change")
        for mutant, found in pool.imap_unordered(partial(judge_one, measured), chosen):
            verdicts.append((mutant, found))
            said = "noticed " if found else "SURVIVED"
            print(f"{len(verdicts)} {said} {mutant.place}: {mutant.before} -> {mutant.after}", flush=True)
    text = page(f"--number {options.number} --seed {options.seed}", verdicts, measured, why)
    if options.rooms == list(ROOMS):
        RESULTS.write_text(text, encoding="utf-8")
    print(text)


def judge_one(measured: dict[str, Measured], mutant: Mutant) -> tuple[Mutant, bool]:
    """Return a mutant and whether it was noticed."""
    return mutant, judge(mutant, measured[mutant.room])


def modules(room: str) -> list[str]:
    """Return the modules of a room."""
    found = sorted((ROOT / "lpvobs" / room).glob("*.py"))
    return [f"lpvobs.{room}.{path.stem}" for path in found if path.stem != "__init__"]


def reasons(everything: dict[str, list[Mutant]]) -> dict[tuple[str, str, str], str]:
    """Return why a mutant does what the original does, by function, before and after."""
    listed = tomllib.loads((HERE / "same.toml").read_text(encoding="utf-8"))["same"]
    why = {(place, before, after): item["why"] for item in listed for place, before, after in item["changes"]}
    there = {(mutant.place, mutant.before, mutant.after) for found in everything.values() for mutant in found}
    rotten = [key for key in why if key not in there and key[0].split(".")[0] in everything]
    if rotten:
        raise SystemExit("\n".join(f"same.toml: no mutant is called {', '.join(key)}" for key in rotten))
    return why


def page(how: str, verdicts: Verdicts, measured: dict[str, Measured], why: dict[tuple[str, str, str], str]) -> str:
    """Return the page of results."""
    lines = [
        "# Deliberate faults, and whether the tests notice",
        "",
        f"`benchmarks/mutants {how}`, {date.today().isoformat()}, {platform.machine()}, compiler off. Of the tests of each room "
        f"those count that take less than {LONGEST:g} s of computing without the compiler.",
        "",
        "| room | mutants | noticed | score | tests used | left out |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for room, tests in measured.items():
        of = [found for mutant, found in verdicts if room == mutant.room]
        lines.append(row(room, of, str(len(tests.durations)), str(tests.number - len(tests.durations))))
    told = [(mutant, found, why.get((mutant.place, mutant.before, mutant.after), "")) for mutant, found in verdicts]
    lines.append(row("all", [found for _, found in verdicts], "", ""))
    lines.append(row("all, without those that change nothing", [found for _, found, same in told if not same], "", ""))
    lines += ["", "## Survivors", "", "| function | before | after | why no test can tell |", "|---|---|---|---|"]
    for mutant, found, same in sorted(told, key=lambda item: (item[0].place, item[0].node)):
        if not found:
            before, after = (text[:WIDTH].replace("|", "\\|") for text in (mutant.before, mutant.after))
            lines.append(f"| {mutant.place} | `{before}` | `{after}` | {same} |")
    return "\n".join(lines) + "\n"


def row(name: str, found: Sequence[bool], *more: str) -> str:
    """Return a row of the table of scores."""
    cells = (name, str(len(found)), str(sum(found)), f"{100 * sum(found) / max(len(found), 1):.1f} %", *more)
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
